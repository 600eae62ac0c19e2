"""
    FlowGradientWorkspace(n_state, hidden, cases, points)

Work arrays of the gradient; `grad_x` is the derivative of the loss with respect to x. The
arrays with one column per case and evaluation of the network grow with the number of steps.
"""
mutable struct FlowGradientWorkspace
    const constant::Matrix{Float64}         # (first hidden, case)
    const grad_states::Matrix{Float64}      # (state, case·z), states at the points
    const grad_on_grid::Array{Float64, 3}   # (first hidden, case, z)
    const grad_slopes::Matrix{Float64}      # (state·case, 7), slopes of a step
    const grad_state::Vector{Float64}       # (state·case), state at a step's start
    const grad_stage::Matrix{Float64}       # (state, case), state of one evaluation
    const grad_next_slope::Vector{Float64}  # (state·case), first slope of the next step
    const grad_hidden::Vector{Matrix{Float64}} # per hidden layer (width, case)
    const grad_along::Matrix{Float64}       # (first hidden, state)
    const positions::Vector{Float64}        # cm, of each evaluation
    inputs::Matrix{Float64}                 # (state, case·evaluation)
    activations::Activations
    deltas::Vector{Matrix{Float64}}         # per hidden layer (width, case·evaluation)
end

function FlowGradientWorkspace(n_state::Int, hidden::Vector{Int}, cases::Int, points::Int)
    return FlowGradientWorkspace(
        zeros(hidden[1], cases),
        zeros(n_state, cases * points),
        zeros(hidden[1], cases, points),
        zeros(n_state * cases, 7),
        zeros(n_state * cases),
        zeros(n_state, cases),
        zeros(n_state * cases),
        [zeros(width, cases) for width in hidden],
        zeros(hidden[1], n_state),
        Float64[],
        zeros(n_state, 0),
        Activations(hidden, 0),
        [zeros(width, 0) for width in hidden],
    )
end
