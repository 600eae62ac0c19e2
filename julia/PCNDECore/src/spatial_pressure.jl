# Second pressure stage: constant up to L/3, a tanh at the stenosis, constant from 2L/3.

"""
    SpatialPressure(temporal, flow, area_undeformed, target, z, physics, stage)

Squared error of

    p* = (mean of p̂* over z) + a₁ − (Δp(K_t + a₂)/p_ref + b₁(t))·½tanh(10·b₂(t)·(z − z_s))

as a function of `[a₁; a₂; b₁; b₂]`, with z held between L/3 and 2L/3. The drop is that
of the flow through the stenosis, so that the outer parts are constant in z.

# Arguments

  - `temporal`: p̂*, (z, time, case).
  - `flow`: Q, mL/s, (z, time, case).
  - `area_undeformed`: S_u, cm², (z, case).
  - `target`: p/p_ref, (z, time, case).
  - `z`: points, cm.
"""
struct SpatialPressure <: Objective
    physics::Physics
    stenosis::Tuple{Int, Float64}   # the grid's interval that holds it, and the share before it
    mean::Matrix{Float64}       # of p̂* over z, (time, case)
    drop::Matrix{Float64}       # Δp/p_ref, (time, case)
    turbulent::Matrix{Float64}  # its derivative by K_t, (time, case)
    distance::Vector{Float64}   # from the stenosis, cm, held inside the middle third
    height::Vector{Float64}     # of the tanh: ½, or as printed 0 and 1
    target::Array{Float64, 3}
    step::Matrix{Float64}       # (z, time)
    step_slope::Matrix{Float64} # its derivative by b₂
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
    i, share = stenosis
    n_points, n_times, n_cases = size(flow)
    for case in 1:n_cases
        coefficients = drop_coefficients(view(area_undeformed, :, case), physics)
        viscous, losses = coefficients ./ physics.reference_pressure
        @inbounds for t in 1:n_times
            q = (1 - share) * flow[i, t, case] + share * flow[i + 1, t, case]
            mean[t, case] = sum(view(temporal, :, t, case)) / n_points
            turbulent[t, case] = losses * q * abs(q)
            drop[t, case] = viscous * q + physics.turbulent_coefficient * turbulent[t, case]
        end
    end
    return problem
end

function steps!(problem::SpatialPressure, parameters)
    (; distance, height, step, step_slope) = problem
    n_points, n_times = size(step)
    for t in 1:n_times
        b2 = parameters[2 + n_times + t]
        for i in 1:n_points
            tanh_ = tanh(10 * b2 * distance[i])
            step[i, t] = height[i] * tanh_
            step_slope[i, t] = height[i] * (1 - tanh_^2) * 10 * distance[i]
        end
    end
    return step
end

function value!(problem::SpatialPressure, parameters)
    steps!(problem, parameters)
    (; mean, drop, turbulent, target, step) = problem
    n_points, n_times, n_cases = size(target)
    total = 0.0
    @inbounds for case in 1:n_cases, t in 1:n_times
        level = mean[t, case] + parameters[1]
        fall = drop[t, case] + parameters[2] * turbulent[t, case] + parameters[2 + t]
        @simd for i in 1:n_points
            error = level - fall * step[i, t] - target[i, t, case]
            total += error * error
        end
    end
    return total / length(target)
end

function value_and_gradient!(gradient, problem::SpatialPressure, parameters)
    steps!(problem, parameters)
    (; mean, drop, turbulent, target, step, step_slope) = problem
    n_points, n_times, n_cases = size(target)
    total = 0.0
    fill!(gradient, 0.0)
    @inbounds for case in 1:n_cases, t in 1:n_times
        level = mean[t, case] + parameters[1]
        fall = drop[t, case] + parameters[2] * turbulent[t, case] + parameters[2 + t]
        by_level = by_fall = by_b2 = 0.0
        @simd for i in 1:n_points
            error = level - fall * step[i, t] - target[i, t, case]
            total += error * error
            by_level += error
            by_fall -= error * step[i, t]
            by_b2 -= error * step_slope[i, t]
        end
        gradient[1] += by_level
        gradient[2] += by_fall * turbulent[t, case]
        gradient[2 + t] += by_fall
        gradient[2 + n_times + t] += by_b2 * fall
    end
    rmul!(gradient, 2 / length(target))
    return total / length(target)
end

"""
    solve(problem::SpatialPressure, parameters)

p/p_ref, (z, time, case).
"""
function solve(problem::SpatialPressure, parameters)
    steps!(problem, parameters)
    pressure = zeros(size(problem.step)..., size(problem.mean, 2))
    return after_steps!(pressure, problem, parameters)
end

"""
    after_steps!(pressure, problem, parameters)

What [`solve`](@ref) does once `steps!` has been called, which needs no case.
"""
function after_steps!(pressure, problem::SpatialPressure, parameters)
    (; mean, drop, turbulent, step) = problem
    n_points, n_times, n_cases = size(pressure)
    @inbounds for case in 1:n_cases, t in 1:n_times
        level = mean[t, case] + parameters[1]
        fall = drop[t, case] + parameters[2] * turbulent[t, case] + parameters[2 + t]
        @simd ivdep for i in 1:n_points
            pressure[i, t, case] = level - fall * step[i, t]
        end
    end
    return pressure
end
