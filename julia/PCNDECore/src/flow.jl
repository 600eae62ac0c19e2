# Momentum equation ∂Q/∂z = f_θ(Q, S) as a neural ODE in z.
#
# The last layer of f_θ is linear, f = [W b]·h̃(Q, S), where h̃ is the last hidden layer with
# an additional row of ones. The solution is therefore
#
#     Q(z) = Q_in + [W b]·H(z),   dH/dz = h̃(Q, S),   H(0) = 0,
#
# where H has 9 components in the paper, and Q has 100 time points. Runge–Kutta steps,
# their error estimate and their interpolant are affine in the state, so that stepping
# H gives the same Q as stepping Q to round-off, with a tenth of the work. The error is
# measured on Q. The area's part of the first layer is linear in
# S, and S is linear in z between the grid's points, so that part is computed once on
# the grid and interpolated.
#
# Physics terms (`physics_terms.jl`) are not in the span of [W b]. With them, the state is
# Q − Q_in itself, Q = Q_in + I·(Q − Q_in), and everything else is the same.

"""
    HiddenRate(network, z, along, on_grid, activations)

Right-hand side dH/dz (state × case) of the reduced momentum equation: the last hidden
layer h̃ at a state and a position, in place and without allocations.
"""
struct HiddenRate
    network::Network
    z::Vector{Float64}          # cm
    along::Matrix{Float64}      # (first hidden, state): first layer's flow part × [W b] or I
    on_grid::Array{Float64, 3}  # (first hidden, case, z): the rest of the first layer
    activations::Activations
end

function (rate::HiddenRate)(du, u, _, position)
    copyto!(du, last_hidden!(rate, u, position))
    return nothing
end

function last_hidden!(rate::HiddenRate, u, position)
    a, cases = rate.activations, size(u, 2)
    interpolate_grid!(a.before[1], rate.on_grid, rate.z, position)
    mul!(a.before[1], rate.along, u, 1.0, 1.0)
    forward!(a, rate.network, cases)
    return a.after[end]
end

"""
    interval(z, position)

Index of the grid's interval that contains a position, and the fraction of it before the
position.
"""
function interval(z::Vector{Float64}, position::Float64)
    i = clamp(searchsortedlast(z, position), 1, length(z) - 1)
    return i, (position - z[i]) / (z[i + 1] - z[i])
end

"""
    interpolate_grid!(result, on_grid, z, position)

Interpolate `on_grid` (…, …, z) linearly to a position.
"""
function interpolate_grid!(result, on_grid, z, position)
    i, fraction = interval(z, position)
    count = length(result)
    left, right = (i - 1) * count, i * count
    @inbounds @simd for k in 1:count
        result[k] = (1 - fraction) * on_grid[left + k] + fraction * on_grid[right + k]
    end
    return result
end

"""
    FlowNorm(inflow, output_map, atol, rtol, buffers..., state_before, state_after)

Root-mean-square error of a step, measured on Q of all cases and relative to
`atol + rtol·|Q|`, which is the suite's norm when Q itself is the state. A step is accepted
if the norm is at most 1.
"""
mutable struct FlowNorm{L} <: Function
    const inflow::Matrix{Float64}   # (time, case)
    const output_map::L             # [W b] (time, state), or I
    const atol::Float64
    const rtol::Float64
    const flow_before::Matrix{Float64}
    const flow_after::Matrix{Float64}
    const flow_error::Matrix{Float64}
    state_before::Matrix{Float64}   # arrays of the integrator, set after its creation
    state_after::Matrix{Float64}
end

(norm::FlowNorm)(value::Number, _) = abs(value)

function (norm::FlowNorm)(error::AbstractArray, _)
    (; flow_before, flow_after, flow_error, atol, rtol) = norm
    mul!(copyto!(flow_before, norm.inflow), norm.output_map, norm.state_before, 1.0, 1.0)
    mul!(copyto!(flow_after, norm.inflow), norm.output_map, norm.state_after, 1.0, 1.0)
    mul!(flow_error, norm.output_map, error)
    total = 0.0
    @inbounds @simd for k in eachindex(flow_error)
        size = max(abs(flow_before[k]), abs(flow_after[k]))
        total += abs2(flow_error[k] / (atol + rtol * size))
    end
    return sqrt(total / length(flow_error))
