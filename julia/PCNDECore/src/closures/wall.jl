# Displacement of the wall under a pressure: an elastic membrane, or a local tube law.
#
# Membrane. The vessel is a thin shell of revolution with the generator r_u(z), clamped at
# both ends, with membrane and transverse shear forces, as in the coupled momentum method
# (Figueroa et al. 2006). With the displacement (u_z, u_r), tangent t, normal n
# and arc length s of the generator, the strains are
#
#     ε_s = t·∂u/∂s,    ε_θ = u_r/r_u,    γ = n·∂u/∂s,
#
# and u is a stationary point of the energy
#
#     ½ K ∫ [ε_s² + ε_θ² + 2ν ε_s ε_θ + k γ² + f u_z²] r_u ds − ∫ (p − p₀) n·u r_u ds,
#
# with the stiffness K = E·h/(1 − ν²), dyn/cm, Poisson's ratio ν, the shear ratio k and an
# axial support f, 1/cm². It is discretized by linear elements with two Gauss points each.
#
# Local law. u_r = r_u·(r_u/r_0)^m·(p − p₀)/K, with the radius r_0 of the first point.
#
# Both are linear in the pressure; the area S = π(r_u + u_r)² is not.

"""
    displacement(parameters, loads, area_undeformed, z, law)

Radial displacement u_r, cm, (z, load), under several loads.

# Arguments

  - `parameters`: membrane: K (dyn/cm), ν, k, f (1/cm²), p₀; local: K (dyn/cm²), m, p₀. The
    loads contain p₀ already.
  - `loads`: p − p₀, dyn/cm², (z, load).
  - `area_undeformed`: S_u, cm², (z).
  - `z`: points, cm.
  - `law`: `"membrane"` or `"local"`.
"""
function displacement(parameters, loads, area_undeformed, z, law::String)
    radius = sqrt.(area_undeformed ./ π)
    law == "membrane" && return membrane(parameters, loads, radius, z)
    stiffness, exponent = parameters[1], parameters[2]
    return radius .* (radius ./ radius[1]) .^ exponent ./ stiffness .* loads
end

"""
    membrane(parameters, loads, radius, z)

u_r, cm, (z, load). The unknowns are u_z and u_r of the points between the clamped ends,
alternating, so that the matrix of the system has three bands below its diagonal.
"""
function membrane(parameters, loads, radius, z)
    stiffness, poisson, shear, support = parameters
    n_points, n_loads = size(loads)
    n = 2 * (n_points - 2)
    bands = zeros(promote_type(eltype(parameters), Float64), 4, n)
    right = zeros(eltype(loads), n, n_loads)
    for element in 1:(n_points - 1)
        dz, dr = z[element + 1] - z[element], radius[element + 1] - radius[element]
        length = hypot(dz, dr)
        # Contribution of each of the element's four unknowns to the strains.
        along = (-dz, -dr, dz, dr) ./ length^2
        across = (dr, -dz, -dr, dz) ./ length^2
        normal = (-dr / length, dz / length)
        first = 2 * (element - 2) # number of unknowns before those of the element
        for position in GAUSS
            r = (1 - position) * radius[element] + position * radius[element + 1]
            weight = r * length / 2
            hoop = (0.0, (1 - position) / r, 0.0, position / r)
            axial = (1 - position, 0.0, position, 0.0)
            shape = ((1 - position) .* normal..., position .* normal...)
            for i in 1:4
                row = first + i
                1 <= row <= n || continue
                for j in 1:i
                    column = first + j
                    column >= 1 || continue
                    bands[1 + i - j, column] +=
                        weight * (
                            along[i] * along[j] +
                            hoop[i] * hoop[j] +
                            poisson * (along[i] * hoop[j] + hoop[i] * along[j]) +
                            shear * across[i] * across[j] +
                            support * axial[i] * axial[j]
                        )
                end
                for load in 1:n_loads
                    left, next = loads[element, load], loads[element + 1, load]
                    pressure = (1 - position) * left + position * next
                    right[row, load] += weight * shape[i] * pressure
                end
            end
        end
    end
    solve_banded!(bands, right)
    radial = zeros(promote_type(eltype(bands), eltype(right)), n_points, n_loads)
    radial[2:(end - 1), :] .= right[2:2:end, :] ./ stiffness
    return radial
end

const GAUSS = (0.5 - 0.5 / sqrt(3), 0.5 + 0.5 / sqrt(3))

"""
    solve_banded!(bands, right)

Solve a symmetric positive definite system by L·D·Lᵀ, in place: `bands[1 + k, i]` is the
matrix's entry (i + k, i), `right` (unknown, load) becomes the solution.
"""
function solve_banded!(bands, right)
    n_below, n = size(bands, 1) - 1, size(bands, 2)
    for i in 1:n
        below = min(n_below, n - i)
        for k in 1:below
            factor = bands[1 + k, i] / bands[1, i]
            for l in k:below
                bands[1 + l - k, i + k] -= factor * bands[1 + l, i]
            end
        end
        for k in 1:below
            bands[1 + k, i] /= bands[1, i]
        end
    end
    for load in axes(right, 2)
        for i in 1:n, k in 1:min(n_below, n - i)
            right[i + k, load] -= bands[1 + k, i] * right[i, load]
        end
        for i in n:-1:1
            right[i, load] /= bands[1, i]
            for k in 1:min(n_below, n - i)
                right[i, load] -= bands[1 + k, i] * right[i + k, load]
            end
        end
    end
    return right
end
