# Flow, area and pressure of one case, coupled: a spatial differential equation for Q.
#
#     ∂Q/∂z = −κ·(1 − g)·∂S/∂t,    Q(z₀, t) = Q_in(t),
#     S     = π·(r_u + u_r[p])²,                           (wall)
#     p     = p_d + 𝒵 Q(L) + losses[Q],                    (outlet, losses)
#
# periodic in time. Continuity with κ = 1 and g = 0 is the passive tube. The learned g is a
# function of the response of the passive linear tube, which follows from the inflow alone.
#
# The wall is linear in p and the losses are a sum of few products of functions of z and of
# t, so that the integrals over z are done once for each vessel, exactly on its grid, and
# only the outlet flow y = Q(L) is sought, or what is stored of the inflow, d = Q_in − y:
#
#     e·d = κ·∂V/∂t,    e(t) = 1/(1 − g),
#
# with the volume V(t) of the vessel, a function of P = 𝒵y + p_d − p₀ and of the losses.
# Each coupling pass solves the part that is linear with constant coefficients, harmonic by
# harmonic, for what the pass before it left over:
#
#     (mean(e) + κ·A(ω))·Δy = e·d − κ·∂V/∂t,
#
# where A(ω) is ∂V/∂t of a small y about the mean flow and pressure.

"""
    VesselModes(wall, loss, area_undeformed, z, law, physics)

What of a vessel, S_u (z), does not depend on the flow; k = 10 modes of the losses.

  - `radius`, `uniform`: r_u, cm, and the displacement under 1 dyn/cm² everywhere, (z).
  - `pressure`, `moved`: the losses' functions of z, and the displacements under them, (z, k).
  - `volume`: before z, that belongs to P, to P² and to the modes, (z, 2 + k).
  - `volume_slope`: what the mean of P adds to the modes' volume, (z, k).
"""
struct VesselModes
    radius::Vector{Float64}
    uniform::Vector{Float64}
    pressure::Matrix{Float64}
    moved::Matrix{Float64}
    volume::Matrix{Float64}
    volume_slope::Matrix{Float64}
end

function VesselModes(wall, loss, area_undeformed, z, law, physics::Physics)
    radius = sqrt.(area_undeformed ./ π)
    uniform = vec(displacement(wall, ones(length(z), 1), area_undeformed, z, law))
    first = from_inlet(2π .* radius .* uniform, z)
    coefficients = Coefficients(loss, area_undeformed, z, physics)
    pressure = modes_in_space(coefficients, first ./ first[end], z)
    moved = displacement(wall, pressure, area_undeformed, z, law)
    second = from_inlet(π .* uniform .^ 2, z)
    along(factor) = mapslices(mode -> from_inlet(2π .* factor .* mode, z), moved; dims = 1)
    volume = [first second along(radius)]
    return VesselModes(radius, uniform, pressure, moved, volume, along(uniform))
end

"""
    impedance(outlet, omega)

𝒵(ω) = R₁ + R₂/(1 + iωR₂C) of the outlet (R₁, R₂, C, p_d), dyn·s/cm⁵.
"""
function impedance(outlet, omega)
    r1, r2, compliance, _ = outlet
    return r1 .+ r2 ./ (1 .+ im .* omega .* r2 .* compliance)
end

"""
    Coupled

The converged functions of time of one case.

  - `outlet_pressure`: P = p(L) − p₀, dyn/cm², (time); `mean_pressure`: its mean that the
    inflow gives.
  - `modes`: the losses' functions of time, (k, time).
  - `volume`: that of [`VesselModes`](@ref) at this mean pressure, (z, 2 + k).
  - `storage`: −κ(1 − g)·∂_t of P, P² and the modes, (2 + k, time): Q = Q_in + volume·storage.
  - `change`: what the last pass changed Q(L) by at most, mL/s.
"""
struct Coupled{T}
    outlet_pressure::Vector{T}
    mean_pressure::Float64
    modes::Matrix{T}
    volume::Matrix{Float64}
    storage::Matrix{T}
    change::T
end

