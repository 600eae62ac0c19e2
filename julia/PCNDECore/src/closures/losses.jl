# Pressure between a point and the outlet, from the momentum of the flow.
#
# A boundary layer develops through every narrowing, and a jet behind it (`boundary_layer.jl`).
# Along an interval Δz, the pressure of a steady flow Q falls by
#
#     c_c·ρ/2·Δ(U²) + φ·Δz,    U = Q/(S_u·m(d)),    where the flow fills a narrowing vessel,
#     c_j·ρ·Q²/S_u·Δ(1/A_j) + φ·Δz                  elsewhere,
#
# with the friction
#
#     φ = f·c_f·4μU·d⁶/r_u² + (1 − f)·c_s·8πμQ/S_u²,    f = β·A_j/S_u,
#
# which in a straight vessel is c_f times Poiseuille's. The two lines are weighted with the share
# of the interval in which the vessel narrows, times f⁸, and the rest: nothing jumps where
# the flow separates, and the drop does not depend on the position of the points. For a sudden
# expansion, the second line is the loss of Borda and Carnot, and the pressure drop that is not
# recovered has the form of Seeley and Young's turbulent term. For reversed flow, the vessel is
# mirrored.
#
# The drop is computed at three Reynolds numbers, and interpolated by
#
#     D(z, Q) = D₁(z)·x + D₂(z)·x²/(1 + x) + D₃(z)·x²,    x = |Q|/Q₀,
#
# where Q₀ has a Reynolds number of 60. An unsteady flow adds c_i·ρ/S_u·∂Q/∂t per length, and
# the lag of the jet, whose fluid left the throat earlier:
#
#     −2λ·ρ/S_u·∂Q/∂t·Δ[(1/A_j − β/S_u)·∫A_j dz].
#
# With Q = q − ξ(z)·d, where q(t) is the inflow, d(t) the flow that the wall stores (q − Q(L))
# and ξ(z) the share of the storage before z, the pressure is a sum of products of a function of
# z and a function of t. The second term of D includes only the first order in d.

"""
Reynolds number 2Q/(πνr) of the reference flow Q₀ at the inlet.
"""
const REFERENCE_REYNOLDS = 60.0

"""
Flows, relative to Q₀, at which the steady drop is computed. The lag of the jet is that of the
second one.
"""
const FLOW_RATIOS = (0.5, 2.0, 8.0)

"""
Matrix (3, 3) from the drops at the [`FLOW_RATIOS`](@ref) to D₁, D₂, D₃.
"""
const DROP_TO_FACTORS = inv(reduce(vcat, [[x x^2/(1 + x) x^2] for x in FLOW_RATIOS]))

"""
Slope r/S_u·dS_u/dz below which a vessel counts as straight.
"""
const STRAIGHT_SLOPE = 1e-3

"""
Power of the filled share that weights the acceleration of the core.
"""
const FILLED_POWER = 8

"""
Functions of z that belong to the [`directed_modes`](@ref): each is the product of a term of
[`LossCoefficients`](@ref), a number and a power of ξ.
"""
const DIRECTED_PRODUCTS =
    ((1, 1, 0), (1, -1, 1), (2, 1, 0), (2, -1, 1), (3, 1, 0), (3, -2, 1), (3, 1, 2), (4, 1, 0))

"""
Number of modes of one direction of the flow. The last modes are those of reversed flow.
"""
const N_DIRECTED = length(DIRECTED_PRODUCTS)

"""
Number of functions of z, and of t, in the losses.
"""
const N_MODES = 2 + 2 * N_DIRECTED

"""
    LossParameters(vector)

Parameters of the losses by name, in the order of their vector: c_f, c_i, c_c, c_g, β, c_j, c_s,
s, s_ν and λ.
"""
struct LossParameters{T}
    friction::T
    inertia::T
    core::T
    layer_growth::T
    jet_momentum::T
    jet_recovery::T
    jet_friction::T
    jet_spread::T
    jet_viscous_spread::T
    jet_lag::T
end

LossParameters(vector::Vector{T}) where {T} =
    LossParameters{T}(NTuple{fieldcount(LossParameters), T}(vector)...)

"""
    SteadyFlow(flow, layer, jet)

A flow Q, mL/s, in the direction of z, with its d and its A_j, (z).
"""
struct SteadyFlow{T}
    flow::Float64
    layer::Vector{T}
    jet::Vector{T}
end

