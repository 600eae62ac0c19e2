"""
    derivative_along_z(flow, z)

∂Q/∂z, (z, …), by second-order differences, one-sided at both ends.

# Arguments

  - `flow`: Q, mL/s, or anything linear in it, (z, …).
  - `z`: points, cm; the spacing may vary.
"""
derivative_along_z(flow::Array{Float64}, z::Vector{Float64}) =
    derivative_along_z!(similar(flow), flow, z)

function derivative_along_z!(slope::Array{Float64}, flow::Array{Float64}, z::Vector{Float64})
    n = length(z)
    columns = reshape(flow, n, :)
    result = reshape(slope, n, :)
    @inbounds for column in axes(columns, 2)
        before = (columns[2, column] - columns[1, column]) / (z[2] - z[1])
        first = before
        for i in 2:(n - 1)
            left, right = z[i] - z[i - 1], z[i + 1] - z[i]
            after = (columns[i + 1, column] - columns[i, column]) / right
            result[i, column] = (right * before + left * after) / (left + right)
            before = after
        end
        # One-sided difference: the slope of a parabola is linear, so that the slope between
        # two points is the mean of the slopes at both.
        result[1, column] = 2 * first - result[2, column]
        result[n, column] = 2 * before - result[n - 1, column]
    end
    return slope
end
