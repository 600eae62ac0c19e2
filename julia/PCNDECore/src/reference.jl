# Reference implementation of the flow stage by the libraries alone, as the paper names them: Lux
# evaluates the network, OrdinaryDiffEq's Tsit5 steps the flow with its own controller, ForwardDiff
# or SciMLSensitivity differentiates the loss, and Optim's BFGS with its own dense matrix minimizes
# it. The kernels, the reduced state, the discrete adjoint and the implicit inverse Hessian of the
# other files compute the same faster, and are tested against this file.

"""
    ReferenceFlow(model, inflow, area, target, z, stage; gradient = forward_gradient)

Momentum equation ∂Q/∂z = f_θ(Q, S) with any Lux model as f_θ, an [`Objective`](@ref). The model
maps a matrix (2·time × case), flow above area, to ∂Q/∂z (time × case).

The cases share their steps in the loss; in [`solve`](@ref) each case has its own. The first
step is that of the [`FlowStage`](@ref), and the later ones are those of the suite's controller,
which grows every step by at most 10. Newer versions let the first one grow by up to 10 000.

# Arguments

  - `model`: a Lux model; by default, the `Chain` of the stage's widths and activation.
  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area`, `target`: S, cm², and reference Q, mL/s, (z, time, case); S is linear between the
    points.
  - `z`: points, cm.
  - `stage`: a [`FlowStage`](@ref), of which a given model ignores the widths and activation.
  - `gradient`: [`forward_gradient`](@ref), [`adjoint_gradient`](@ref), or another function of
    the problem and the parameters.

# Throws

`ArgumentError` if the stage has physics terms.
"""
struct ReferenceFlow{M, P, S, G} <: Objective
    model::M
    layout::P                 # positions of the model's parameters in the flat vector
    states::S
    inflow::Matrix{Float64}   # (time, case)
    area::Array{Float64, 3}   # (time, case, z)
    target::Array{Float64, 3} # (z, time, case)
    z::Vector{Float64}
    stage::FlowStage
    gradient::G
    weight::Vector{Float64}   # (case)
end

function ReferenceFlow(
    model, inflow, area, target, z, stage::FlowStage; gradient = forward_gradient,
)
    if !isempty(stage.terms)
        throw(ArgumentError("the reference implementation has no physics terms: remove them"))
    end
    parameters, states = Lux.setup(Random.default_rng(), model)
    by_point = permutedims(area, (2, 3, 1))
    weight = ones(size(inflow, 2))
    return ReferenceFlow(
        model, layout(parameters), states, inflow, by_point, target, z, stage, gradient, weight,
    )
end

function ReferenceFlow(inflow, area, target, z, stage::FlowStage; options...)
    widths = [2 * size(inflow, 1); stage.hidden; size(inflow, 1)]
    model = chain(widths, stage.activation)
    return ReferenceFlow(model, inflow, area, target, z, stage; options...)
end

function set_weight!(problem::ReferenceFlow, weight)
    copyto!(problem.weight, weight)
    return problem
end

"""
Position and size of one array in a flat vector.
"""
struct Piece{N}
    range::UnitRange{Int}
    size::NTuple{N, Int}
end

"""
    layout(parameters)

Replace every array of Lux's nested parameters by its [`Piece`](@ref) of a flat vector, which
contains the arrays one after the other, column by column.
"""
function layout(parameters)
    count = 0
    piece(array::AbstractArray) = Piece((count + 1):(count += length(array)), size(array))
    piece(nested) = map(piece, nested)
    return piece(parameters)
end

"""
    nested_parameters(layout, parameters)

Convert a flat parameter vector to Lux's nested parameters.
"""
nested_parameters(piece::Piece, θ) = reshape(θ[piece.range], piece.size)
nested_parameters(pieces, θ) = map(piece -> nested_parameters(piece, θ), pieces)

