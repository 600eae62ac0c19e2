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

Functions of z of one vessel, S_u (z): flow, area and pressure are their sums. They belong to
the functions of time of [`Coupled`](@ref), with k = 10 modes of the losses.

  - `flow`: 1, and the volume before z that belongs to P, to P² and to the modes, (z, 3 + k).
  - `area`: of P², of 1, of P and of the modes, (z, 3 + k): (r_u + u_r)² without the products
    of modes.
  - `pressure`: p₀, 1 and the losses' functions of z, (z, 2 + k).
  - `flow_slope`, `area_slope`: what the mean of P adds to the modes' columns of flow and
    area, (z, k).
"""
struct VesselModes
    flow::Matrix{Float64}
    area::Matrix{Float64}
    pressure::Matrix{Float64}
    flow_slope::Matrix{Float64}
    area_slope::Matrix{Float64}
end

function VesselModes(wall, loss, area_undeformed, z, law, physics::Physics)
    radius = sqrt.(area_undeformed ./ π)
    uniform = vec(displacement(wall, ones(length(z), 1), area_undeformed, z, law))
    per_pressure = 2π .* radius .* uniform
    first = from_inlet(per_pressure, z)
    coefficients = Coefficients(loss, area_undeformed, z, physics)
    pressure = modes_in_space(coefficients, first ./ first[end], z)
    moved = displacement(wall, pressure, area_undeformed, z, law)
    square, one = π .* uniform .^ 2, ones(length(z))
    area, slope = 2π .* radius .* moved, 2π .* uniform .* moved
    along(modes) = mapslices(mode -> from_inlet(mode, z), modes; dims = 1)
    return VesselModes(
        [one first from_inlet(square, z) along(area)],
        [square area_undeformed per_pressure area],
        [wall[end] .* one one pressure],
        along(slope),
        slope,
    )
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
    Coupled(T, harmonics)

The functions of time of one case, which [`couple!`](@ref) finds; k as in
[`VesselModes`](@ref).

  - `flow`: of the flow: Q_in, and −κ(1 − g)·∂_t of P = p(L) − p₀, of P² and of the modes,
    (3 + k, time).
  - `area`: of the area: P², 1, P and the modes; without the first those of the pressure,
    (3 + k, time).
  - `mean_pressure`: the mean of P that the inflow gives.
  - `change`: no change of Q(L) in the last pass was larger, mL/s.
  - `reverses`: whether some flow goes back; else the last three modes are zero.
  - `inflow`: q with its two rates, then the passive tube's ∂P/∂t and Q(L); `outlet`: d with
    its two rates, P without its constant part, and ∂P/∂t; `left`: what a pass has left over.
"""
mutable struct Coupled{T}
    const flow::Matrix{T}
    const area::Matrix{T}
    mean_pressure::Float64
    change::T
    reverses::Bool
    const inflow::Waves{T}
    const outlet::Waves{T}
    const left::Waves{T}
end

function Coupled(::Type{T}, harmonics::Harmonics) where {T}
    room() = Matrix{T}(undef, 3 + N_MODES, harmonics.n_times)
    waves = (Waves(T, harmonics, n_signals) for n_signals in (5, 5, 1))
    return Coupled(room(), room(), NaN, T(NaN), false, waves...)
end

