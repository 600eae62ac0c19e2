# Wall shear stress of the flow whose pressure losses are known, from the same layer and jet
# (`boundary_layer.jl`).
#
# Poiseuille's wall shear stress of a steady flow Q is multiplied by
#
#     1 + c₁·b·R(Λ₁) + c₂·R(Λ₂) + c₃·b·R(Λ₃) − c₄·d·R(Λ₄) + c₅·R(−Λ₅) − c₆·d·tanh(Λ₁⁻/20) − c₇·l − c₈·j,
#
# where R(x) = x/√(x + 0.3) for x > 0, else 0, is almost √x, with the core's speed U, the layer's
# thickness δ = d·r_u, and
#
#   - the layer's shear relative to Poiseuille's, b = U_e/(2·d·Q/S_u). The speed at its edge is
#     U_e = U − 0.6·r_u²·U''/8: streamlines that bend into the throat are faster near the wall;
#   - the pressure gradient in the layer, Λ = δ²·U_e'/ν, which is Pohlhausen's parameter: b·√Λ is
#     the shear of a layer in an accelerating flow, U_e·√(U_e'/ν) (Falkner and Skan);
#   - l = ln(S_u/(β·A_j)), by which the flow near the wall turns back where it is separated.
#
# The layer remembers the pressure gradient. Λᵢ is Λ, or for i = 2, 3, 4 its positive part,
# relaxed along z; so is j:
#
#     Λᵢ' = (Λ − Λᵢ)/ℓᵢ,    ℓ₁ = ℓ₂ = 0.005·δ²U/ν,  ℓ₃, ℓ₄, ℓ₅ = 0.3, 0.6, 1.2 r_u,
#     j' = (R(S_u/(β·A_j) − 1) − j)/ℓ_j,    ℓ_j = 0.08·r_u²·(Q/S_u)/ν.
#
# x⁻ is the size of the negative part of x. As the losses, the result is computed at
# three Reynolds numbers and interpolated. An unsteady flow adds c₀·ρ/(6π·r_u)·∂Q/∂t, which is
# Womersley's result for slow oscillations if c₀ = 1. In a straight vessel Λ, l and j are zero:
# the steady result is Poiseuille's for any parameters. Predictions have the magnitude.

"""
Number of parameters, c₀ to c₈, and of [`ShearTerms`](@ref) for each direction of the flow.
"""
const N_SHEAR = 9

"""
Intervals on either side of a point from which derivatives are computed.
"""
const DERIVATIVE_WIDTH = 2

"""
Effect of the streamlines' curvature on U_e; 1 in a potential flow.
"""
const EDGE_CURVATURE = 0.6

"""
Λ at which the effect of a deceleration on the layer is limited.
"""
const DECELERATION_LIMIT = 20.0

"""
Value below which R is proportional to x.
"""
const SMALL_ROOT = 0.3

"""
Length of relaxation relative to δ²U/ν.
"""
const LAYER_RELAXATION = 0.005

"""
Length of relaxation relative to r_u²·(Q/S_u)/ν.
"""
const JET_RELAXATION = 0.08

"""
Lengths of relaxation relative to r_u.
"""
const RADII_OF_RELAXATION = (0.3, 0.6, 1.2)

"""
    ShearTerms(coefficients, momentum, area_undeformed, z, physics)

Terms of the wall shear stress of one vessel that the parameters multiply.

# Arguments

  - `coefficients`: [`LossCoefficients`](@ref) of the vessel.
  - `momentum`: β.
  - `area_undeformed`: S_u, cm², (z).
  - `z`: points, cm.
  - `physics`: density and viscosity of the blood.

# Fields

  - `unsteady`: factor of ∂Q/∂t, (z).
  - `forward`, `back`: Poiseuille's stress and the eight terms, each as factors of x, x²/(1 + x)
    and x² with x = |Q|/Q₀, (z, 3, 9), for Q > 0 and for Q < 0.
"""
struct ShearTerms
    unsteady::Vector{Float64}
    forward::Array{Float64, 3}
    back::Array{Float64, 3}
end

function ShearTerms(
    coefficients::LossCoefficients{Float64}, momentum, area_undeformed, z, physics::Physics,
)
    (; forward_flows, back_flows) = coefficients
    forward = directed_shear(forward_flows, momentum, area_undeformed, z, physics)
    mirrored = reverse(area_undeformed), z[end] .- reverse(z)
    back = directed_shear(back_flows, momentum, mirrored..., physics)
    unsteady = physics.density ./ 6 ./ sqrt.(π .* area_undeformed)
    return ShearTerms(unsteady, forward, .-reverse(back; dims = 1))
end

"""
    directed_shear(flows, momentum, area_undeformed, z, physics)

Terms of flows in the direction of z, [`SteadyFlow`](@ref)s, as in [`ShearTerms`](@ref).
"""
function directed_shear(flows, momentum, area_undeformed, z, physics)
    terms = zeros(length(z), length(flows), N_SHEAR)
    for (number, flow) in pairs(flows)
        stress = steady_shear(flow, momentum, area_undeformed, z, physics)
        for factor in axes(terms, 2)
            terms[:, factor, :] .+= DROP_TO_FACTORS[factor, number] .* stress
        end
    end
    return terms
end

