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
from a scaled identity as inverse Hessian.

# Arguments

  - `start`: flat parameter vector.
  - `settings`: an [`Optimiser`](@ref).
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
        settings::Optimiser,
        iterations::Integer,
        on_iteration = nothing,
    )
    differentiable = OnceDifferentiable(
        x -> value!(objective, x),
        (g, x) -> value_and_gradient!(g, objective, x),
        (g, x) -> value_and_gradient!(g, objective, x),
        start,
    )
    record = Record(copy(start), Float64[], on_iteration)
    method = BFGS(;
        linesearch = BackTracking(;
            c_1 = settings.sufficient_decrease,
            ρ_hi = settings.shrink_least,
            ρ_lo = settings.shrink_most,
            iterations = settings.max_backtracks,
            order = 3,
        ),
        initial_invH = ScaledIdentity(settings.initial_step_norm, differentiable),
    )
    options = Optim.Options(;
        iterations,
        g_abstol = settings.gradient_tolerance,
        successive_f_tol = 0,
        show_warnings = false,
        callback = record,
    )
    result = Optim.optimize(differentiable, start, method, options)
    code = Optim.termination_code(result)
    converged = code in CONVERGED
    message = get(MESSAGES, code, "loss or gradient not finite")
    return (; record.parameters, record.losses, converged, message)
end

"""
    ScaledIdentity(step_norm, differentiable)

Optim's `initial_stepnorm`, for a matrix that is not dense: `step_norm / max|g|`·I at the
last gradient. Like [`Record`](@ref), of the same type for every objective.
"""
struct ScaledIdentity{D}
    step_norm::Float64
    differentiable::D
end

function (initial::ScaledIdentity)(x)
    gradient = NLSolversBase.gradient(initial.differentiable)
    return InverseHessian(initial.step_norm / norm(gradient, Inf), length(x))
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
    Optim.TerminationCode.FailedLinesearch => "line search found no lower loss",
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
