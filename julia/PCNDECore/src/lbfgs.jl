"""
    lbfgs(objective, start, memory, iterations, after)

Minimize a function by `Optim.LBFGS` with the `MoreThuente` line search, without restarts,
until its loss no longer decreases. Exceptions of either function are rethrown.

# Arguments

  - `objective`: called with a point and a vector, which it fills with the loss, which must be
    finite, and the gradient; it may be a Python function.
  - `start`: first iterate; the first trial step from it has length one.
  - `memory`: number of stored pairs of steps and gradient changes.
  - `iterations`: largest number of iterations.
  - `after`: called with each accepted iterate and its loss.
"""
function lbfgs(
    @nospecialize(objective), start::Vector{Float64}, memory::Integer, iterations::Integer,
    @nospecialize(after)
)
    cached = CachedObjective(objective, fill(NaN, length(start)), zeros(1 + length(start)))
    differentiable = OnceDifferentiable(
        x -> evaluate!(cached, x)[1],
        (g, x) -> copyto!(g, 1, evaluate!(cached, x), 2, length(g)),
        (g, x) -> (copyto!(g, 1, evaluate!(cached, x), 2, length(g)); cached.result[1]),
        start,
    )
    linesearch = BestStepLineSearch(MoreThuente(; x_tol = 0.1), cached)
    method = LBFGS(; m = memory, alphaguess = unit_step!, linesearch)
    options = Optim.Options(;
        iterations,
        g_abstol = 0.0,
        successive_f_tol = 0,
        show_warnings = false,
        callback = IterateCallback(after, false),
    )
    Optim.optimize(differentiable, start, method, options)
    return nothing
end

"""
    CachedObjective(objective, point, result)

Objective that caches loss and gradient, `result`, of the last point. The line search asks for
its first trial point twice, and Optim asks for the accepted one again with another rounding.
"""
struct CachedObjective
    objective::Any
    point::Vector{Float64}
    result::Vector{Float64}
end

function evaluate!(cached::CachedObjective, x)
    if !isapprox(x, cached.point; rtol = 4 * eps())
        cached.point .= NaN # until the objective has returned
        cached.objective(copy(x), cached.result)
        copyto!(cached.point, x)
    end
    return cached.result
end

"""
    BestStepLineSearch(search, cached)

Line search that returns the best step of `search` where that cannot satisfy the Wolfe
conditions, provided the step decreases the loss. This happens next to points where the loss
is not defined.
"""
struct BestStepLineSearch{S}
    search::S
    cached::CachedObjective
end

# The signature is Optim's.
function (line::BestStepLineSearch)(objective, x, s, step, buffer, loss, slope)
    try
        return line.search(objective, x, s, step, buffer, loss, slope)
    catch error
        error isa LineSearchException || rethrow()
        best = evaluate!(line.cached, x .+ error.alpha .* s)[1]
        best < loss || rethrow()
        return error.alpha, best
    end
end

"""
    unit_step!(line_search, state, loss, slope, objective)

Initial step of Optim's line search: of length one along the first gradient, then the full
quasi-Newton step.
"""
function unit_step!(_, state, _, _, _)
    state.alpha = state.pseudo_iteration == 1 ? 1 / norm(state.s) : 1.0
    return state.alpha
end

"""
    IterateCallback(after, started)

Callback that passes on the accepted iterates, without the first point, for which Optim calls
it too.
"""
mutable struct IterateCallback
    const after::Any
    started::Bool
end

function (callback::IterateCallback)(state)
    callback.started && callback.after(copy(state.x), state.f_x)
    callback.started = true
    return false
end
