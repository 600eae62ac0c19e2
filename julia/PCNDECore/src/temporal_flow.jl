# Momentum equation ∂Q/∂t = f_θ(Q) or f_θ(Q, t): the classical Runge–Kutta method in time,
# with the inlet's value replaced by Q_in after each step. The gradient is that of the steps
# as they are taken: discretise, then optimise.

"""
    TemporalFlow(inflow, initial_flow, target, period, stage)

Squared error of the flow in time, an [`Objective`](@ref).

# Arguments

  - `inflow`: Q(z=0, t), mL/s, (time, case); linear in time between the instants.
  - `initial_flow`: Q at the first instant, mL/s, (z, case).
  - `target`: Q, mL/s, (z, time, case); zeros will do where no loss is wanted.
  - `period`: s.
  - `stage`: a [`TemporalFlowStage`](@ref).
"""
struct TemporalFlow{F} <: Objective
    stage::TemporalFlowStage
    network::Network{F}
    inflow::Matrix{Float64}
    step::Float64                   # s
    flows::Array{Float64, 3}        # (z, case, step): Q before each step, and after the last
    target::Array{Float64, 3}       # (z, case, time)
    stages::NTuple{4, Matrix{Float64}}          # the four slopes of a step, (z, case)
    inputs::NTuple{4, Matrix{Float64}}          # (inputs + 1, case), with a row of ones below
    activations::NTuple{4, Activations}
    by_flow::Matrix{Float64}        # the loss's derivative by Q after the step
    by_slope::Matrix{Float64}       # … by a slope
    by_input::Matrix{Float64}       # … by what the slope was taken at
    deltas::Vector{Matrix{Float64}} # … by the hidden layers
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
    like_flow() = zeros(n_points, n_cases)
    return TemporalFlow(
        stage,
        network,
        inflow,
        period / (n_times * stage.steps),
        flows,
        permutedims(target, (1, 3, 2)),
        ntuple(_ -> like_flow(), 4),
        ntuple(_ -> ones(n_inputs + 1, n_cases), 4),
        ntuple(_ -> Activations(stage.hidden, n_cases), 4),
        like_flow(),
        like_flow(),
        zeros(n_inputs + 1, n_cases),
        [zeros(width, n_cases) for width in stage.hidden],
    )
end

const RK4_AT = (0.0, 0.5, 0.5, 1.0)         # where a step's slopes are taken
const RK4_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)

"""
    take_slopes!(problem, number)

The four slopes of a step, from 1, from the flow before it; also what they are taken at.
"""
function take_slopes!(problem::TemporalFlow, number)
    (; stage, network, inflow, step, flows, stages, inputs, activations) = problem
    n_points, period = size(flows, 1), size(inflow, 1) * stage.steps * step
    before = view(flows, :, :, number)
    for i in 1:4
        input, a = inputs[i], activations[i]
        at = view(input, 1:n_points, :)
        copyto!(at, before)
        i > 1 && axpy!(step * RK4_AT[i], stages[i - 1], at)
        if stage.time_input
            passed = (number - 1 + RK4_AT[i]) * step
            input[n_points + 1, :] .= passed / period
        end
        mul!(a.before[1], network.matrices[1], input)
        forward!(a, network, size(before, 2))
        mul!(stages[i], network.matrices[end], a.after[end])
    end
    return stages
end

"""
    integrate!(problem, parameters)

All steps of the cycle; returns whether every value is finite.
"""
function integrate!(problem::TemporalFlow, parameters::AbstractVector{Float64})
    (; stage, network, inflow, step, flows) = problem
    load!(network, parameters)
    for number in 1:(size(flows, 3) - 1)
        slopes = take_slopes!(problem, number)
        after = copyto!(view(flows, :, :, number + 1), view(flows, :, :, number))
        for (weight, slope) in zip(RK4_WEIGHTS, slopes)
            axpy!(step * weight, slope, after)
        end
        instant, passed = fldmod(number, stage.steps)
        share = passed / stage.steps
        for case in axes(inflow, 2)
            now = inflow[instant + 1, case]
            after[1, case] =
                passed == 0 ? now : (1 - share) * now + share * inflow[instant + 2, case]
        end
    end
    return all(isfinite, view(flows, :, :, size(flows, 3)))
end

"""
    at_instants(problem)

The flow at the cycle's instants, (z, case, time).
"""
at_instants(problem::TemporalFlow) =
    view(problem.flows, :, :, 1:(problem.stage.steps):size(problem.flows, 3))

function value!(problem::TemporalFlow, parameters)
    integrate!(problem, parameters) || return Inf
    return squared_error(problem)
end

squared_error(problem::TemporalFlow) =
    mapreduce((q, target) -> abs2(q - target), +, at_instants(problem), problem.target) /
    length(problem.target)

function value_and_gradient!(gradient, problem::TemporalFlow, parameters)
    if !integrate!(problem, parameters)
        fill!(gradient, NaN)
        return Inf
    end
    (; stage, step, flows, target, by_flow, by_slope, by_input) = problem
    fill!(gradient, 0.0)
    parts = parts_of(gradient, problem.network)
    fill!(by_flow, 0.0)
    at_points = view(by_input, 1:size(flows, 1), :)
    after = similar(by_flow)
    for number in (size(flows, 3) - 1):-1:1
        instant, passed = fldmod(number, stage.steps)
        if passed == 0
            by_flow .+=
                (2 / length(target)) .*
                (view(flows, :, :, number + 1) .- view(target, :, :, instant + 1))
        end
        # The inlet's value after the step does not depend on the step.
        by_flow[1, :] .= 0.0
        take_slopes!(problem, number)
        copyto!(after, by_flow)
        for i in 4:-1:1
            by_slope .= (step * RK4_WEIGHTS[i]) .* after
            i < 4 && axpy!(step * RK4_AT[i + 1], at_points, by_slope)
            back!(parts, problem, i)
            by_flow .+= at_points
        end
    end
    return squared_error(problem)
end

"""
    back!(parts, problem, i)

Vector–Jacobian product of slope `i` of the present step: from `by_slope` to `by_input`, and
to the gradient's parts, which it adds to.
"""
function back!(parts, problem::TemporalFlow, i)
    (; network, inputs, activations, by_slope, by_input, deltas) = problem
    (; before, after) = activations[i]
    σ, above, top = network.activation, by_slope, length(deltas)
    for layer in top:-1:1
        matrix = network.matrices[layer + 1]
        mul!(parts[layer + 1], above, after[layer]', 1.0, 1.0)
        delta = deltas[layer]
        mul!(delta, view(matrix, :, 1:size(delta, 1))', above)
        times_derivative!(delta, delta, before[layer], after[layer], σ)
        above = delta
    end
    mul!(parts[1], above, inputs[i]', 1.0, 1.0)
    mul!(by_input, network.matrices[1]', above)
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
    no_target = zeros(n_points, n_times, 1)
    over_cases(n_cases) do parts
        for part in parts, case in part
            one = case:case
            problem =
                TemporalFlow(inflow[:, one], initial_flow[:, one], no_target, period, stage)
            integrate!(problem, parameters) || throw(divergence(case))
            flow[:, :, case] .= view(at_instants(problem), :, 1, :)
        end
    end
    return flow
end
