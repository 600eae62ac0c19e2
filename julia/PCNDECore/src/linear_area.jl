# Both area stages are linear in their corrections a(z) and b(z).

"""
    LinearArea(start, change, elapsed, target)

Squared error of S = start + a(z)·change + b(z)·elapsed as a function of `[a; b]`.

# Arguments

  - `start`: cm², (z, case).
  - `change`: factor of a(z), cm², (z, time, case).
  - `elapsed`: factor of b(z), (time).
  - `target`: cm², (z, time, case).
"""
struct LinearArea <: Objective
    start::Matrix{Float64}
    change::Array{Float64, 3}
    elapsed::Vector{Float64}
    target::Array{Float64, 3}
end

function value!(problem::LinearArea, parameters)
    (; start, change, elapsed, target) = problem
    n_points, n_times, n_cases = size(change)
    total = 0.0
    @inbounds for n in 1:n_cases, t in 1:n_times
        @simd for i in 1:n_points
            a, b = parameters[i], parameters[n_points + i]
            error = start[i, n] + a * change[i, t, n] + b * elapsed[t] - target[i, t, n]
            total += error * error
        end
    end
    return total / length(target)
end

function value_and_gradient!(gradient, problem::LinearArea, parameters)
    (; start, change, elapsed, target) = problem
    n_points, n_times, n_cases = size(change)
    total = 0.0
    fill!(gradient, 0.0)
    @inbounds for n in 1:n_cases, t in 1:n_times
        @simd ivdep for i in 1:n_points
            a, b = parameters[i], parameters[n_points + i]
            error = start[i, n] + a * change[i, t, n] + b * elapsed[t] - target[i, t, n]
            total += error * error
            gradient[i] += error * change[i, t, n]
            gradient[n_points + i] += error * elapsed[t]
        end
    end
    rmul!(gradient, 2 / length(target))
    return total / length(target)
end

"""
    solve(problem::LinearArea, parameters)

S, cm², (z, time, case).
"""
function solve(problem::LinearArea, parameters)
    (; start, change, elapsed) = problem
    n_points = size(change, 1)
    a, b = parameters[1:n_points], parameters[(n_points + 1):end]
    return reshape(start, n_points, 1, :) .+ a .* change .+ b .* elapsed'
end