"""
    reference_solution(problem, parameters, cases; options...)

Q, mL/s, (z, time, case), with common steps of some cases, by default all, or `nothing` where the
equation cannot be integrated. `options` are passed to the solver.
"""
function reference_solution(
    problem::ReferenceFlow, parameters, cases = axes(problem.inflow, 2); options...,
)
    (; model, layout, states, area, z, stage) = problem
    function rate(q, θ, position)
        i, share = interval(z, position)
        s = (1 - share) .* area[:, cases, i] .+ share .* area[:, cases, i + 1]
        return first(Lux.apply(model, [q; s], nested_parameters(layout, θ), states))
    end
    start = eltype(parameters).(problem.inflow[:, cases])
    solution = SciMLBase.solve(
        ODEProblem{false}(rate, start, (z[1], z[end]), parameters), Tsit5();
        dt = initial_step(stage, z), adaptive = isnothing(stage.steps),
        abstol = stage.atol, reltol = stage.rtol, internalnorm = value_norm,
        controller = PIController(Tsit5(); qmax_first_step = 10),
        maxiters = isnothing(stage.steps) ? stage.max_steps : typemax(Int),
        saveat = z, verbose = SciMLLogging.None(), options...,
    )
    SciMLBase.successful_retcode(solution) || return nothing
    return permutedims(stack(solution.u), (3, 1, 2))
end

# The suite's norm, a root mean square, without the derivatives of dual numbers: the steps of the
# gradient are those of the loss.
value_norm(u::Number, _) = abs(ForwardDiff.value(u))
value_norm(u::AbstractArray, _) = sqrt(sum(abs2 ∘ ForwardDiff.value, u) / length(u))

"""
    reference_loss(problem, parameters; options...)

Weighted squared error of the flow; `Inf` where the equation cannot be integrated.
"""
function reference_loss(problem::ReferenceFlow, parameters; options...)
    solution = reference_solution(problem, parameters; options...)
    isnothing(solution) && return Inf
    (; target, weight) = problem
    total = sum(reshape(weight, 1, 1, :) .* abs2.(solution .- target))
    problem.stage.loss == "mean" || return total
    return total / (size(target, 1) * size(target, 2) * sum(weight))
end

value!(problem::ReferenceFlow, parameters) = reference_loss(problem, parameters)

function value_and_gradient!(gradient, problem::ReferenceFlow, parameters)
    loss = reference_loss(problem, parameters)
    isfinite(loss) && copyto!(gradient, problem.gradient(problem, parameters))
    return loss
end

"""
    forward_gradient(problem, parameters)

Gradient of [`reference_loss`](@ref) by ForwardDiff through network and solver: the exact
derivative of the computed loss. The paper's network takes some seconds.
"""
forward_gradient(problem::ReferenceFlow, parameters) =
    ForwardDiff.gradient(θ -> reference_loss(problem, θ), parameters)

"""
    adjoint_gradient(problem, parameters; sensealg)

Gradient of [`reference_loss`](@ref) by SciMLSensitivity, by default its `InterpolatingAdjoint`
with Zygote. It differs from [`forward_gradient`](@ref) by the error of the adjoint's solution.

# Throws

`ArgumentError` unless SciMLSensitivity and Zygote are loaded.
"""
adjoint_gradient(problem, parameters) = throw(
    ArgumentError(
        "adjoint_gradient needs SciMLSensitivity and Zygote: install both with " *
        "`import Pkg; Pkg.add([\"SciMLSensitivity\", \"Zygote\"])`, and load them with " *
        "`using SciMLSensitivity, Zygote`",
    ),
)

"""
    solve(problem, parameters)

Q, mL/s, (z, time, case), each case with its own steps.

# Throws

`SolveError` if a case cannot be integrated.
"""
function solve(problem::ReferenceFlow, parameters)
    flow = similar(problem.target)
    for case in axes(flow, 3)
        solution = reference_solution(problem, parameters, case:case)
        isnothing(solution) && throw(divergence(case))
        flow[:, :, case] = solution
    end
    return flow
end

"""
    fit(problem::ReferenceFlow, start, settings, iterations, on_iteration)

Minimize by Optim's `BFGS` with its own dense matrix and no restart; see [`fit`](@ref) for the
arguments and the result.
"""
function fit(
    problem::ReferenceFlow,
    start::Vector{Float64},
    settings::Optimizer,
    iterations::Integer,
    @nospecialize(on_iteration = nothing),
)
    record = IterationRecord(copy(start), Float64[], on_iteration)
    method = BFGS(;
        linesearch = backtracking(settings), initial_stepnorm = settings.initial_step_norm,
    )
    result = Optim.optimize(
        θ -> value!(problem, θ),
        (gradient, θ) -> value_and_gradient!(gradient, problem, θ),
        start, method, options(settings, iterations, record),
    )
    failed = Optim.iterations(result) < iterations && !Optim.g_converged(result)
    return outcome(result, record, failed)
end
