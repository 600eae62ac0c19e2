# Second pressure stage: constant up to L/3, a tanh at the stenosis, constant from 2L/3.

"""
    SpatialPressure(temporal, flow, area_undeformed, target, z, physics, stage)

Squared error of

    p* = (mean of p̂* over z) + a₁ − (Δp(K_t + a₂)/p_ref + b₁(t))·½tanh(10·b₂(t)·(z − z_s))

as a function of `[a₁; a₂; b₁; b₂]`, with z clamped to [L/3, 2L/3]. The drop is that of the
flow at the stenosis, so that the outer thirds are constant in z.

# Arguments

  - `temporal`: p̂*, (z, time, case).
  - `flow`: Q, mL/s, (z, time, case).
  - `area_undeformed`: S_u, cm², (z, case).
  - `target`: p/p_ref, (z, time, case).
  - `z`: points, cm.
"""
struct SpatialPressure <: Objective
    physics::Physics
    stenosis::Tuple{Int, Float64}   # its interval of the grid, and the fraction before it
    mean::Matrix{Float64}       # of p̂* over z, (time, case)
    drop::Matrix{Float64}       # Δp/p_ref, (time, case)
    turbulent::Matrix{Float64}  # its derivative with respect to K_t, (time, case)
    distance::Vector{Float64}   # from the stenosis, cm, clamped to the middle third
    height::Vector{Float64}     # of the tanh: ½, or 0 and 1 as printed in the paper
    target::Array{Float64, 3}
    profile::Matrix{Float64}    # height·tanh, (z, time)
    profile_derivative::Matrix{Float64} # its derivative with respect to b₂
end

function SpatialPressure(
    temporal, flow, area_undeformed, target, z, physics::Physics,
    stage::SpatialPressureStage,
)
    n_points, n_times, n_cases = size(flow)
    third = (z[end] - z[1]) / 3
    inside = clamp.(z, z[1] + third, z[1] + 2 * third)
    height = stage.form == "printed" ? Float64.(z .> z[1] + third) : fill(0.5, n_points)
    problem = SpatialPressure(
        physics,
        interval(z, clamp(physics.stenosis_position, z[1], z[end])),
        zeros(n_times, n_cases),
        zeros(n_times, n_cases),
        zeros(n_times, n_cases),
        inside .- physics.stenosis_position,
        height,
        target,
        zeros(n_points, n_times),
        zeros(n_points, n_times),
    )
    return set_cases!(problem, temporal, flow, area_undeformed)
end

function set_cases!(problem::SpatialPressure, temporal, flow, area_undeformed)
    (; physics, stenosis, mean, drop, turbulent) = problem
    i, fraction = stenosis
    n_points, n_times, n_cases = size(flow)
    for case in 1:n_cases
        coefficients = drop_coefficients(view(area_undeformed, :, case), physics)
        viscous, losses = coefficients ./ physics.reference_pressure
        @inbounds for t in 1:n_times
            q = (1 - fraction) * flow[i, t, case] + fraction * flow[i + 1, t, case]
            mean[t, case] = sum(view(temporal, :, t, case)) / n_points
            turbulent[t, case] = losses * q * abs(q)
            drop[t, case] = viscous * q + physics.turbulent_coefficient * turbulent[t, case]
        end
    end
    return problem
end

"""
    set_profile!(problem, parameters)

Compute the profile height·tanh and its derivative with respect to b₂.
"""
function set_profile!(problem::SpatialPressure, parameters)
    (; distance, height, profile, profile_derivative) = problem
    n_points, n_times = size(profile)
    for t in 1:n_times
        b2 = parameters[2 + n_times + t]
        for i in 1:n_points
            tanh_ = tanh(10 * b2 * distance[i])
            profile[i, t] = height[i] * tanh_
            profile_derivative[i, t] = height[i] * (1 - tanh_^2) * 10 * distance[i]
        end
    end
    return profile
end

function value!(problem::SpatialPressure, parameters)
    set_profile!(problem, parameters)
    (; mean, drop, turbulent, target, profile) = problem
    n_points, n_times, n_cases = size(target)
    total = 0.0
    @inbounds for case in 1:n_cases, t in 1:n_times
        level = mean[t, case] + parameters[1]
        amplitude = drop[t, case] + parameters[2] * turbulent[t, case] + parameters[2 + t]
        @simd for i in 1:n_points
            error = level - amplitude * profile[i, t] - target[i, t, case]
            total += error * error
        end
    end
    return total / length(target)
end

function value_and_gradient!(gradient, problem::SpatialPressure, parameters)
    set_profile!(problem, parameters)
    (; mean, drop, turbulent, target, profile, profile_derivative) = problem
    n_points, n_times, n_cases = size(target)
    total = 0.0
    fill!(gradient, 0.0)
    @inbounds for case in 1:n_cases, t in 1:n_times
        level = mean[t, case] + parameters[1]
        amplitude = drop[t, case] + parameters[2] * turbulent[t, case] + parameters[2 + t]
        grad_level = grad_amplitude = grad_b2 = 0.0
        @simd for i in 1:n_points
            error = level - amplitude * profile[i, t] - target[i, t, case]
            total += error * error
            grad_level += error
            grad_amplitude -= error * profile[i, t]
            grad_b2 -= error * profile_derivative[i, t]
        end
        gradient[1] += grad_level
        gradient[2] += grad_amplitude * turbulent[t, case]
        gradient[2 + t] += grad_amplitude
        gradient[2 + n_times + t] += grad_b2 * amplitude
    end
    rmul!(gradient, 2 / length(target))
    return total / length(target)
end

"""
    solve(problem::SpatialPressure, parameters)

p/p_ref, (z, time, case).
"""
function solve(problem::SpatialPressure, parameters)
    set_profile!(problem, parameters)
    pressure = zeros(size(problem.profile)..., size(problem.mean, 2))
    return evaluate_pressure!(pressure, problem, parameters)
end

"""
    evaluate_pressure!(pressure, problem, parameters)

Compute p/p_ref from the profile that `set_profile!` has set.
"""
function evaluate_pressure!(pressure, problem::SpatialPressure, parameters)
    (; mean, drop, turbulent, profile) = problem
    n_points, n_times, n_cases = size(pressure)
    @inbounds for case in 1:n_cases, t in 1:n_times
        level = mean[t, case] + parameters[1]
        amplitude = drop[t, case] + parameters[2] * turbulent[t, case] + parameters[2 + t]
        @simd ivdep for i in 1:n_points
            pressure[i, t, case] = level - amplitude * profile[i, t]
        end
    end
    return pressure
end
