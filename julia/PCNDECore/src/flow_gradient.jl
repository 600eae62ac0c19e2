# Gradient of the flow loss: discretise, then optimise. The accepted steps are
# differentiated as they were taken, interpolant included, with their lengths held
# fixed, so that the gradient is that of the number which the line search sees, not of
# the exact solution. At the paper's tolerances the two differ by 5e-4.
#
# Chosen by measurement (`benchmark/adjoints.jl`; the numbers are in CONTRIBUTING.md): the
# suite's continuous adjoints take a hundred times as long and more.

function make_room!(room::FlowGradientRoom, hidden::Vector{Int}, columns::Int)
    size(room.inputs, 2) >= columns && return room
    room.inputs = zeros(size(room.inputs, 1), columns)
    room.activations = Activations(hidden, columns)
    room.deltas = [zeros(width, columns) for width in hidden]
    return room
end

function value_and_gradient!(gradient, problem::FlowProblem, parameters)
    if !integrate!(problem, parameters)
        fill!(gradient, NaN)
        return Inf
    end
    (; network, last, room, inflow, area) = problem
    residual!(problem)
    residual = weigh!(problem)
    loss = scale(problem) * dot(residual, residual)
    rmul!(weigh!(problem), 2 * scale(problem)) # the weight is that of its root twice
    mul!(room.state_slopes, last', residual)
    evaluate_again!(problem)
    fill!(gradient, 0.0)
    parts = parts_of(gradient, network)
    through_the_steps!(parts, problem)

    # Parameters, layer by layer, from all evaluations at once.
    columns = length(room.positions) * size(inflow, 2)
    first_columns(a) = view(a, :, 1:columns)
    for layer in 2:(length(parts) - 1)
        deltas = first_columns(room.deltas[layer])
        mul!(parts[layer], deltas, first_columns(room.activations.after[layer - 1])')
    end
    n_times = size(inflow, 1)
    mul!(room.along, first_columns(room.deltas[1]), first_columns(room.inputs)')
    isnothing(problem.terms) && last_layer!(parts[end], problem)
    constant = room.constant
    sum!(reshape(constant, size(constant)..., 1), room.on_grid)
    by_flow = view(parts[1], :, 1:n_times)
    mul!(by_flow, room.along, last')
    mul!(by_flow, constant, inflow', 1.0, 1.0)
    by_area = view(parts[1], :, (n_times + 1):(2 * n_times))
    mul!(by_area, reshape(room.on_grid, size(room.on_grid, 1), :), area')
    sum!(view(parts[1], :, 2 * n_times + 1), constant)
    return loss
end

"""
    last_layer!(part, problem)

The loss by [W b], which acts in Q = Q_in + [W b]·H and in its product with the first layer.
With terms it acts in each evaluation; see [`back!`](@ref).
"""
function last_layer!(part, problem::FlowProblem)
    (; network, room, states, residual) = problem
    from_flow = view(network.matrices[1], :, 1:size(residual, 1))
    mul!(part, residual, states')
    mul!(part, from_flow', room.along, 1.0, 1.0)
    return part
end

"""
    parts_of(vector, network)

The layers' matrices `[W b]` as parts of a flat parameter vector.
"""
function parts_of(vector::Vector{Float64}, network::Network)
    at = 0
    return map(network.matrices) do matrix
        part = reshape(view(vector, (at + 1):(at + length(matrix))), size(matrix))
        at += length(matrix)
        part
    end
end

"""
    evaluate_again!(problem)

Inputs and hidden layers of every evaluation of the network, side by side: the one at
the inlet, then those of stages 2 … 7 of each step.
"""
function evaluate_again!(problem::FlowProblem)
    (; stage, rate, room, trajectory, network, z, inflow) = problem
    n_cases = size(inflow, 2)
    evaluations = 6 * trajectory.count + 1
    columns = evaluations * n_cases
    make_room!(room, stage.hidden, columns)
    resize!(room.positions, evaluations)
    flat = reshape(room.inputs, :, size(room.inputs, 2) ÷ n_cases)
    fill!(view(flat, :, 1), 0.0)
    room.positions[1] = z[1]
    for j in 1:(trajectory.count)
        at = 6 * j - 4 # of stage 2
        start, length_ = trajectory.starts[j], trajectory.lengths[j]
        stages = view(flat, :, at:(at + 5))
        stages .= trajectory.states[j]
        mul!(stages, trajectory.slopes[j], view(TSIT5_A, :, 2:7), length_, 1.0)
        for i in 2:7
            room.positions[at + i - 2] = start + TSIT5_C[i] * length_
        end
    end
    before = room.activations.before[1]
    for (number, position) in enumerate(room.positions)
        drive!(view(before, :, block(number, n_cases)), rate.on_grid, z, position)
    end
    inputs = view(room.inputs, :, 1:columns)
    mul!(view(before, :, 1:columns), rate.along, inputs, 1.0, 1.0)
    forward!(room.activations, network, columns)
    return nothing
end

block(number, cases) = ((number - 1) * cases + 1):(number * cases)

"""
    through_the_steps!(parts, problem)

From the last step to the first: the loss's derivatives by each evaluation's layers.
"""
function through_the_steps!(parts, problem::FlowProblem)
    (; room, trajectory, interpolation, step_of, z) = problem
    (; slopes, state, carried, change) = room
    n_points = length(z)
    at_points = reshape(room.state_slopes, :, n_points)
    fill!(room.on_grid, 0.0)
    fill!(state, 0.0)
    fill!(carried, 0.0)
    point = n_points
    for j in (trajectory.count):-1:1
        length_ = trajectory.lengths[j]
        last = point
        while point >= 1 && step_of[point] == j
            point -= 1
        end
        inside = view(at_points, :, (point + 1):last)
        mul!(slopes, inside, view(interpolation, (point + 1):last, :))
        axpy!(1.0, carried, view(slopes, :, 7))
        # The seventh slope is taken at the state after the step.
        back!(parts, problem, 6 * j + 1, view(slopes, :, 7))
        axpy!(1.0, vec(change), state)
        for i in 1:6
            axpy!(length_ * TSIT5_A[i, 7], state, view(slopes, :, i))
        end
        for k in axes(inside, 2)
            axpy!(1.0, view(inside, :, k), state)
        end
        for i in 6:-1:2
            back!(parts, problem, 6 * j + i - 6, view(slopes, :, i))
            axpy!(1.0, vec(change), state)
            for l in 1:(i - 1)
                axpy!(length_ * TSIT5_A[l, i], vec(change), view(slopes, :, l))
            end
        end
        copyto!(carried, view(slopes, :, 1))
    end
    back!(parts, problem, 1, carried)
    return nothing
end

"""
    back!(parts, problem, number, by_slope)

Vector–Jacobian product of one evaluation of the right-hand side: from the loss's derivative
by its result (state·case) to that by the state (`change`) and, as far as it is not that of
all evaluations at once, to the gradient's parts, which it adds to.
"""
function back!(parts, problem::FlowProblem, number::Int, by_slope)
    by_slope = reshape(by_slope, :, size(problem.inflow, 2))
    if isnothing(problem.terms)
        back_through_layers!(problem, number, by_slope)
    else
        back_through_terms!(parts, problem, number, by_slope)
    end
    return nothing
end

"""
    back_through_layers!(problem, number, factor)

Vector–Jacobian product of one evaluation of the hidden layers: from the loss's derivative
by the last one (hidden, case) to that by the state (`change`), by the hidden layers
(`deltas`) and by the first layer's part on the grid.
"""
function back_through_layers!(problem::FlowProblem, number::Int, factor)
    (; network, rate, room, z) = problem
    (; change, deltas, activations, on_grid) = room
    columns = block(number, size(change, 2))
    σ = network.activation
    top = length(deltas)
    delta = view(deltas[top], :, columns)
    times_derivative!(
        delta, factor, view(activations.before[top], :, columns),
        view(activations.after[top], :, columns), σ,
    )
    for layer in (top - 1):-1:1
        below, matrix = room.back[layer], network.matrices[layer + 1]
        mul!(below, view(matrix, :, 1:size(below, 1))', delta)
        delta = view(deltas[layer], :, columns)
        times_derivative!(
            delta, below, view(activations.before[layer], :, columns),
            view(activations.after[layer], :, columns), σ,
        )
    end
    mul!(change, rate.along', delta)
    i, share = interval(z, room.positions[number])
    @inbounds for case in axes(delta, 2), row in axes(delta, 1)
        on_grid[row, case, i] += (1 - share) * delta[row, case]
        on_grid[row, case, i + 1] += share * delta[row, case]
    end
    return nothing
end