"""
    LossCoefficients(parameters, area_undeformed, z, physics)

Coefficients of the losses of one vessel.

# Arguments

  - `parameters`: vector of the [`LossParameters`](@ref).
  - `area_undeformed`: S_u, cm², (z).
  - `z`: points, cm.
  - `physics`: density and viscosity of the blood.

# Fields

  - `reference_flow`: Q₀, mL/s.
  - `inertia`: factor of ∂Q/∂t, per length, (z).
  - `forward`, `back`: D₁, D₂, D₃ and the factor of ∂Q/∂t of the jet's lag, integrated over
    each interval, (z − 1, 4), for Q > 0 and for Q < 0. The sign is that of a drop in the
    direction of z.
  - `forward_flows`, `back_flows`: a [`SteadyFlow`](@ref) for each of the
    [`FLOW_RATIOS`](@ref), in the direction of z and in the mirrored vessel.
"""
struct LossCoefficients{T}
    reference_flow::Float64
    inertia::Vector{T}
    forward::Matrix{T}
    back::Matrix{T}
    forward_flows::Vector{SteadyFlow{T}}
    back_flows::Vector{SteadyFlow{T}}
end

function LossCoefficients(parameters, area_undeformed, z, physics::Physics)
    named = LossParameters(parameters)
    viscosity = π * physics.viscosity / physics.density
    radius = sqrt((area_undeformed[1] + area_undeformed[end]) / 2π)
    reference_flow = REFERENCE_REYNOLDS / 2 * viscosity * radius
    forward_flows = steady_flows(named, area_undeformed, z, reference_flow, physics)
    forward = directed_factors(named, forward_flows, area_undeformed, z, physics)
    mirrored = reverse(area_undeformed), z[end] .- reverse(z)
    back_flows = steady_flows(named, mirrored..., reference_flow, physics)
    back = directed_factors(named, back_flows, mirrored..., physics)
    return LossCoefficients(
        reference_flow,
        named.inertia .* physics.density ./ area_undeformed,
        forward,
        .-reverse(back; dims = 1),
        forward_flows,
        back_flows,
    )
end

"""
    steady_flows(parameters, area_undeformed, z, reference_flow, physics)

A [`SteadyFlow`](@ref) for each of the [`FLOW_RATIOS`](@ref); `parameters` are
[`LossParameters`](@ref).
"""
function steady_flows(
    parameters::LossParameters{T}, area_undeformed, z, reference_flow, physics,
) where {T}
    return map(collect(FLOW_RATIOS)) do ratio
        flow = ratio * reference_flow
        viscosity = π * physics.viscosity / (physics.density * flow)
        layer = layer_thickness(area_undeformed, z, 4 * viscosity * parameters.layer_growth)
        jet = jet_area(
            area_undeformed, z, parameters.jet_momentum, parameters.jet_spread,
            viscosity * parameters.jet_viscous_spread,
        )
        SteadyFlow{T}(flow, layer, jet)
    end
end

"""
    directed_factors(parameters, flows, area_undeformed, z, physics)

Factors of a flow in the direction of z, (z − 1, 4), as in [`LossCoefficients`](@ref);
`parameters` are [`LossParameters`](@ref), and `flows` the [`steady_flows`](@ref).
"""
function directed_factors(
    parameters::LossParameters{T}, flows, area_undeformed, z, physics,
) where {T}
    factors = zeros(T, length(z) - 1, 4)
    for (number, (; flow, layer, jet)) in pairs(flows)
        drop = steady_drop(parameters, flow, layer, jet, area_undeformed, z, physics)
        for term in 1:3
            factors[:, term] .+= DROP_TO_FACTORS[term, number] .* drop
        end
    end
    factors[:, 4] .= lag_factor(parameters, flows[2].jet, area_undeformed, z, physics)
    return factors
end