"""
    couple!(coupled, outlet, wall, correction, shift, vessel, inflow, harmonics, settings,
        tolerance = 0.0)

Find the outlet flow of one case, and all functions of time with it.

# Arguments

  - `outlet`, `wall`, `correction`: parameters; `shift`: see [`hidden_share`](@ref).
  - `vessel`: its [`VesselModes`](@ref).
  - `inflow`: Q_in, mL/s, (time).
  - `harmonics`: [`Harmonics`](@ref) of these instants.
  - `settings`: a [`CorrectionClosure`](@ref).
  - `tolerance`: passes end once one changes Q(L) by less, relative to the largest inflow;
    with 0 all passes are made, as derivatives need it.
"""
function couple!(
    coupled::Coupled{T}, outlet, wall, correction::Vector{T}, shift, vessel::VesselModes,
    inflow, harmonics::Harmonics, settings::CorrectionClosure, tolerance::Float64 = 0.0,
) where {T}
    turned = im .* harmonics.omega
    z_outlet = impedance(outlet, harmonics.omega)
    kappa = storage_factor(correction)
    offset = outlet[4] - wall[end]
    mean_flow = sum(inflow) / length(inflow)
    mean_pressure = real(z_outlet[1]) * mean_flow + offset
    total = [
        vessel.flow[end, 1 + k] + (k > 2 ? mean_pressure * vessel.flow_slope[end, k - 2] : 0)
        for k in 1:(2 + N_MODES)
    ]

    coupled.left.signals[:, 1] = inflow
    analyse!(coupled.left, harmonics)
    @views q_hat = complex.(coupled.left.real[:, 1], coupled.left.imaginary[:, 1])
    passive = q_hat ./ (1 .+ kappa .* total[1] .* turned .* z_outlet)
    set!(coupled.inflow, 1, q_hat)
    set!(coupled.inflow, 2, turned .* q_hat)
    set!(coupled.inflow, 3, turned .^ 2 .* q_hat)
    set!(coupled.inflow, 4, turned .* z_outlet .* passive)
    set!(coupled.inflow, 5, passive)
    synthesise!(coupled.inflow, harmonics)
    q = coupled.inflow.signals
    q[:, 1] = inflow
    @views g = hidden_share(correction, q[:, 4], q[:, 5], shift, settings.hidden)
    shown = 1 ./ (1 .- g)

    # Of the modes d, ∂d/∂t and q·d, which come with −y.
    of_stored, of_rate = total[4], total[6]
    of_product = mean_flow >= 0 ? total[8] : total[11]
    linear =
        turned .* z_outlet .* (total[1] + 2 * mean_pressure * total[2]) .-
        turned .* (of_stored + of_product * mean_flow .+ turned .* of_rate)
    solve = 1 ./ (sum(shown) / length(shown) .+ kappa .* linear)

    y_hat, change = passive, T(Inf)
    settled = tolerance * maximum(abs, inflow)
    after_outlet!(coupled.outlet, harmonics, q_hat, y_hat, z_outlet)
    for _ in 1:settings.passes
        left_over!(coupled.left.signals, q, coupled.outlet.signals, shown, total, kappa, offset)
        analyse!(coupled.left, harmonics)
        change = advance!(y_hat, coupled.left, solve) / length(inflow)
        after_outlet!(coupled.outlet, harmonics, q_hat, y_hat, z_outlet)
        change <= settled && break
    end
    coupled.mean_pressure, coupled.change = mean_pressure, change
    functions_of_time!(coupled, g, kappa, offset)
    return coupled
end

"""
    set!(waves, signal, spectrum)

Put complex harmonics in the place of a signal's.
"""
function set!(waves::Waves, signal, spectrum)
    @inbounds for k in eachindex(spectrum)
        waves.real[k, signal], waves.imaginary[k, signal] = reim(spectrum[k])
    end
    return nothing
end

"""
    after_outlet!(waves, harmonics, q_hat, y_hat, z_outlet)

Fill the signals of the outlet from the harmonics of the inflow and of the outlet flow.
"""
function after_outlet!(waves::Waves, harmonics::Harmonics, q_hat, y_hat, z_outlet)
    (; real, imaginary) = waves
    @inbounds for k in eachindex(y_hat)
        omega, d, p = harmonics.omega[k], q_hat[k] - y_hat[k], z_outlet[k] * y_hat[k]
        real[k, 1], imaginary[k, 1] = reim(d)
        real[k, 2], imaginary[k, 2] = reim(im * omega * d)
        real[k, 3], imaginary[k, 3] = reim(-omega^2 * d)
        real[k, 4], imaginary[k, 4] = reim(p)
        real[k, 5], imaginary[k, 5] = reim(im * omega * p)
    end
    synthesise!(waves, harmonics)
    return nothing
end

