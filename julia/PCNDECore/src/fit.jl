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

Minimize an [`Objective`](@ref) by `Optim.BFGS` with the `BackTracking` line search, from a
scaled identity as inverse Hessian. Where the line search finds no lower loss, the inverse
Hessian is reset and steepest descent is tried once, as newer versions of Optim and the
package's JAX engine do; Optim 2.0 alone would end the fit. See
[`RestartingLineSearch`](@ref).

# Arguments

  - `start`: flat parameter vector.
  - `settings`: an [`Optimizer`](@ref).
  - `iterations`: largest number of iterations.
  - `on_iteration`: called with each iteration's number, from 1, and its loss. An exception
    ends the fit and is rethrown.

# Returns

`(; parameters, losses, converged, message)`: the last accepted iterate, the losses at the
start and after each iteration, and the reason for the end of the fit.

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
    record = IterationRecord(copy(start), Float64[], on_iteration)
    linesearch = RestartingLineSearch(
        backtracking(settings),
        settings.initial_step_norm,
        differentiable,
        InverseHessian(1.0, length(start)),
        false,
    )
    method = BFGS(; linesearch, initial_invH = _ -> reset!(linesearch))
    limits = options(settings, iterations, record)
    result = Optim.optimize(differentiable, start, method, limits)
    return outcome(result, record, linesearch.failed)
end

backtracking(settings::Optimizer) = BackTracking(;
    c_1 = settings.sufficient_decrease,
    ρ_hi = settings.shrink_least,
    ρ_lo = settings.shrink_most,
    iterations = settings.max_backtracks,
    order = 3,
)

options(settings::Optimizer, iterations, callback) = Optim.Options(;
    iterations,
    g_abstol = settings.gradient_tolerance,
    successive_f_tol = 0,
    show_warnings = false,
    callback,
)

"""
    outcome(result, record, failed)

Result of a [`fit`](@ref); `failed` is whether a line search found no lower loss.
"""
function outcome(result, record, failed)
    code = Optim.termination_code(result)
    # A failed line search leaves the loss unchanged, which Optim reports as convergence.
    converged = code in CONVERGED && !failed
    message = get(MESSAGES, code, "loss or gradient not finite")
    failed && (message = "line search found no lower loss")
    return (; record.parameters, record.losses, converged, message)
end

"""
    RestartingLineSearch(search, step_norm, differentiable, inverse_hessian, failed)

Line search that, where `search` finds no lower loss, resets `inverse_hessian`, which must be
the optimizer's own, and searches once more along steepest descent. Its type is the same for
every objective, so that Optim is compiled once.
"""
mutable struct RestartingLineSearch{L, D}
    const search::L
    const step_norm::Float64
    const differentiable::D
    const inverse_hessian::InverseHessian
    failed::Bool
end

# The signature is Optim's; Optim uses the direction `s` as it is after this call.
function (line::RestartingLineSearch)(objective, x, s, step, buffer, loss, slope)
    accepted = search(line, objective, x, s, step, buffer, loss, slope)
    isnothing(accepted) || return accepted
    reset!(line)
    s .= .-NLSolversBase.gradient(line.differentiable)
    accepted = search(line, objective, x, s, step, buffer, loss, -dot(s, s))
    line.failed = isnothing(accepted)
    line.failed && throw(LineSearchException("no lower loss", step))
    return accepted
end

function search(line::RestartingLineSearch, arguments...)
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

Set the inverse Hessian to that of Optim's `initial_stepnorm`, `step_norm / max|g|`·I at the
last gradient.
"""
function reset!(line::RestartingLineSearch)
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
    IterationRecord(parameters, losses, on_iteration)

Callback that stores the losses of the accepted iterates and the last iterate, which Optim
discards when a line search fails, and calls `on_iteration`.
"""
struct IterationRecord
    parameters::Vector{Float64}
    losses::Vector{Float64}
    on_iteration::Any # of unspecified type, so that Optim is compiled once for all callbacks
end

function (record::IterationRecord)(state)
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
