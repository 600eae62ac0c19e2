# Momentum equation ∂Q/∂t = f_θ(Q) or f_θ(Q, t): the classical Runge–Kutta method in time,
# where Q_in replaces the value at the inlet after each step. The gradient is that of the
# discrete steps (discretize, then optimize).

"""
    TemporalFlow(inflow, initial_flow, target, period, stage)

Squared error of the flow in time, an [`Objective`](@ref).

# Arguments

  - `inflow`: Q(z=0, t), mL/s, (time, case); linear between the time points.
  - `initial_flow`: Q at the first time point, mL/s, (z, case).
  - `target`: Q, mL/s, (z, time, case); zeros if the loss is not needed.
  - `period`: cycle length, s.
  - `stage`: a [`TemporalFlowStage`](@ref).
"""
struct TemporalFlow <: Objective
    stage::TemporalFlowStage
    network::Network
    inflow::Matrix{Float64}
    step::Float64                   # s
    flows::Array{Float64, 3}        # (z, case, step): Q before each step, and after the last
    target::Array{Float64, 3}       # (z, case, time)
    stages::NTuple{4, Matrix{Float64}}          # the four slopes of a step, (z, case)
    inputs::NTuple{4, Matrix{Float64}}          # (inputs + 1, case), with a row of ones
    activations::NTuple{4, Activations}
    grad_flow::Matrix{Float64}      # derivative of the loss with respect to Q after the step
    grad_slope::Matrix{Float64}     # … to a slope
    grad_input::Matrix{Float64}     # … to the network's input for that slope
    deltas::Vector{Matrix{Float64}} # … to the hidden layers
end

function TemporalFlow(
    inflow::Matrix{Float64},
    initial_flow::Matrix{Float64},
    target::Array{Float64, 3},
    period::Float64,
    stage::TemporalFlowStage,
)
    (n_times, n_cases), n_points = size(inflow), size(initial_flow, 1)
    n_inputs = n_points + stage.time_input
    network = Network(chain([n_inputs; stage.hidden; n_points], stage.activation))
    flows = zeros(n_points, n_cases, (n_times - 1) * stage.steps + 1)
    flows[:, :, 1] .= initial_flow
    flows[1, :, 1] .= inflow[1, :]
    flow_buffer() = zeros(n_points, n_cases)
    return TemporalFlow(
        stage,
        network,
        inflow,
        period / (n_times * stage.steps),
        flows,
        permutedims(target, (1, 3, 2)),
        ntuple(_ -> flow_buffer(), 4),
        ntuple(_ -> ones(n_inputs + 1, n_cases), 4),
        ntuple(_ -> Activations(stage.hidden, n_cases), 4),
        flow_buffer(),
        flow_buffer(),
        zeros(n_inputs + 1, n_cases),
        [zeros(width, n_cases) for width in stage.hidden],
    )
end

const RK4_POSITIONS = (0.0, 0.5, 0.5, 1.0)         # positions of the slopes in a step
const RK4_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)

"""
    evaluate_slopes!(problem, number)

Compute the four slopes of step `number`, counted from 1, and the network's inputs for them,
from the flow before the step.
"""
function evaluate_slopes!(problem::TemporalFlow, number)
    (; stage, network, inflow, step, flows, stages, inputs, activations) = problem
    n_points, period = size(flows, 1), size(inflow, 1) * stage.steps * step
    before = view(flows, :, :, number)
    for i in 1:4
        input, a = inputs[i], activations[i]
        at = view(input, 1:n_points, :)
        copyto!(at, before)
        i > 1 && axpy!(step * RK4_POSITIONS[i], stages[i - 1], at)
        if stage.time_input
            elapsed = (number - 1 + RK4_POSITIONS[i]) * step
            input[n_points + 1, :] .= elapsed / period
        end
        mul!(a.before[1], network.matrices[1], input)
        forward!(a, network, size(before, 2))
        mul!(stages[i], network.matrices[end], a.after[end])
    end
    return stages
end

