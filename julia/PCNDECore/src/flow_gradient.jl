# Gradient of the flow loss by a discrete adjoint (discretize, then optimize). The accepted
# steps and the interpolant are differentiated as they were taken, with fixed step lengths.
# The gradient is therefore that of the computed loss, which the line search sees, and not
# that of the exact solution. At the paper's tolerances the two differ by 5e-4.
#
# The choice was measured (`benchmark/adjoints.jl` and the documentation's decision page 004):
# the continuous adjoints of SciMLSensitivity take a hundred times as long or more.

function ensure_capacity!(workspace::FlowGradientWorkspace, hidden::Vector{Int}, columns::Int)
    size(workspace.inputs, 2) >= columns && return workspace
    workspace.inputs = zeros(size(workspace.inputs, 1), columns)
    workspace.activations = Activations(hidden, columns)
    workspace.deltas = [zeros(width, columns) for width in hidden]
    return workspace
end

function value_and_gradient!(gradient, problem::FlowProblem, parameters)
    if !integrate!(problem, parameters)
        fill!(gradient, NaN)
        return Inf
    end
    (; network, output_map, workspace, inflow, area) = problem
    residual!(problem)
    residual = apply_weights!(problem)
    loss = loss_scale(problem) * dot(residual, residual)
    # The roots of the weights, applied twice, are the weights.
    rmul!(apply_weights!(problem), 2 * loss_scale(problem))
    mul!(workspace.grad_states, output_map', residual)
    reevaluate_stages!(problem)
    fill!(gradient, 0.0)
    blocks = layer_blocks(gradient, network)
    adjoint_steps!(blocks, problem)

    # Gradient of the parameters, layer by layer, from all evaluations at the same time.
    columns = length(workspace.positions) * size(inflow, 2)
    used(a) = view(a, :, 1:columns)
    for layer in 2:(length(blocks) - 1)
        deltas = used(workspace.deltas[layer])
        mul!(blocks[layer], deltas, used(workspace.activations.after[layer - 1])')
    end
    n_times = size(inflow, 1)
    mul!(workspace.grad_along, used(workspace.deltas[1]), used(workspace.inputs)')
    isnothing(problem.terms) && last_layer_gradient!(blocks[end], problem)
    constant, on_grid = workspace.constant, workspace.grad_on_grid
    sum!(reshape(constant, size(constant)..., 1), on_grid)
    flow_block = view(blocks[1], :, 1:n_times)
    mul!(flow_block, workspace.grad_along, output_map')
    mul!(flow_block, constant, inflow', 1.0, 1.0)
    area_block = view(blocks[1], :, (n_times + 1):(2 * n_times))
    mul!(area_block, reshape(on_grid, size(on_grid, 1), :), area')
    sum!(view(blocks[1], :, 2 * n_times + 1), constant)
    return loss
end

"""
    last_layer_gradient!(block, problem)

Gradient with respect to [W b], which enters Q = Q_in + [W b]·H and its product with the
first layer. With terms, each evaluation contributes instead; see [`evaluation_vjp!`](@ref).
"""
function last_layer_gradient!(block, problem::FlowProblem)
    (; network, workspace, states, residual) = problem
    from_flow = view(network.matrices[1], :, 1:size(residual, 1))
    mul!(block, residual, states')
    mul!(block, from_flow', workspace.grad_along, 1.0, 1.0)
    return block
end

"""
    layer_blocks(vector, network)

Views of a flat parameter vector as the layers' matrices `[W b]`.
"""
function layer_blocks(vector::Vector{Float64}, network::Network)
    ends = cumsum(length.(network.matrices))
    return map(network.matrices, ends) do matrix, last
        reshape(view(vector, (last - length(matrix) + 1):last), size(matrix))
    end
end

"""
    reevaluate_stages!(problem)

Compute inputs and hidden layers of every evaluation of the network, side by side: first the
evaluation at the inlet, then stages 2 … 7 of each step.
"""
function reevaluate_stages!(problem::FlowProblem)
    (; stage, rate, workspace, trajectory, network, z, inflow) = problem
    n_cases = size(inflow, 2)
    evaluations = 6 * trajectory.count + 1
    columns = evaluations * n_cases
    ensure_capacity!(workspace, stage.hidden, columns)
    resize!(workspace.positions, evaluations)
    flat = reshape(workspace.inputs, :, size(workspace.inputs, 2) ÷ n_cases)
    fill!(view(flat, :, 1), 0.0)
    workspace.positions[1] = z[1]
    for j in 1:(trajectory.count)
        second = 6 * j - 4 # number of stage 2
        start, step_length = trajectory.starts[j], trajectory.lengths[j]
        stages = view(flat, :, second:(second + 5))
        stages .= trajectory.states[j]
        mul!(stages, trajectory.slopes[j], view(TSIT5_A, :, 2:7), step_length, 1.0)
        for i in 2:7
            workspace.positions[second + i - 2] = start + TSIT5_C[i] * step_length
        end
    end
    before = workspace.activations.before[1]
    for (number, position) in enumerate(workspace.positions)
        columns_of_one = evaluation_columns(number, n_cases)
        interpolate_grid!(view(before, :, columns_of_one), rate.on_grid, z, position)
    end
    inputs = view(workspace.inputs, :, 1:columns)
    mul!(view(before, :, 1:columns), rate.along, inputs, 1.0, 1.0)
    forward!(workspace.activations, network, columns)
    return nothing
end

evaluation_columns(number, cases) = ((number - 1) * cases + 1):(number * cases)

"""
    adjoint_steps!(blocks, problem)

Propagate the loss's derivatives from the last step to the first, through every evaluation.
"""
function adjoint_steps!(blocks, problem::FlowProblem)
    (; workspace, trajectory, interpolation, step_of, z) = problem
    (; grad_slopes, grad_state, grad_next_slope, grad_stage) = workspace
    n_points = length(z)
    at_points = reshape(workspace.grad_states, :, n_points)
    fill!(workspace.grad_on_grid, 0.0)
    fill!(grad_state, 0.0)
    fill!(grad_next_slope, 0.0)
    point = n_points
    for j in (trajectory.count):-1:1
        step_length = trajectory.lengths[j]
        last = point
        while point >= 1 && step_of[point] == j
            point -= 1
        end
        inside = view(at_points, :, (point + 1):last)
        mul!(grad_slopes, inside, view(interpolation, (point + 1):last, :))
        axpy!(1.0, grad_next_slope, view(grad_slopes, :, 7))
        # The seventh slope is evaluated at the state after the step.
        evaluation_vjp!(blocks, problem, 6 * j + 1, view(grad_slopes, :, 7))
        axpy!(1.0, vec(grad_stage), grad_state)
        for i in 1:6
            axpy!(step_length * TSIT5_A[i, 7], grad_state, view(grad_slopes, :, i))
        end
        for k in axes(inside, 2)
            axpy!(1.0, view(inside, :, k), grad_state)
        end
        for i in 6:-1:2
            evaluation_vjp!(blocks, problem, 6 * j + i - 6, view(grad_slopes, :, i))
            axpy!(1.0, vec(grad_stage), grad_state)
            for l in 1:(i - 1)
                axpy!(step_length * TSIT5_A[l, i], vec(grad_stage), view(grad_slopes, :, l))
            end
        end
        copyto!(grad_next_slope, view(grad_slopes, :, 1))
    end
    evaluation_vjp!(blocks, problem, 1, grad_next_slope)
    return nothing
end

"""
    evaluation_vjp!(blocks, problem, number, grad_slope)

Vector–Jacobian product of one evaluation of the right-hand side: from the derivative with
respect to its result (state·case) to that with respect to the state (`grad_stage`).
Contributions that are not computed for all evaluations at the same time are added to the
gradient's `blocks`.
"""
function evaluation_vjp!(blocks, problem::FlowProblem, number::Int, grad_slope)
    grad_slope = reshape(grad_slope, :, size(problem.inflow, 2))
    if isnothing(problem.terms)
        layers_vjp!(problem, number, grad_slope)
    else
        terms_vjp!(blocks, problem, number, grad_slope)
    end
    return nothing
end

"""
    layers_vjp!(problem, number, grad_last)

Vector–Jacobian product of one evaluation of the hidden layers: from the derivative with
respect to the last one (hidden, case) to those with respect to the state (`grad_stage`), the
hidden layers (`deltas`) and the first layer on the grid (`grad_on_grid`).
"""
function layers_vjp!(problem::FlowProblem, number::Int, grad_last)
    (; network, rate, workspace, z) = problem
    (; grad_stage, deltas, activations, grad_on_grid) = workspace
    columns = evaluation_columns(number, size(grad_stage, 2))
    σ = network.activation
    top = length(deltas)
    delta = view(deltas[top], :, columns)
    times_derivative!(
        delta, grad_last, view(activations.before[top], :, columns),
        view(activations.after[top], :, columns), σ,
    )
    for layer in (top - 1):-1:1
        below, matrix = workspace.grad_hidden[layer], network.matrices[layer + 1]
        mul!(below, view(matrix, :, 1:size(below, 1))', delta)
        delta = view(deltas[layer], :, columns)
        times_derivative!(
            delta, below, view(activations.before[layer], :, columns),
            view(activations.after[layer], :, columns), σ,
        )
    end
    mul!(grad_stage, rate.along', delta)
    i, fraction = interval(z, workspace.positions[number])
    @inbounds for case in axes(delta, 2), row in axes(delta, 1)
        grad_on_grid[row, case, i] += (1 - fraction) * delta[row, case]
        grad_on_grid[row, case, i + 1] += fraction * delta[row, case]
    end
    return nothing
end