end

"""
    Trajectory()

Accepted steps of a solve: start, length, state at the start and the seven slopes of each. Its
arrays are reused from one solve to the next.
"""
mutable struct Trajectory
    count::Int
    const starts::Vector{Float64}
    const lengths::Vector{Float64}
    const states::Vector{Vector{Float64}}   # (state·case)
    const slopes::Vector{Matrix{Float64}}   # (state·case, 7)
end

Trajectory() = Trajectory(0, Float64[], Float64[], Vector{Float64}[], Matrix{Float64}[])

function add_step!(trajectory::Trajectory, start, step_length, state, slopes)
    j = trajectory.count += 1
    if j > length(trajectory.starts)
        push!(trajectory.starts, 0.0)
        push!(trajectory.lengths, 0.0)
        push!(trajectory.states, zeros(length(state)))
        push!(trajectory.slopes, zeros(length(state), 7))
    end
    trajectory.starts[j], trajectory.lengths[j] = start, step_length
    copyto!(trajectory.states[j], state)
    target = trajectory.slopes[j]
    for i in 1:7
        copyto!(target, (i - 1) * length(state) + 1, slopes[i], 1, length(state))
    end
    return trajectory
end

"""
    FlowProblem(inflow, area, target, z, stage, terms = nothing)

Momentum equation of several cases that share their steps, an [`Objective`](@ref).

# Arguments

  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area`: S, cm², (z, time, case); linear in z between the points.
  - `target`: reference Q of the loss, mL/s, (z, time, case); zeros if the loss is not needed.
  - `z`: points, cm.
  - `stage`: a [`FlowStage`](@ref).
  - `terms`: [`physics_terms`](@ref) of the stage, or `nothing`.

# Throws

`ArgumentError` if exactly one of the stage and `terms` has terms.
"""
struct FlowProblem{T, L, I} <: Objective
    stage::FlowStage
    z::Vector{Float64}
    inflow::Matrix{Float64}         # (time, case)
    area::Matrix{Float64}           # (time, case·z)
    offset::Matrix{Float64}         # (time, case·z): Q_in − target
    network::Network
    rate::HiddenRate
    terms::T                        # `nothing`, or a `TermsRate`
    output_map::L                   # Q = Q_in + output_map·state: [W b], or I
    norm::FlowNorm{L}
    integrator::I
    trajectory::Trajectory
    interpolation::Matrix{Float64}  # (z, 7): weights of a step's slopes, times its length
    step_of::Vector{Int}            # (z): index of the step that contains each point
    states::Matrix{Float64}         # (state, case·z)
    residual::Matrix{Float64}       # (time, case·z): Q − target, times root_weight for a loss
    root_weight::Vector{Float64}    # (case): roots of the squares' weights
    workspace::FlowGradientWorkspace
end

