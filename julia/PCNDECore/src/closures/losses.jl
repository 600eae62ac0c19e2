# Pressure between a point and the outlet, from the momentum of the flow.
#
# The cross-section's momentum balance with a free jet behind every narrowing:
#
#     −∂p/∂z = c_f·8πμ/S_u²·Q  +  c_i·ρ/S_u·∂Q/∂t  +  c_m·ρ/S_u·Q²·∂(1/A_j)/∂z.
#
# The area A_j(z) that carries the flow is S_u as long as the vessel narrows or widens slowly.
# Where it widens faster the flow separates, and the jet's radius grows by the spread s per
# length of the way until it fills the vessel again:
#
#     √(A_j(z)/π) = min over z' ≤ z of √(S_u(z')/π) + s·(z − z').
#
# With Q = q − ξ(z)·d, where q(t) is the inflow, d(t) what the wall stores of it (q − Q(L)) and
# ξ(z) the share of the storage before z, the pressure is a sum of few products of a
# function of z and a function of t.

"""
Products of q and d; the modes end with those of forward and of reversed flow.
"""
const N_SQUARES = 3

"""
Functions of z, and of t, that make up the losses.
"""
const N_MODES = 4 + 2 * N_SQUARES

"""
    Coefficients(parameters, area_undeformed, z, physics)

Densities in z of the three terms: `friction` and `inertia` (z), factors of Q and ∂Q/∂t;
`jet` and `jet_back` (z − 1), factors of Q², integrated over each interval, for Q > 0 and for
Q < 0. `parameters` are c_f, c_i, c_m and the spread s.
"""
struct Coefficients{T}
    friction::Vector{T}
    inertia::Vector{T}
    jet::Vector{T}
    jet_back::Vector{T}
end

function Coefficients(parameters, area_undeformed, z, physics::Physics)
    friction, inertia, convection, spread = parameters
    steps = diff(z)
    # With this mean the pieces where A_j = S_u add up to the change of 1/(2·S_u²), exactly.
    between = (1 ./ area_undeformed[2:end] .+ 1 ./ area_undeformed[1:(end - 1)]) ./ 2
    jet(area, dz) = convection .* physics.density .* diff(1 ./ jet_area(area, dz, spread))
    back = reverse(jet(reverse(area_undeformed), reverse(steps)))
    return Coefficients(
        friction .* 8π .* physics.viscosity ./ area_undeformed .^ 2,
        inertia .* physics.density ./ area_undeformed,
        jet(area_undeformed, steps) .* between,
        .-back .* between,
    )
end

"""
    jet_area(area_undeformed, steps, spread)

A_j, cm², (z), of a flow in the direction of z; `steps` (z − 1) in cm. The recursion's
solution: the smallest of all jets that could start upstream.
"""
function jet_area(area_undeformed, steps, spread)
    reach = spread .* summed_from_inlet(steps)
    area = similar(reach)
    narrowest = sqrt(area_undeformed[1] / π) - reach[1]
    for i in eachindex(reach)
        begins = sqrt(area_undeformed[i] / π) - reach[i]
        # Where the flow fills the vessel, exactly: a straight vessel has no jet at all.
        fills = begins <= narrowest
        narrowest = fills ? begins : narrowest
        area[i] = fills ? area_undeformed[i] : π * (reach[i] + narrowest)^2
    end
    return area
end

"""
    drop!(pressure, coefficients, flow, flow_rate, z)

p − p(L), dyn/cm², (z, time), of a flow Q that is known everywhere, and its ∂Q/∂t.
"""
function drop!(pressure, c::Coefficients, flow, flow_rate, z)
    n = length(z)
    @inbounds for t in axes(flow, 2)
        smooth(i) = c.friction[i] * flow[i, t] + c.inertia[i] * flow_rate[i, t]
        pressure[n, t] = zero(eltype(pressure))
        after = smooth(n)
        for i in (n - 1):-1:1
            here, middle = smooth(i), (flow[i, t] + flow[i + 1, t]) / 2
            jet = middle > 0 ? c.jet[i] : c.jet_back[i]
            pressure[i, t] =
                pressure[i + 1, t] + (here + after) / 2 * (z[i + 1] - z[i]) + jet * middle^2
            after = here
        end
    end
    return pressure
end

"""
    modes_in_space(coefficients, share, z)

The functions of z, (z, 10), that belong to [`modes_in_time`](@ref); `share` (z) is ξ.
"""
function modes_in_space(c::Coefficients, share, z)
    between = (share[2:end] .+ share[1:(end - 1)]) ./ 2
    smooth = (c.friction, .-c.friction .* share, c.inertia, .-c.inertia .* share)
    jets = [
        summed_from_inlet(b .* factor) for b in (c.jet, c.jet_back) for
        factor in (one.(between), -2 .* between, between .^ 2)
    ]
    return reduce(hcat, [[to_outlet(f, z) for f in smooth]; [j[end] .- j for j in jets]])
end

"""
    modes_in_time(inflow, stored)

The functions of time at one instant, and their rates, ten each: q, d, ∂q/∂t, ∂d/∂t, then
q², q·d, d² where the flow goes forward, then the same where it goes back. Its direction is
that in the middle of the storage, q − d/2. `inflow` and `stored` are q and d with their
first and second rates.
"""
@inline function modes_in_time(inflow, stored)
    (q, q1, q2), (d, d1, d2) = inflow, stored
    squares, rates = (q * q, q * d, d * d), square_rates(q, q1, d, d1)
    forward, none = goes_forward(q, d), zero(d)
    directed(products) =
        (ifelse.(forward, products, none)..., ifelse.(forward, none, products)...)
    return (q, d, q1, d1, directed(squares)...), (q1, d1, q2, d2, directed(rates)...)
end

"""
    square_rates(q, q1, d, d1)

∂/∂t of q², q·d and d², from q and d with their rates.
"""
square_rates(q, q1, d, d1) = (2 * q * q1, q1 * d + q * d1, 2 * d * d1)

"""
    goes_forward(flow, stored)

Whether the flow in the middle of the storage, q − d/2, is not reversed.
"""
goes_forward(flow, stored) = flow - stored / 2 >= 0
