"""
    SolveError(message)

A differential equation could not be integrated to the end, or a fit cannot start.
"""
struct SolveError <: Exception
    message::String
end

Base.showerror(io::IO, error::SolveError) = print(io, error.message)

"""
    fit(objective, start, settings, iterations, on_iteration)

Minimise an [`Objective`](@ref) by `Optim.BFGS` with the `BackTracking` line search,
from a scaled identity as inverse Hessian. Where the line search finds no lower loss, the
curvature is forgotten and the steepest descent tried once, as newer versions of
Optim and the package's JAX engine do; Optim 2.0 alone would end the fit. See [`Restarting`](@ref).

# Arguments

  - `start`: flat parameter vector.
  - `settings`: an [`Optimizer`](@ref).
  - `iterations`: at most so many.
  - `on_iteration`: called with each iteration's number, from 1, and its loss; what it
    throws ends the fit and is thrown on.

# Returns

`(; parameters, losses, converged, message)`: the last accepted iterate, the losses at
the start and after each iteration, and why the fit ended.

# Throws

`SolveError` if the loss or its gradient is not finite at the start.
"""
function fit(
    objective::Objective,
    start::Vector{Float64},
    settings::Optimizer,
    iterations::Integer,
    @nospecialize(on_iteration = nothing),
)
    differentiable = OnceDifferentiable(
        x -> value!(objective, x),
        (g, x) -> value_and_gradient!(g, objective, x),
        (g, x) -> value_and_gradient!(g, objective, x),
        start,
    )
    record = Record(copy(start), Float64[], on_iteration)
    search = BackTracking(;
        c_1 = settings.sufficient_decrease,
        ρ_hi = settings.shrink_least,
        ρ_lo = settings.shrink_most,
        iterations = settings.max_backtracks,
        order = 3,
    )
    inverse_hessian = InverseHessian(1.0, length(start))
    step_norm = settings.initial_step_norm
    linesearch = Restarting(search, step_norm, differentiable, inverse_hessian, false)
    method = BFGS(; linesearch, initial_invH = _ -> reset!(linesearch))
    options = Optim.Options(;
        iterations,
        g_abstol = settings.gradient_tolerance,
        successive_f_tol = 0,
        show_warnings = false,
        callback = record,
    )
    result = Optim.optimize(differentiable, start, method, options)
    code = Optim.termination_code(result)
    # Optim calls a failed search, which leaves the loss as it was, converged.
    converged = code in CONVERGED && !linesearch.failed
    message = get(MESSAGES, code, "loss or gradient not finite")
    linesearch.failed && (message = "line search found no lower loss")
    return (; record.parameters, record.losses, converged, message)
end

"""
    Restarting(search, step_norm, differentiable, inverse_hessian, failed)

A line search that, where `search` finds no lower loss, resets `inverse_hessian`, which must
be the optimizer's own, and searches once more along the steepest descent. Like
[`Record`](@ref), of the same type for every objective.
"""
mutable struct Restarting{L, D}
    const search::L
    const step_norm::Float64
    const differentiable::D
    const inverse_hessian::InverseHessian
    failed::Bool
end

# Optim's arguments; Optim takes the direction `s` as this leaves it.
function (line::Restarting)(objective, x, s, step, room, loss, slope)
    found = search(line, objective, x, s, step, room, loss, slope)
    isnothing(found) || return found
    reset!(line)
    s .= .-NLSolversBase.gradient(line.differentiable)
    found = search(line, objective, x, s, step, room, loss, -dot(s, s))
    line.failed = isnothing(found)
    line.failed && throw(LineSearchException("no lower loss", step))
    return found
end

function search(line::Restarting, arguments...)
    try
        step, loss = line.search(arguments...)
        return isfinite(loss) ? (step, loss) : nothing
    catch error
        error isa LineSearchException || rethrow()
        return nothing
    end
end

"""
    reset!(line)

The inverse Hessian as Optim's `initial_stepnorm` sets it, `step_norm / max|g|`·I at the last
gradient.
"""
function reset!(line::Restarting)
    gradient = NLSolversBase.gradient(line.differentiable)
    scale = line.step_norm / norm(gradient, Inf)
    line.inverse_hessian .= InverseHessian(scale, length(gradient))
    return line.inverse_hessian
end

const CONVERGED = (
    Optim.TerminationCode.GradientNorm,
    Optim.TerminationCode.NoXChange,
    Optim.TerminationCode.NoObjectiveChange,
)

const MESSAGES = Dict(
    Optim.TerminationCode.GradientNorm => "gradient tolerance",
    Optim.TerminationCode.NoXChange => "no change",
    Optim.TerminationCode.NoObjectiveChange => "no change",
    Optim.TerminationCode.Iterations => "all iterations done",
)

"""
    Record(parameters, losses, on_iteration)

Optim's callback: keeps the accepted iterates' losses and the last of them, which Optim
itself leaves when a line search fails, and passes each on.
"""
struct Record
    parameters::Vector{Float64}
    losses::Vector{Float64}
    on_iteration::Any # of no particular type, so that Optim is compiled once for all
end

function (record::Record)(state)
    finite = isfinite(state.f_x) && all(isfinite, state.g_x)
    if isempty(record.losses) && !finite
        throw(
            SolveError(
                "The loss is not finite at the first parameters of the fit (loss " *
                "$(state.f_x)): the equation diverges there. Check the data's units, " *
                "or start from another seed.",
            ),
        )
    end
    finite || return true
    copyto!(record.parameters, state.x)
    push!(record.losses, state.f_x)
    number = length(record.losses) - 1
    if number > 0 && record.on_iteration !== nothing
        record.on_iteration(number, state.f_x)
    end
    return false
end