function FlowProblem(
    inflow::Matrix{Float64},
    area::Array{Float64, 3},
    target::Array{Float64, 3},
    z::Vector{Float64},
    stage::FlowStage,
    terms = nothing,
)
    if isempty(stage.terms) != isnothing(terms)
        throw(ArgumentError("the flow stage has the terms $(stage.terms), given is $terms"))
    end
    n_times, n_cases, n_points = size(inflow, 1), size(inflow, 2), length(z)
    widths = [2 * n_times; stage.hidden; n_times]
    network = Network(chain(widths, stage.activation))
    n_state = isnothing(terms) ? stage.hidden[end] + 1 : n_times
    output_map = isnothing(terms) ? network.matrices[end] : I
    rate = HiddenRate(
        network,
        z,
        zeros(stage.hidden[1], n_state),
        zeros(stage.hidden[1], n_cases, n_points),
        Activations(stage.hidden, n_cases),
    )
    flow_buffer() = zeros(n_times, n_cases)
    grid_buffer() = zeros(n_times, n_cases * n_points)
    area_on_grid = grid_buffer()
    with_terms = isnothing(terms) ? nothing : TermsRate(terms, rate, inflow, area_on_grid)
    state = zeros(n_state, n_cases)
    norm = FlowNorm(
        inflow, output_map, stage.atol, stage.rtol,
        flow_buffer(), flow_buffer(), flow_buffer(), state, state,
    )
    equation = ODEProblem{true, SciMLBase.FullSpecialize}(
        something(with_terms, rate), state, (z[1], z[end]),
    )
    integrator = init(
        equation,
        Tsit5();
        dt = initial_step(stage, z),
        adaptive = isnothing(stage.steps),
        # The norm applies the tolerances, to Q.
        abstol = 1.0,
        reltol = 0.0,
        internalnorm = norm,
        controller = StepControl(),
        maxiters = isnothing(stage.steps) ? stage.max_steps : typemax(Int),
        # A value that is not finite is treated like a large error: the step is reduced.
        unstable_check = never_unstable,
        save_on = false,
        save_start = false,
        save_end = false,
        dense = false,
        verbose = SciMLLogging.None(),
    )
    norm.state_before, norm.state_after = integrator.uprev, integrator.u
    problem = FlowProblem(
        stage,
        z,
        inflow,
        area_on_grid,
        grid_buffer(),
        network,
        rate,
        with_terms,
        output_map,
        norm,
        integrator,
        Trajectory(),
        zeros(n_points, 7),
        zeros(Int, n_points),
        zeros(n_state, n_cases * n_points),
        grid_buffer(),
        ones(n_cases),
        FlowGradientWorkspace(n_state, stage.hidden, n_cases, n_points),
    )
    return set_cases!(problem, inflow, area, target)
end

never_unstable(_...) = false

function initial_step(stage::FlowStage, z)
    (; steps, first_step) = stage
    return isnothing(steps) ? something(first_step, z[2] - z[1]) : (z[end] - z[1]) / steps
end

function set_cases!(problem::FlowProblem, inflow, area, target)
    shape = (size(problem.inflow)..., length(problem.z))
    copyto!(problem.inflow, inflow)
    permutedims!(reshape(problem.area, shape), area, (2, 3, 1))
    permutedims!(reshape(problem.offset, shape), target, (2, 3, 1))
    reshape(problem.offset, shape) .= problem.inflow .- reshape(problem.offset, shape)
    isnothing(problem.terms) || set_area_slope!(problem.terms, area)
    return problem
end

"""
    integrate!(problem, parameters)

Solve from the inlet to the outlet, store the steps, and compute the states at the points of
the grid. Return whether the solve reached the outlet.
"""
function integrate!(problem::FlowProblem, parameters::AbstractVector{Float64})
    load!(problem.network, parameters)
    first_layer_on_grid!(problem)
    return integrate_steps!(problem)
end

"""
    integrate_steps!(problem)

Do the same as [`integrate!`](@ref) when the network and its first layer on the grid are set.
"""
function integrate_steps!(problem::FlowProblem)
    (; stage, z, integrator, trajectory) = problem
    SciMLBase.reinit!(integrator; reset_dt = false)
    SciMLBase.set_proposed_dt!(integrator, initial_step(stage, z))
    integrator.dt = initial_step(stage, z)
    trajectory.count = 0
    while integrator.t < z[end]
        SciMLBase.successful_retcode(step!(integrator)) || return false
        step_length = integrator.t - integrator.tprev
        add_step!(trajectory, integrator.tprev, step_length, integrator.uprev, integrator.k)
    end
    interpolate!(problem)
    return all(isfinite, problem.states)
end