"""
    left_over!(left, q, outlet, shown, total, kappa, offset)

Fill `left` with e·d − κ·∂V/∂t from the signals of inflow and outlet (see [`Coupled`](@ref)),
e, the volume that belongs to P, P² and the modes, κ, and the constant part of P.
"""
function left_over!(left, q, outlet, shown, total, kappa, offset)
    @inbounds @simd for t in eachindex(shown)
        q0, q1, q2 = q[t, 1], q[t, 2], q[t, 3]
        d0, d1, d2 = outlet[t, 1], outlet[t, 2], outlet[t, 3]
        p, p1 = outlet[t, 4] + offset, outlet[t, 5]
        forward = goes_forward(q0, d0)
        (s1, s2, s3) = square_rates(q0, q1, d0, d1)
        squares =
            ifelse(forward, total[7], total[10]) * s1 +
            ifelse(forward, total[8], total[11]) * s2 +
            ifelse(forward, total[9], total[12]) * s3
        filling =
            total[1] * p1 +
            total[2] * (2 * p * p1) +
            total[3] * q1 +
            total[4] * d1 +
            total[5] * q2 +
            total[6] * d2 +
            squares
        left[t] = shown[t] * d0 - kappa * filling
    end
    return nothing
end

"""
    advance!(y_hat, left, solve)

Add to the harmonics of the outlet flow what was left over, solved for; return the sum of the
amplitudes, which no signal exceeds.
"""
function advance!(y_hat, left::Waves, solve)
    amplitudes = zero(eltype(left.signals))
    @inbounds for k in eachindex(y_hat)
        step = solve[k] * complex(left.real[k], left.imaginary[k])
        y_hat[k] += step
        # All harmonics but the mean stand for two.
        amplitudes += (k == 1 ? 1 : 2) * sqrt(abs2(step))
    end
    return amplitudes
end

"""
    functions_of_time!(coupled, g, kappa, offset)

Fill `flow`, `area` and `reverses` from the signals of inflow and outlet.
"""
function functions_of_time!(coupled::Coupled, g, kappa, offset)
    (; flow, area) = coupled
    q, outlet = coupled.inflow.signals, coupled.outlet.signals
    coupled.reverses = false
    @inbounds for t in eachindex(g)
        inflow, stored = (q[t, 1], q[t, 2], q[t, 3]), (outlet[t, 1], outlet[t, 2], outlet[t, 3])
        p, p_rate = outlet[t, 4] + offset, outlet[t, 5]
        modes, rates = modes_in_time(inflow, stored)
        storage = -kappa * (1 - g[t])
        fill_column!(flow, t, (inflow[1], (storage .* (p_rate, 2 * p * p_rate, rates...))...))
        fill_column!(area, t, (p^2, one(p), p, modes...))
        goes_forward(inflow[1], stored[1]) || (coupled.reverses = true)
    end
    return nothing
end

@inline function fill_column!(matrix, column, values::NTuple{N, Any}) where {N}
    ntuple(row -> @inbounds(matrix[row, column] = values[row]), Val(N))
    return nothing
end

"""
    fields!(flow, area, pressure, coupled, vessel)

Flow (mL/s), area (cm²) and pressure (dyn/cm²) of one case, each (z, time): sums of products
of functions of z and of time.
"""
function fields!(flow, area, pressure, coupled::Coupled, vessel::VesselModes)
    # Modes of reversed flow, the last, are zero where there is none.
    used = 1:(3 + N_MODES - (coupled.reverses ? 0 : N_SQUARES))
    mean = coupled.mean_pressure
    @views begin
        mul!(
            flow,
            at_mean(vessel.flow[:, used], vessel.flow_slope, mean),
            coupled.flow[used, :],
        )
        mul!(
            area,
            at_mean(vessel.area[:, used], vessel.area_slope, mean),
            coupled.area[used, :],
        )
        used = 1:(last(used) - 1)
        mul!(pressure, vessel.pressure[:, used], coupled.area[used .+ 1, :])
    end
    return nothing
end

"""
    at_mean(functions, slope, mean)

A vessel's functions of z, (z, function), at this mean of P: those after the first three
belong to the modes, whose `slope` (z, mode) it multiplies.
"""
function at_mean(functions, slope, mean)
    at = Matrix(functions)
    @inbounds for mode in 1:(size(at, 2) - 3), i in axes(at, 1)
        at[i, 3 + mode] += mean * slope[i, mode]
    end
    return at
end