"""
    steady_drop(parameters, flow, layer, jet, area_undeformed, z, physics)

Pressure drop of a steady flow in the direction of z over each interval, dyn/cm², (z − 1).

# Arguments

  - `parameters`: [`LossParameters`](@ref).
  - `flow`: Q, mL/s.
  - `layer`, `jet`: d and A_j of this flow, (z).
  - `area_undeformed`: S_u, cm², (z).
  - `z`: points, cm.
  - `physics`: density and viscosity of the blood.
"""
function steady_drop(
    parameters::LossParameters{T}, flow, layer, jet, area_undeformed, z, physics,
) where {T}
    (; core, friction, jet_momentum, jet_recovery, jet_friction) = parameters
    (; density, viscosity) = physics
    function local_flow(i)
        area, d = area_undeformed[i], layer[i]
        ratio = jet_momentum * jet[i] / area
        core_speed = flow / (area * mean_speed(d))
        attached = friction * 4π * viscosity * core_speed * d^6 / area
        separated = jet_friction * 8π * viscosity * flow / area^2
        return area, ratio, core_speed, ratio * attached + (1 - ratio) * separated
    end
    drop = Vector{T}(undef, length(z) - 1)
    narrowing = narrowing_shares(area_undeformed, z)
    s, filled, speed, loss = local_flow(1)
    for i in eachindex(drop)
        next_s, next_filled, next_speed, next_loss = local_flow(i + 1)
        share = narrowing[i] * ((filled + next_filled) / 2)^FILLED_POWER
        accelerated = core * density / 2 * (next_speed^2 - speed^2)
        change = 1 / jet[i + 1] - 1 / jet[i]
        mixed = jet_recovery * flow^2 * density * middle_inverse(s, next_s) * change
        drop[i] =
            share * accelerated + (1 - share) * mixed +
            (loss + next_loss) / 2 * (z[i + 1] - z[i])
        s, filled, speed, loss = next_s, next_filled, next_speed, next_loss
    end
    return drop
end

"""
    narrowing_shares(area_undeformed, z)

Share of each interval in which the vessel narrows, (z − 1).
"""
function narrowing_shares(area_undeformed, z)
    slope = central_difference(area_undeformed, z, 1)
    straight = STRAIGHT_SLOPE .* sqrt.(π .* area_undeformed)
    return map(1:(length(z) - 1)) do i
        falls = max(-slope[i], 0) + max(-slope[i + 1], 0)
        rises = max(slope[i], 0) + max(slope[i + 1], 0)
        level = (straight[i] + straight[i + 1]) / 2
        steep = falls + rises
        falls * steep / (steep^2 + level^2)
    end
end

"""
    fills(jet, area_undeformed, momentum)

Whether the flow fills the vessel at a point with the area A_j of the jet.
"""
fills(jet, area_undeformed, momentum) = jet >= area_undeformed / momentum

"""
    middle_inverse(a, b)

Mean of 1/a and 1/b. With it, the intervals that the flow fills add up to the change of
1/(2·S_u²) exactly.
"""
middle_inverse(a, b) = (1 / a + 1 / b) / 2

"""
    lag_factor(parameters, jet, area_undeformed, z, physics)

Factor of ∂Q/∂t of the jet's lag over each interval, (z − 1); the arguments are those of
[`steady_drop`](@ref).
"""
function lag_factor(parameters, jet, area_undeformed, z, physics)
    (; jet_momentum, jet_lag) = parameters
    # Volume of each jet since its beginning.
    volume = zero(jet)
    before = zero(eltype(jet))
    for i in 2:length(z)
        separated = !fills(jet[i], area_undeformed[i], jet_momentum)
        if separated
            volume[i] = volume[i - 1] + (z[i] - z[i - 1]) * (before + jet[i]) / 2
        end
        before = separated ? jet[i] : zero(eltype(jet))
    end
    lag = (1 ./ jet .- jet_momentum ./ area_undeformed) .* volume
    @views inverses = middle_inverse.(area_undeformed[1:(end - 1)], area_undeformed[2:end])
    return -2 .* jet_lag .* physics.density .* inverses .* diff(lag)
end

"""
    pressure_drop!(pressure, coefficients, flow, flow_rate, z)

p − p(L), dyn/cm², (z, time), of a known flow Q and its derivative ∂Q/∂t.
"""
function pressure_drop!(pressure, coefficients::LossCoefficients, flow, flow_rate, z)
    (; reference_flow, inertia, forward, back) = coefficients
    n = length(z)
    @inbounds for t in axes(flow, 2)
        pressure[n, t] = zero(eltype(pressure))
        after = inertia[n] * flow_rate[n, t]
        for i in (n - 1):-1:1
            here = inertia[i] * flow_rate[i, t]
            x = (flow[i, t] + flow[i + 1, t]) / (2 * reference_flow)
            rate = sign(x) * (flow_rate[i, t] + flow_rate[i + 1, t]) / 2
            factors = x > 0 ? forward : back
            size = abs(x)
            square = size^2
            pressure[i, t] =
                pressure[i + 1, t] + (here + after) / 2 * (z[i + 1] - z[i]) +
                factors[i, 1] * size +
                factors[i, 2] * (square / (1 + size)) +
                factors[i, 3] * square +
                factors[i, 4] * rate
            after = here
        end
    end
    return pressure
