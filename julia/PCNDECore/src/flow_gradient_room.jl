"""
    FlowGradientRoom(n_state, hidden, cases, points)

Arrays of the gradient. Those that hold every evaluation of the network side by side
grow with the number of steps.
"""
mutable struct FlowGradientRoom
    const constant::Matrix{Float64}     # (first hidden, case)
    const state_slopes::Matrix{Float64} # (state, case·z): loss by the states at the points
    const on_grid::Array{Float64, 3}    # (first hidden, case, z): loss by `on_grid`
    const slopes::Matrix{Float64}       # (state·case, 7): loss by a step's slopes
    const state::Vector{Float64}        # (state·case): loss by the state
    const change::Matrix{Float64}       # (state, case)
    const carried::Vector{Float64}      # (state·case): loss by the next step's first slope
    const back::Vector{Matrix{Float64}} # per hidden layer (width, case)
    const along::Matrix{Float64}        # (first hidden, state)
    const positions::Vector{Float64}    # cm, of each evaluation
    inputs::Matrix{Float64}             # (state, case·evaluation)
    activations::Activations
    deltas::Vector{Matrix{Float64}}     # per hidden layer (width, case·evaluation)
end

function FlowGradientRoom(n_state::Int, hidden::Vector{Int}, cases::Int, points::Int)
    return FlowGradientRoom(
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
