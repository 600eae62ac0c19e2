# Boundary layer and jet of a steady flow along a vessel.
#
# A core of uniform speed is surrounded by a layer of thickness d·r_u with a quadratic profile,
# u = U·(2y − y²) at the distance y·d·r_u from the wall. In a straight vessel, d = 1 is
# Poiseuille's parabola. The means of u/U and (u/U)² over the cross-section are
#
#     m = 1 − 2d/3 + d²/6,    k = 1 − 14d/15 + 4d²/15.
#
# Bernoulli's equation on the axis and the momentum balance of the cross-section give
#
#     (dE/dd + m'/m³)·d' = −(ln S_u)'·(1 − k)/m² + c_g·4πν/(Q·m)·(d⁶ − 1/d),    E = k/m²,
#
# where c_g scales the growth of the layer by viscosity (1 for the quadratic profile). The layer
# becomes thin where the vessel narrows, and grows back downstream.
#
# Behind a narrowing, the flow separates where the vessel widens faster than a free jet. The
# radius of the jet grows by
#
#     dr_j/dz = s + s_ν·πν·r_j/Q
#
# until the jet fills the vessel again, r_j = r_u/√β: a parabola has β = 4/3 times the momentum
# of a uniform flow through the same area. The first term is that of a turbulent jet, the second
# one that of a laminar jet.

"""
Number of steps of the layer's equation in each interval between two points.
"""
const LAYER_STEPS = 2

"""
Smallest thickness of the layer, relative to the radius.
"""
const THINNEST_LAYER = 0.02

"""
Coefficient of the L-stable Rosenbrock method of second order (ROS2).
"""
const ROSENBROCK_GAMMA = 1 - 1 / sqrt(2)

"""
    mean_speed(thickness)

m, the mean speed relative to that of the core.
"""
mean_speed(d) = 1 - 2 / 3 * d + d^2 / 6

"""
    layer_thickness(area_undeformed, z, growth)

d, (z), of a flow in the direction of z that is Poiseuille's at the first point.

# Arguments

  - `area_undeformed`: S_u, cm², (z).
  - `z`: points, cm.
  - `growth`: c_g·4πν/Q, 1/cm.
"""
function layer_thickness(area_undeformed, z, growth::T) where {T}
    thickness = Vector{T}(undef, length(z))
    d = thickness[1] = one(T)
    for i in 1:(length(z) - 1)
        dz = z[i + 1] - z[i]
        slope = (log(area_undeformed[i + 1]) - log(area_undeformed[i])) / dz
        for _ in 1:LAYER_STEPS
            d = layer_step(d, dz / LAYER_STEPS, slope, growth)
        end
        thickness[i + 1] = d
    end
    return thickness
end

"""
    layer_step(d, dz, slope, growth)

Advance d by a linearly implicit step, which is stable for any growth and step. `slope` is
(ln S_u)', 1/cm; `growth` is that of [`layer_thickness`](@ref).
"""
function layer_step(d, dz, slope, growth)
    rate, derivative = layer_rate(d, slope, growth)
    factor = inv(1 - ROSENBROCK_GAMMA * dz * derivative)
    first = factor * rate
    middle, _ = layer_rate(clamp_layer(d + dz * first), slope, growth)
    second = factor * (middle - 2 * first)
    return clamp_layer(d + dz * (1.5 * first + 0.5 * second))
end

clamp_layer(d) = clamp(d, THINNEST_LAYER, 1)

"""
    layer_rate(d, slope, growth)

d', 1/cm, and its derivative with respect to d. The equation is multiplied by m³, so that both
of its sides are polynomials apart from 1/d.
"""
@inline function layer_rate(d, slope, growth)
    m, m_d, m_dd = mean_speed(d), d / 3 - 2 / 3, 1 / 3
    k, k_d, k_dd = 1 - 14 / 15 * d + 4 / 15 * d^2, 8 / 15 * d - 14 / 15, 8 / 15
    d5 = d^2 * d^2 * d
    viscous, viscous_d = d5 * d - 1 / d, 6 * d5 + 1 / d^2
    inertia = k_d * m + (1 - 2 * k) * m_d
    inertia_d = k_dd * m - k_d * m_d + (1 - 2 * k) * m_dd
    force = growth * m^2 * viscous - slope * (1 - k) * m
    force_d =
        growth * m * (2 * m_d * viscous + m * viscous_d) + slope * (k_d * m - (1 - k) * m_d)
    rate = force / inertia
    return rate, (force_d - rate * inertia_d) / inertia
end

"""
    jet_area(area_undeformed, z, momentum, spread, viscous_spread)

A_j, cm², (z), of a flow in the direction of z; exactly S_u/β where the flow fills the vessel.

# Arguments

  - `area_undeformed`: S_u, cm², (z).
  - `z`: points, cm.
  - `momentum`: β.
  - `spread`, `viscous_spread`: s, and s_ν·πν/Q in 1/cm.
"""
function jet_area(area_undeformed, z, momentum::T, spread::T, viscous_spread::T) where {T}
    area = Vector{T}(undef, length(z))
    filled_radius(i) = sqrt(area_undeformed[i] / (π * momentum))
    radius = filled_radius(1)
    area[1] = area_undeformed[1] / momentum
    for i in 2:length(z)
        dz = z[i] - z[i - 1]
        half = dz / 2 * viscous_spread
        radius = (radius * (1 + half) + dz * spread) / (1 - half)
        limit = filled_radius(i)
        # Exactly S_u/β where the flow fills the vessel: a straight vessel has no jet.
        fills = radius >= limit
        radius = fills ? limit : radius
        area[i] = fills ? area_undeformed[i] / momentum : π * radius^2
    end
    return area
end
