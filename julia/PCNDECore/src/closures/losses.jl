# Pressure between a point and the outlet, from the momentum balance.
#
# Momentum balance of the cross-section, with a free jet behind every narrowing:
#
#     −∂p/∂z = c_f·8πμ/S_u²·Q  +  c_i·ρ/S_u·∂Q/∂t  +  c_m·ρ/S_u·Q²·∂(1/A_j)/∂z.
#
# The area A_j(z) that carries the flow is S_u as long as the vessel narrows or widens slowly.
# Where it widens faster, the flow separates. The jet's radius then grows by the spread s per
# unit length until the jet fills the vessel again:
#
#     √(A_j(z)/π) = min over z' ≤ z of √(S_u(z')/π) + s·(z − z').
#
# With Q = q − ξ(z)·d, where q(t) is the inflow, d(t) the flow that the wall stores (q − Q(L))
# and ξ(z) the share of the storage before z, the pressure is a sum of few products of a
# function of z and a function of t.

"""
Number of products of q and d. The last modes are those of forward and of reversed flow.
"""
const N_PRODUCTS = 3

"""
Number of functions of z, and of t, in the losses.
"""
const N_MODES = 4 + 2 * N_PRODUCTS

"""
    LossDensities(parameters, area_undeformed, z, physics)

Densities in z of the three loss terms. `parameters` are c_f, c_i, c_m and the spread s.

# Fields

  - `friction`, `inertia`: factors of Q and ∂Q/∂t, (z).
  - `jet`, `jet_back`: factors of Q² for Q > 0 and for Q < 0, integrated over each interval,
    (z − 1).
"""
struct LossDensities{T}
    friction::Vector{T}
    inertia::Vector{T}
    jet::Vector{T}
    jet_back::Vector{T}
end

function LossDensities(parameters, area_undeformed, z, physics::Physics)
    friction, inertia, convection, spread = parameters
    steps = diff(z)
    # With this mean, the intervals where A_j = S_u add up to the change of 1/(2·S_u²) exactly.
    between = (1 ./ area_undeformed[2:end] .+ 1 ./ area_undeformed[1:(end - 1)]) ./ 2
    jet(area, dz) = convection .* physics.density .* diff(1 ./ jet_area(area, dz, spread))
    back = reverse(jet(reverse(area_undeformed), reverse(steps)))
    return LossDensities(
        friction .* 8π .* physics.viscosity ./ area_undeformed .^ 2,
        inertia .* physics.density ./ area_undeformed,
        jet(area_undeformed, steps) .* between,
        .-back .* between,
    )
end

"""
    jet_area(area_undeformed, steps, spread)

A_j, cm², (z), of a flow in the direction of z; `steps` (z − 1) in cm. It is the smallest of
all jets that could start upstream.
"""
function jet_area(area_undeformed, steps, spread)
    growth = spread .* cumulative_sum(steps)
    area = similar(growth)
    narrowest = sqrt(area_undeformed[1] / π) - growth[1]
    for i in eachindex(growth)
        start = sqrt(area_undeformed[i] / π) - growth[i]
        # Where the flow fills the vessel, A_j = S_u exactly: a straight vessel has no jet.
        fills = start <= narrowest
        narrowest = fills ? start : narrowest
        area[i] = fills ? area_undeformed[i] : π * (growth[i] + narrowest)^2
    end
    return area
end

"""
    pressure_drop!(pressure, densities, flow, flow_rate, z)

p − p(L), dyn/cm², (z, time), of a known flow Q and its derivative ∂Q/∂t.
"""
function pressure_drop!(pressure, densities::LossDensities, flow, flow_rate, z)
    (; friction, inertia, jet, jet_back) = densities
    n = length(z)
    @inbounds for t in axes(flow, 2)
        smooth(i) = friction[i] * flow[i, t] + inertia[i] * flow_rate[i, t]
        pressure[n, t] = zero(eltype(pressure))
        after = smooth(n)
        for i in (n - 1):-1:1
            here, middle = smooth(i), (flow[i, t] + flow[i + 1, t]) / 2
            factor = middle > 0 ? jet[i] : jet_back[i]
            pressure[i, t] =
                pressure[i + 1, t] + (here + after) / 2 * (z[i + 1] - z[i]) +
                factor * middle^2
            after = here
        end
    end
    return pressure
end

"""
    spatial_modes(densities, share, z)

Functions of z, (z, 10), that belong to [`temporal_modes`](@ref); `share` (z) is ξ.
"""
function spatial_modes(densities::LossDensities, share, z)
    (; friction, inertia, jet, jet_back) = densities
    between = (share[2:end] .+ share[1:(end - 1)]) ./ 2
    smooth = (friction, .-friction .* share, inertia, .-inertia .* share)
    jets = [
        cumulative_sum(b .* factor) for b in (jet, jet_back) for
        factor in (one.(between), -2 .* between, between .^ 2)
    ]
    return reduce(
        hcat, [[integral_to_outlet(f, z) for f in smooth]; [j[end] .- j for j in jets]],
    )
end

"""
    temporal_modes(inflow, stored)

Functions of time at one time point and their derivatives, ten each: q, d, ∂q/∂t, ∂d/∂t, then
q², q·d, d² for forward flow, then the same for reversed flow. The direction is that of
q − d/2, in the middle of the storage. `inflow` and `stored` are q and d with their first and
second derivatives.
"""
@inline function temporal_modes(inflow, stored)
    (q, q1, q2), (d, d1, d2) = inflow, stored
    products, rates = (q * q, q * d, d * d), product_rates(q, q1, d, d1)
    forward, none = is_forward(q, d), zero(d)
    directed(values) = (ifelse.(forward, values, none)..., ifelse.(forward, none, values)...)
    return (q, d, q1, d1, directed(products)...), (q1, d1, q2, d2, directed(rates)...)
end

"""
    product_rates(q, q1, d, d1)

∂/∂t of q², q·d and d², from q and d and their derivatives.
"""
product_rates(q, q1, d, d1) = (2 * q * q1, q1 * d + q * d1, 2 * d * d1)

"""
    is_forward(flow, stored)

Whether the flow in the middle of the storage, q − d/2, is not reversed.
"""
is_forward(flow, stored) = flow - stored / 2 >= 0