"""
    integrate!(problem, parameters)

Integrate over the cycle; return whether every value is finite.
"""
function integrate!(problem::TemporalFlow, parameters::AbstractVector{Float64})
    (; stage, network, inflow, step, flows) = problem
    load!(network, parameters)
    for number in 1:(size(flows, 3) - 1)
        slopes = evaluate_slopes!(problem, number)
        after = copyto!(view(flows, :, :, number + 1), view(flows, :, :, number))
        for (weight, slope) in zip(RK4_WEIGHTS, slopes)
            axpy!(step * weight, slope, after)
        end
        time_point, substep = fldmod(number, stage.steps)
        fraction = substep / stage.steps
        for case in axes(inflow, 2)
            inlet = inflow[time_point + 1, case]
            if substep != 0
                next = inflow[time_point + 2, case]
                inlet = (1 - fraction) * inlet + fraction * next
            end
            after[1, case] = inlet
        end
    end
    return all(isfinite, view(flows, :, :, size(flows, 3)))
end

"""
    at_time_points(problem)

Flow at the time points of the cycle, (z, case, time).
"""
at_time_points(problem::TemporalFlow) =
    view(problem.flows, :, :, 1:(problem.stage.steps):size(problem.flows, 3))

function value!(problem::TemporalFlow, parameters)
    integrate!(problem, parameters) || return Inf
    return squared_error(problem)
end

squared_error(problem::TemporalFlow) =
    mapreduce((q, target) -> abs2(q - target), +, at_time_points(problem), problem.target) /
    length(problem.target)

function value_and_gradient!(gradient, problem::TemporalFlow, parameters)
    if !integrate!(problem, parameters)
        fill!(gradient, NaN)
        return Inf
    end
    (; stage, step, flows, target, grad_flow, grad_slope, grad_input) = problem
    fill!(gradient, 0.0)
    blocks = layer_blocks(gradient, problem.network)
    fill!(grad_flow, 0.0)
    at_points = view(grad_input, 1:size(flows, 1), :)
    after = similar(grad_flow)
    for number in (size(flows, 3) - 1):-1:1
        time_point, substep = fldmod(number, stage.steps)
        if substep == 0
            grad_flow .+=
                (2 / length(target)) .*
                (view(flows, :, :, number + 1) .- view(target, :, :, time_point + 1))
        end
        # The value at the inlet after the step does not depend on the step.
        grad_flow[1, :] .= 0.0
        evaluate_slopes!(problem, number)
        copyto!(after, grad_flow)
        for i in 4:-1:1
            grad_slope .= (step * RK4_WEIGHTS[i]) .* after
            i < 4 && axpy!(step * RK4_POSITIONS[i + 1], at_points, grad_slope)
            evaluation_vjp!(blocks, problem, i)
            grad_flow .+= at_points
        end
    end
    return squared_error(problem)
end

"""
    evaluation_vjp!(blocks, problem, i)

Vector–Jacobian product of slope `i` of the current step: compute `grad_input` from
`grad_slope`, and add the contributions to the gradient's `blocks`.
"""
function evaluation_vjp!(blocks, problem::TemporalFlow, i)
    (; network, inputs, activations, grad_slope, grad_input, deltas) = problem
    (; before, after) = activations[i]
    σ, above, top = network.activation, grad_slope, length(deltas)
    for layer in top:-1:1
        matrix = network.matrices[layer + 1]
        mul!(blocks[layer + 1], above, after[layer]', 1.0, 1.0)
        delta = deltas[layer]
        mul!(delta, view(matrix, :, 1:size(delta, 1))', above)
        times_derivative!(delta, delta, before[layer], after[layer], σ)
        above = delta
    end
    mul!(blocks[1], above, inputs[i]', 1.0, 1.0)
    mul!(grad_input, network.matrices[1]', above)
    return nothing
end

"""
    solve_temporal_flow(parameters, inflow, initial_flow, period, stage)

Q, mL/s, (z, time, case); the arguments are those of [`TemporalFlow`](@ref).

# Throws

`SolveError` if a case does not stay finite.
"""
function solve_temporal_flow(parameters, inflow, initial_flow, period, stage::TemporalFlowStage)
    (n_times, n_cases), n_points = size(inflow), size(initial_flow, 1)
    flow = zeros(n_points, n_times, n_cases)
    zero_target = zeros(n_points, n_times, 1)
    threaded_batches(n_cases) do batches
        for batch in batches, case in batch
            single = case:case
            problem = TemporalFlow(
                inflow[:, single], initial_flow[:, single], zero_target, period, stage,
            )
            integrate!(problem, parameters) || throw(divergence(case))
            flow[:, :, case] .= view(at_time_points(problem), :, 1, :)
        end
    end
    return flow
end