end

"""
    spatial_modes(coefficients, share, z)

Functions of z, (z, 18), that belong to [`temporal_modes`](@ref); `share` (z) is ξ.
"""
function spatial_modes(coefficients::LossCoefficients{T}, share, z) where {T}
    (; inertia, forward, back) = coefficients
    @views between = (share[2:end] .+ share[1:(end - 1)]) ./ 2
    modes = Matrix{T}(undef, length(z), N_MODES)
    modes[:, 1] = integral_to_outlet(inertia, z)
    modes[:, 2] = integral_to_outlet(.-inertia .* share, z)
    column = 2
    for factors in (forward, back), (term, number, power) in DIRECTED_PRODUCTS
        @views sums = cumulative_sum(number .* factors[:, term] .* between .^ power)
        column += 1
        modes[:, column] .= sums[end] .- sums
    end
    return modes
end

"""
    temporal_modes(inflow, stored, reference_flow)

Functions of time at one time point and their derivatives, 18 each: ∂q/∂t, ∂d/∂t, then the
[`directed_modes`](@ref) for forward flow, then the same for reversed flow. `inflow` and
`stored` are q and d, mL/s, with their first and second derivatives; `reference_flow` is Q₀,
mL/s.
"""
@inline function temporal_modes(inflow, stored, reference_flow)
    (q, q1, q2), (d, d1, d2) = inflow, stored
    forward = is_forward(q, d)
    onward(numbers) = map(number -> ifelse(forward, number, zero(number)), numbers)
    reversed(numbers) = map(number -> ifelse(forward, zero(number), number), numbers)
    modes = directed_modes(inflow, stored, reference_flow)
    rates = directed_rates(inflow, stored, reference_flow)
    return (
        (q1, d1, onward(modes)..., reversed(modes)...),
        (q2, d2, onward(rates)..., reversed(rates)...),
    )
end

"""
    directed_modes(inflow, stored, reference_flow)

Functions of time for the direction of the flow: with q and d relative to Q₀ and
f = q²/(1 + q), they are q, d, f, f'(q)·d, q², q·d, d² and ∂q/∂t in mL/s². Where the flow is
reversed, q and d are replaced by −q and −d. The arguments are those of
[`temporal_modes`](@ref).
"""
@inline function directed_modes(inflow, stored, reference_flow)
    (q0, q1), (d0,) = inflow, stored
    direction = flow_direction(q0, d0)
    q, d = direction * q0 / reference_flow, direction * d0 / reference_flow
    # Where the directions differ along the vessel, q may have the other sign.
    size = max(q, zero(q))
    return (
        q, d, size^2 / (1 + size), rational_slope(size) * d, q * q, q * d, d * d,
        direction * q1,
    )
end

"""
    directed_rates(inflow, stored, reference_flow)

∂/∂t of the [`directed_modes`](@ref).
"""
@inline function directed_rates(inflow, stored, reference_flow)
    (q0, q1, q2), (d0, d1) = inflow, stored
    direction = flow_direction(q0, d0)
    factor = direction / reference_flow
    q, q_rate, d, d_rate = factor * q0, factor * q1, factor * d0, factor * d1
    size = max(q, zero(q))
    slope, bend = rational_slope(size), 2 / (1 + size)^3
    return (
        q_rate,
        d_rate,
        slope * q_rate,
        bend * q_rate * d + slope * d_rate,
        2 * q * q_rate,
        q_rate * d + q * d_rate,
        2 * d * d_rate,
        direction * q2,
    )
end

"""
    rational_slope(x)

Derivative of x²/(1 + x).
"""
rational_slope(x) = x * (2 + x) / (1 + x)^2

"""
    is_forward(flow, stored)

Whether the flow in the middle of the storage, q − d/2, is not reversed. Where the directions
differ along the vessel, the flow and the terms that depend on its direction are nearly zero.
"""
is_forward(flow, stored) = flow - stored / 2 >= 0

"""
    flow_direction(flow, stored)

1 for forward and −1 for reversed flow; see [`is_forward`](@ref).
"""
flow_direction(flow, stored) = ifelse(is_forward(flow, stored), 1.0, -1.0)
