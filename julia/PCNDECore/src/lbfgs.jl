"""
    lbfgs(objective, start, memory, iterations, after)

Minimise a function by `Optim.LBFGS` with the `MoreThuente` line search, without restarts,
until its loss falls no more. What either function throws is thrown on.

# Arguments

  - `objective`: called with a point and a vector, in which it leaves the loss, which is
    finite, and then the gradient; it may be Python's.
  - `start`: first iterate; the first trial step from it has length one.
  - `memory`: pairs of steps and gradient changes that are kept.
  - `iterations`: at most so many.
  - `after`: called with each accepted iterate and its loss.
"""
function lbfgs(
    @nospecialize(objective), start::Vector{Float64}, memory::Integer, iterations::Integer,
    @nospecialize(after)
)
    point = LastPoint(objective, fill(NaN, length(start)), zeros(1 + length(start)))
    differentiable = OnceDifferentiable(
        x -> evaluate!(point, x)[1],
        (g, x) -> copyto!(g, 1, evaluate!(point, x), 2, length(g)),
        (g, x) -> (copyto!(g, 1, evaluate!(point, x), 2, length(g)); point.found[1]),
        start,
    )
    linesearch = BestStep(MoreThuente(; x_tol = 0.1), point)
    method = LBFGS(; m = memory, alphaguess = unit_step!, linesearch)
    options = Optim.Options(;
        iterations,
        g_abstol = 0.0,
        successive_f_tol = 0,
        show_warnings = false,
        callback = Accepted(after, false),
    )
    Optim.optimize(differentiable, start, method, options)
    return nothing
end

"""
    LastPoint(objective, at, found)

Loss and gradient, `found`, of the last point. The line search asks for its first trial twice,
and Optim for the accepted one once more, with another rounding.
"""
struct LastPoint
    objective::Any
    at::Vector{Float64}
    found::Vector{Float64}
end

function evaluate!(point::LastPoint, x)
    if !isapprox(x, point.at; rtol = 4 * eps())
        point.at .= NaN # until the objective has returned
        point.objective(copy(x), point.found)
        copyto!(point.at, x)
    end
    return point.found
end

"""
    BestStep(search, point)

A line search that, where `search` cannot meet Wolfe's conditions, as beside points where the
loss has no value, takes the best step that it has found, if that lowers the loss.
"""
struct BestStep{S}
    search::S
    point::LastPoint
end

# Optim's arguments.
function (line::BestStep)(objective, x, s, step, room, loss, slope)
    try
        return line.search(objective, x, s, step, room, loss, slope)
    catch error
        error isa LineSearchException || rethrow()
        found = evaluate!(line.point, x .+ error.alpha .* s)[1]
        found < loss || rethrow()
        return error.alpha, found
    end
end

"""
    unit_step!(line_search, state, loss, slope, objective)

Optim's first guess of a step: of length one along the first gradient, then the whole step.
"""
function unit_step!(_, state, _, _, _)
    state.alpha = state.pseudo_iteration == 1 ? 1 / norm(state.s) : 1.0
    return state.alpha
end

"""
    Accepted(after, begun)

Optim's callback, which it calls with the first iterate too.
"""
mutable struct Accepted
    const after::Any
    begun::Bool
end

function (accepted::Accepted)(state)
    accepted.begun && accepted.after(copy(state.x), state.f_x)
    accepted.begun = true
    return false
end