"""
    steady_shear(flow, momentum, area_undeformed, z, physics)

Poiseuille's wall shear stress and the eight terms of a [`SteadyFlow`](@ref), dyn/cm², (z, 9).
"""
function steady_shear(flow::SteadyFlow, momentum, area_undeformed, z, physics)
    kinematic = physics.viscosity / physics.density
    radius, d = sqrt.(area_undeformed ./ π), flow.layer
    mean = flow.flow ./ area_undeformed
    core = mean ./ mean_speed.(d)
    bend = radius .^ 2 .* second_difference(core, z)
    edge = max.(core .- (EDGE_CURVATURE / 8) .* bend, 0)
    shear = edge ./ (2 .* d .* mean)
    gradient = (radius .* d) .^ 2 ./ kinematic .* central_difference(edge, z, DERIVATIVE_WIDTH)
    accelerating = max.(gradient, 0)
    jet = area_undeformed ./ (momentum .* flow.jet)
    mixing = near_root.(jet .- 1)
    layer_length = LAYER_RELAXATION .* (radius .* d) .^ 2 .* core ./ kinematic
    short, middle, long = (ratio .* radius for ratio in RADII_OF_RELAXATION)
    first = relaxed(gradient, layer_length, z)
    second = relaxed(accelerating, layer_length, z)
    third = relaxed(accelerating, short, z)
    fourth = relaxed(accelerating, middle, z)
    fifth = relaxed(gradient, long, z)
    mixed = relaxed(mixing, JET_RELAXATION .* radius .^ 2 .* mean ./ kinematic, z)
    poiseuille = 4 .* physics.viscosity .* mean ./ radius
    factors = (
        ones(length(z)),
        shear .* near_root.(first),
        near_root.(second),
        shear .* near_root.(third),
        .-d .* near_root.(fourth),
        near_root.(.-fifth),
        .-d .* tanh.(max.(.-first, 0) ./ DECELERATION_LIMIT),
        .-log.(jet),
        .-mixed,
    )
    return poiseuille .* reduce(hcat, factors)
end

"""
    near_root(x)

R(x), almost the square root of a positive x; it does not amplify round-off.
"""
near_root(x) = max(x, 0) / sqrt(max(x, 0) + SMALL_ROOT)

"""
    central_difference(values, z, width)

Derivative of values over `width` intervals on either side; zero at the ends.
"""
function central_difference(values, z, width)
    result = zero(values)
    for i in (1 + width):(length(z) - width)
        result[i] = (values[i + width] - values[i - width]) / (z[i + width] - z[i - width])
    end
    return result
end

"""
    second_difference(values, z)

Second derivative of values over [`DERIVATIVE_WIDTH`](@ref) intervals on either side; zero at
the ends.
"""
function second_difference(values, z)
    result, width = zero(values), DERIVATIVE_WIDTH
    slope(i) = (values[i + width] - values[i]) / (z[i + width] - z[i])
    for i in (1 + width):(length(z) - width)
        result[i] = 2 * (slope(i) - slope(i - width)) / (z[i + width] - z[i - width])
    end
    return result
end

"""
    relaxed(source, len, z)

Solution of y' = (source − y)/len with y = 0 at the first point; exact for linear sources.
"""
function relaxed(source, len, z)
    y = zero(source)
    for i in 1:(length(z) - 1)
        step = 2 * (z[i + 1] - z[i]) / (len[i] + len[i + 1])
        decay, mean = exp(-step), -expm1(-step) / step
        gain = source[i] * (mean - decay) + source[i + 1] * (1 - mean)
        y[i + 1] = decay * y[i] + gain
    end
    return y
end

"""
    shear_factors(parameters, terms)

Factors of x, x²/(1 + x) and x² in the sum of all terms of one direction, (z, 3); `parameters`
are c₀ to c₈.
"""
shear_factors(parameters, terms) =
    terms[:, :, 1] .+ sum(parameters[i] .* terms[:, :, i] for i in 2:N_SHEAR)

"""
    shear_modes(parameters, terms, share)

Functions of z, (z, 18), that belong to [`temporal_modes`](@ref); `share` (z) is ξ.
"""
function shear_modes(parameters, terms::ShearTerms, share)
    modes = zeros(length(share), N_MODES)
    modes[:, 1] .= parameters[1] .* terms.unsteady
    modes[:, 2] .= .-modes[:, 1] .* share
    column = 2
    for direction in (terms.forward, terms.back)
        factors = shear_factors(parameters, direction)
        for (term, number, power) in DIRECTED_PRODUCTS
            column += 1
            term <= 3 || continue
            modes[:, column] .= number .* factors[:, term] .* share .^ power
        end
    end
    return modes
end

"""
    wall_shear_stress!(stress, parameters, terms, reference_flow, flow, flow_rate)

Wall shear stress, with its sign, of a known flow Q and its derivative ∂Q/∂t, (z, time).
"""
function wall_shear_stress!(stress, parameters, terms, reference_flow, flow, flow_rate)
    forward = shear_factors(parameters, terms.forward)
    back = shear_factors(parameters, terms.back)
    @inbounds for t in axes(flow, 2), i in axes(flow, 1)
        x = flow[i, t] / reference_flow
        factors, size = x > 0 ? forward : back, abs(x)
        square = size^2
        stress[i, t] =
            parameters[1] * terms.unsteady[i] * flow_rate[i, t] +
            factors[i, 1] * size +
            factors[i, 2] * (square / (1 + size)) +
            factors[i, 3] * square
    end
    return stress
end
