# First pressure stage, p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q). The network maps all
# points at one time point.

"""
    TemporalPressure(flow, area, area_undeformed, target, physics, stage)

Squared error of p̂/p_ref as a function of the network's parameters.

# Arguments

  - `flow`, `area`: Q, mL/s, and S, cm², (z, time, case).
  - `area_undeformed`: S_u, cm², (z, case); r₀ is the radius of its first point.
  - `target`: p/p_ref, (z, time, case).
"""
struct TemporalPressure <: Objective
    inputs::Matrix{Float64}      # (4z + 1, time·case)
    stiffness::Vector{Float64}   # E·h/(r₀·p_ref), (time·case)
    target::Matrix{Float64}      # (z, time·case)
    network::Network
    activations::Activations
    residual::Matrix{Float64}    # (z, time·case)
    deltas::Vector{Matrix{Float64}}
end

function TemporalPressure(
    flow, area, area_undeformed, target, physics::Physics, stage::TemporalPressureStage,
)
    n_points, n_times, n_cases = size(flow)
    network = Network(chain([4 * n_points; stage.hidden; n_points], stage.activation))
    columns = n_times * n_cases
    problem = TemporalPressure(
        ones(4 * n_points + 1, columns),
        zeros(columns),
        reshape(target, n_points, columns),
        network,
        Activations(stage.hidden, columns),
        zeros(n_points, columns),
        [zeros(width, columns) for width in stage.hidden],
    )
    return set_cases!(problem, flow, area, area_undeformed, physics, stage)
end

function set_cases!(problem::TemporalPressure, flow, area, area_undeformed, physics, stage)
    n_points, n_times, n_cases = size(flow)
    inputs = reshape(problem.inputs, :, n_times, n_cases)
    stiffness = reshape(problem.stiffness, n_times, n_cases)
    drop_scale =
        stage.pressure_drop_input == "normalized" ? 1 / physics.reference_pressure : 1.0
    for case in 1:n_cases
        start = view(area_undeformed, :, case)
        viscous, turbulent = drop_scale .* drop_coefficients(start, physics)
        turbulent *= physics.turbulent_coefficient
        radius = sqrt(first(start) / π)
        wall = physics.young_modulus * physics.wall_thickness / radius
        stiffness[:, case] .= wall / physics.reference_pressure
        @inbounds for t in 1:n_times
            @simd ivdep for i in 1:n_points
                q, s = flow[i, t, case], area[i, t, case]
                inputs[i, t, case] = s
                inputs[n_points + i, t, case] = s - start[i]
                inputs[2 * n_points + i, t, case] = viscous * q + turbulent * q * abs(q)
                inputs[3 * n_points + i, t, case] = q
            end
        end
    end
    return problem
end

"""
    residual!(problem, parameters)

Compute p̂/p_ref − target, (z, time·case).
"""
function residual!(problem::TemporalPressure, parameters)
    load!(problem.network, parameters)
    return residual!(problem)
end

function residual!(problem::TemporalPressure)
    (; inputs, stiffness, target, network, activations, residual) = problem
    mul!(activations.before[1], network.matrices[1], inputs)
    forward!(activations, network, size(inputs, 2))
    mul!(residual, network.matrices[end], activations.after[end])
    residual .= 1 .+ stiffness' .* residual .- target
    return residual
end

function value!(problem::TemporalPressure, parameters)
    residual = residual!(problem, parameters)
    return dot(residual, residual) / length(residual)
end

function value_and_gradient!(gradient, problem::TemporalPressure, parameters)
    (; inputs, stiffness, network, activations, deltas) = problem
    residual = residual!(problem, parameters)
    loss = dot(residual, residual) / length(residual)
    residual .*= (2 / length(residual)) .* stiffness'
    blocks = layer_blocks(gradient, network)
    mul!(blocks[end], residual, activations.after[end]')
    grad_output = residual
    for layer in length(deltas):-1:1
        matrix, delta = network.matrices[layer + 1], deltas[layer]
        mul!(delta, view(matrix, :, 1:size(delta, 1))', grad_output)
        times_derivative!(
            delta, delta, activations.before[layer], activations.after[layer],
            network.activation,
        )
        below = layer == 1 ? inputs : activations.after[layer - 1]
        mul!(blocks[layer], delta, below')
        grad_output = delta
    end
    return loss
end

"""
    solve_temporal_pressure(parameters, flow, area, area_undeformed, physics, stage)

p̂/p_ref, (z, time, case); the arguments are those of [`TemporalPressure`](@ref).
"""
function solve_temporal_pressure(
    parameters, flow, area, area_undeformed, physics::Physics, stage::TemporalPressureStage,
)
    zero_target = zero(flow)
    problem = TemporalPressure(flow, area, area_undeformed, zero_target, physics, stage)
    return reshape(residual!(problem, parameters), size(flow))
end