function first_layer_on_grid!(problem::FlowProblem)
    (; inflow, area, network, rate, output_map) = problem
    n_times = size(inflow, 1)
    first = network.matrices[1]
    from_flow = view(first, :, 1:n_times)
    from_area = view(first, :, (n_times + 1):(2 * n_times))
    mul!(rate.along, from_flow, output_map)
    on_grid = rate.on_grid
    mul!(reshape(on_grid, size(on_grid, 1), :), from_area, area)
    constant = problem.workspace.constant
    mul!(constant, from_flow, inflow)
    constant .+= view(first, :, 2 * n_times + 1)
    on_grid .+= constant
    return nothing
end

"""
    interpolate!(problem)

Compute the states at the points of the grid by Tsit5's interpolant of order four.
"""
function interpolate!(problem::FlowProblem)
    (; z, trajectory, interpolation, step_of, states) = problem
    n_points = length(z)
    flat = reshape(states, :, n_points)
    step_of[1] = 0
    fill!(view(flat, :, 1), 0.0)
    point = 2
    for j in 1:(trajectory.count)
        start, step_length = trajectory.starts[j], trajectory.lengths[j]
        first = point
        while point <= n_points && (j == trajectory.count || z[point] <= start + step_length)
            step_of[point] = j
            fraction = (z[point] - start) / step_length
            for i in 1:7
                interpolation[point, i] = step_length * interpolation_weight(i, fraction)
            end
            point += 1
        end
        points = first:(point - 1)
        isempty(points) && continue
        inside = view(flat, :, points)
        inside .= trajectory.states[j]
        mul!(inside, trajectory.slopes[j], view(interpolation, points, :)', 1.0, 1.0)
    end
    return states
end

"""
    residual!(problem)

Compute Q − target, mL/s, (time, case·z), from the states.
"""
function residual!(problem::FlowProblem)
    (; offset, residual, output_map, states) = problem
    mul!(copyto!(residual, offset), output_map, states, 1.0, 1.0)
    return residual
end

set_weight!(problem::FlowProblem, weight) = (problem.root_weight .= sqrt.(weight); problem)

"""
    apply_weights!(problem)

Multiply the residual by the roots of the weights of the cases.
"""
function apply_weights!(problem::FlowProblem)
    residual, root = problem.residual, problem.root_weight
    by_case = reshape(residual, size(residual, 1), length(root), :)
    by_case .*= reshape(root, 1, :)
    return residual
end

function loss_scale(problem::FlowProblem)
    problem.stage.loss == "mean" || return 1.0
    mean_weight = sum(abs2, problem.root_weight) / length(problem.root_weight)
    return 1 / (length(problem.residual) * mean_weight)
end

function value!(problem::FlowProblem, parameters)
    integrate!(problem, parameters) || return Inf
    residual!(problem)
    residual = apply_weights!(problem)
    return loss_scale(problem) * dot(residual, residual)
end

"""
    solve_flow(parameters, inflow, area, z, stage, terms = nothing)

Q, mL/s, (z, time, case). Each case has its own steps, so that its result does not depend on
the other cases. The arguments are those of [`FlowProblem`](@ref).

# Throws

`SolveError` if a case cannot be integrated.
"""
function solve_flow(
    parameters::Vector{Float64},
    inflow::Matrix{Float64},
    area::Array{Float64, 3},
    z::Vector{Float64},
    stage::FlowStage,
    terms = nothing,
)
    flow = similar(area)
    n_points, n_times, n_cases = size(area)
    zero_target = zeros(n_points, n_times, 1)
    threaded_batches(n_cases) do batches
        problem = FlowProblem(inflow[:, 1:1], area[:, :, 1:1], zero_target, z, stage, terms)
        for batch in batches, case in batch
            single = case:case
            set_cases!(problem, view(inflow, :, single), @view(area[:, :, single]), zero_target)
            integrate!(problem, parameters) || throw(divergence(case))
            flow[:, :, case] .= residual!(problem)'
        end
    end
    return flow
end

divergence(case) = SolveError(
    "The equation could not be integrated for case $(case - 1): the step became too small " *
    "or a value not finite. Check the inflow's and area's units (mL/s, cm²) and that they " *
    "resemble the training data.",
)