"""
    couple(outlet, wall, correction, shift, vessel, inflow, harmonics, settings, tolerance = 0.0)

Find the outlet flow of one case, and all functions of time with it, as [`Coupled`](@ref).

# Arguments

  - `outlet`, `wall`, `correction`: parameters; `shift`: see [`hidden_share`](@ref).
  - `vessel`: its [`VesselModes`](@ref).
  - `inflow`: Q_in, mL/s, (time).
  - `harmonics`: [`Harmonics`](@ref) of these instants.
  - `settings`: a [`CorrectionClosure`](@ref).
  - `tolerance`: passes end once one changes Q(L) by less, relative to the largest inflow;
    with 0 all passes are made, as derivatives need it.
"""
function couple(
    outlet, wall, correction::Vector{T}, shift, vessel::VesselModes, inflow::Vector{Float64},
    harmonics::Harmonics, settings::CorrectionClosure, tolerance::Float64 = 0.0,
) where {T}
    turned = im .* harmonics.omega
    z_outlet = impedance(outlet, harmonics.omega)
    kappa = storage_factor(correction)
    q_hat = spectrum(harmonics, inflow)
    q = signals(harmonics, [q_hat, turned .* q_hat, turned .^ 2 .* q_hat])

    offset = outlet[4] - wall[end]
    mean_flow = sum(inflow) / length(inflow)
    mean_pressure = real(z_outlet[1]) * mean_flow + offset
    volume = copy(vessel.volume)
    volume[:, 3:end] .+= mean_pressure .* vessel.volume_slope
    total = volume[end, :]

    passive = q_hat ./ (1 .+ kappa .* total[1] .* turned .* z_outlet)
    response = signals(harmonics, [turned .* z_outlet .* passive, passive])
    g = hidden_share(correction, response[1, :], response[2, :], shift, settings.hidden)
    shown = 1 ./ (1 .- g)

    # Of the modes d, ∂d/∂t and q·d, which come with −y.
    of_stored, of_rate = total[4], total[6]
    of_product = mean_flow >= 0 ? total[8] : total[11]
    linear =
        turned .* z_outlet .* (total[1] + 2 * mean_pressure * total[2]) .-
        turned .* (of_stored + of_product * mean_flow .+ turned .* of_rate)
    solve = 1 ./ (sum(shown) / length(shown) .+ kappa .* linear)

    pressure = Vector{T}(undef, length(inflow))
    modes = Matrix{T}(undef, N_MODES, length(inflow))
    rates = Matrix{T}(undef, 2 + N_MODES, length(inflow))
    function after_outlet!(y_hat)
        stored, p_hat = q_hat .- y_hat, z_outlet .* y_hat
        stored_rate = turned .* stored
        spectra = [stored, stored_rate, turned .* stored_rate, p_hat, turned .* p_hat]
        at_outlet = signals(harmonics, spectra)
        state!(pressure, modes, rates, q, at_outlet, offset)
        return at_outlet[1, :]
    end

    y_hat, change = Vector{Complex{T}}(passive), T(Inf)
    settled = tolerance * maximum(abs, inflow)
    for _ in 1:settings.passes
        stored = after_outlet!(y_hat)
        left = shown .* stored .- kappa .* (rates' * total)
        step = solve .* spectrum(harmonics, left)
        y_hat = y_hat .+ step
        # No signal exceeds the sum of its harmonics' amplitudes.
        size = abs.(step)
        change = (2 * sum(size) - size[1]) / length(inflow)
        change <= settled && break
    end
    after_outlet!(y_hat)
    storage = -kappa .* (1 .- g') .* rates
    return Coupled(pressure, mean_pressure, modes, volume, storage, change)
end

"""
    state!(pressure, modes, rates, q, at_outlet, offset)

P, the losses' modes, and the rates of P, P² and the modes, from q with its two rates, and
the outlet's d with its two rates, P without its constant part `offset`, and ∂P/∂t.
"""
function state!(pressure, modes, rates, q, at_outlet, offset)
    for t in eachindex(pressure)
        inflow = (q[1, t], q[2, t], q[3, t])
        stored = (at_outlet[1, t], at_outlet[2, t], at_outlet[3, t])
        @views modes_in_time!(modes[:, t], rates[3:end, t], inflow, stored)
        pressure[t] = at_outlet[4, t] + offset
        rates[1, t] = at_outlet[5, t]
        rates[2, t] = 2 * pressure[t] * rates[1, t]
    end
    return nothing
end

"""
    fields!(flow, area, pressure, coupled, vessel, wall, inflow)

Flow (mL/s), area (cm²) and pressure (dyn/cm²) of one case, each (z, time).

The area keeps of the square (r_u + u_r)² what the volume keeps: all of the uniform
pressure's displacement, and of the losses' the product with the rest at its mean pressure.
"""
function fields!(flow, area, pressure, coupled::Coupled, vessel::VesselModes, wall, inflow)
    (; radius, uniform) = vessel
    p = coupled.outlet_pressure'
    flow .= inflow'
    mul!(flow, coupled.volume, coupled.storage, 1, 1)
    area .= π .* (radius .+ uniform .* p) .^ 2
    moved = 2π .* (radius .+ uniform .* coupled.mean_pressure) .* vessel.moved
    mul!(area, moved, coupled.modes, 1, 1)
    pressure .= p .+ wall[end]
    mul!(pressure, vessel.pressure, coupled.modes, 1, 1)
    return nothing
end
