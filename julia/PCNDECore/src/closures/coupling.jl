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
    OutletLaw(parameters, omega)

p(L) = p_d + 𝒵 Q(L) with 𝒵(ω) = R₁ + R₂/(1 + iωR₂C); `parameters` are R₁, R₂, C, p_d.

  - `impedance`: 𝒵, dyn·s/cm⁵, and `rate`: iω𝒵, (harmonic).
  - `resistance`: 𝒵 if it is the same for all, else NaN.
  - `distal_pressure`: p_d, dyn/cm².
"""
struct OutletLaw
    impedance::Vector{ComplexF64}
    rate::Vector{ComplexF64}
    resistance::Float64
    distal_pressure::Float64
end

function OutletLaw(parameters, omega)
    r1, r2, compliance, distal_pressure = parameters
    impedance = r1 .+ r2 ./ (1 .+ im .* omega .* r2 .* compliance)
    resistance = r2 * compliance == 0 ? r1 + r2 : NaN
    return OutletLaw(impedance, im .* omega .* impedance, resistance, distal_pressure)
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
  - `inflow`: q with its two rates, then the passive tube's ∂P/∂t and Q(L); `stored`: d with
    its two rates; `pressure`: P without its constant part, and ∂P/∂t; `left`: what a pass
    has left over.
  - `inflow_harmonics`, `outlet_flow`: of q and Q(L), and `solve`: a pass multiplies by it
    what is left over, (harmonic).
"""
mutable struct Coupled{T}
    const flow::Matrix{T}
    const area::Matrix{T}
    mean_pressure::Float64
    change::T
    reverses::Bool
    const inflow::Waves{T}
    const stored::Waves{T}
    const pressure::Waves{T}
    const left::Waves{T}
    const inflow_harmonics::Vector{Complex{T}}
    const outlet_flow::Vector{Complex{T}}
    const solve::Vector{Complex{T}}
end

function Coupled(::Type{T}, harmonics::Harmonics) where {T}
    functions() = Matrix{T}(undef, 3 + N_MODES, harmonics.n_times)
    waves = (Waves(T, harmonics, n_signals) for n_signals in (5, 3, 2, 1))
    spectra = (Vector{Complex{T}}(undef, length(harmonics.omega)) for _ in 1:3)
    return Coupled(functions(), functions(), NaN, T(NaN), false, waves..., spectra...)
end

"""
    couple!(coupled, outlet, wall, correction, shift, vessel, inflow, harmonics, settings,
        tolerance = 0.0)

Find the outlet flow of one case, and all functions of time with it.

# Arguments

  - `outlet`: [`OutletLaw`](@ref) of these harmonics.
  - `wall`, `correction`: parameters; `shift`: see [`hidden_share`](@ref).
  - `vessel`: its [`VesselModes`](@ref).
  - `inflow`: Q_in, mL/s, (time).
  - `harmonics`: [`Harmonics`](@ref) of these instants.
  - `settings`: a [`CorrectionClosure`](@ref).
  - `tolerance`: passes end once the next would change Q(L) by less, relative to the largest
    inflow, if it changed it as much less as the last one did; with 0 all passes are made, as
    derivatives need it.
"""
function couple!(
    coupled::Coupled{T}, outlet::OutletLaw, wall, correction::Vector{T}, shift,
    vessel::VesselModes, inflow, harmonics::Harmonics, settings::CorrectionClosure,
    tolerance::Float64 = 0.0,
) where {T}
    kappa = storage_factor(correction)
    offset = outlet.distal_pressure - wall[end]
    mean_flow = sum(inflow) / length(inflow)
    mean_pressure = real(outlet.impedance[1]) * mean_flow + offset
    total = [
        vessel.flow[end, 1 + k] + (k > 2 ? mean_pressure * vessel.flow_slope[end, k - 2] : 0)
        for k in 1:(2 + N_MODES)
    ]
    linearise!(coupled, outlet, total, kappa, inflow, mean_flow, mean_pressure, harmonics)
    q = coupled.inflow.signals
    q[:, 1] = inflow
    @views g = hidden_share(correction, q[:, 4], q[:, 5], shift, settings.hidden)
    shown = 1 ./ (1 .- g)
    coupled.solve .= inverse.(sum(shown) / length(shown) .+ coupled.solve)

    settled, before = tolerance * maximum(abs, inflow), zero(T)
    after_outlet!(coupled, harmonics, outlet)
    for _ in 1:settings.passes
        left_over!(coupled, shown, total, kappa, offset)
        analyse!(coupled.left, harmonics)
        change = advance!(coupled)
        after_outlet!(coupled, harmonics, outlet)
        coupled.change = change
        change^2 <= settled * max(change, before) && break
        before = change
    end
    coupled.mean_pressure = mean_pressure
    functions_of_time!(coupled, g, kappa, offset)
    return coupled
end

"""
    linearise!(coupled, outlet, total, kappa, inflow, mean_flow, mean_pressure, harmonics)

Fill the inflow's harmonics and signals, the passive tube's outlet flow, and `solve` with
κ·A(ω).
"""
function linearise!(
    coupled::Coupled, outlet::OutletLaw, total, kappa, inflow, mean_flow, mean_pressure,
    harmonics,
)
    (; left, inflow_harmonics, outlet_flow, solve) = coupled
    left.signals[:, 1] = inflow
    analyse!(left, harmonics)
    # Of the modes d, ∂d/∂t and q·d, which come with −y.
    of_stored, of_rate = total[4], total[6]
    of_product = mean_flow >= 0 ? total[8] : total[11]
    @inbounds for k in eachindex(solve)
        turned, rate = im * harmonics.omega[k], outlet.rate[k]
        q = complex(left.real[k], left.imaginary[k])
        y = q * inverse(1 + kappa * total[1] * rate)
        set!(coupled.inflow, k, (q, turned * q, turned^2 * q, rate * y, y))
        inflow_harmonics[k], outlet_flow[k] = q, y
        solve[k] =
            kappa * (
                rate * (total[1] + 2 * mean_pressure * total[2]) -
                turned * (of_stored + of_product * mean_flow + turned * of_rate)
            )
    end
    synthesise!(coupled.inflow, harmonics)
    return nothing
end

"""
    inverse(number)

1 / number of a complex number of moderate size, without the care that others need.
"""
inverse(number) = conj(number) / abs2(number)

"""
    set!(waves, harmonic, values)

Put a complex number for each signal in the place of this harmonic.
"""
@inline function set!(waves::Waves, harmonic, values::NTuple{N, Any}) where {N}
    ntuple(Val(N)) do signal
        @inbounds waves.real[harmonic, signal] = real(values[signal])
        @inbounds waves.imaginary[harmonic, signal] = imag(values[signal])
        nothing
    end
    return nothing
end

"""
    after_outlet!(coupled, harmonics, outlet)

Fill the signals of what is stored and of the pressure from the harmonics of inflow and
outlet flow.
"""
function after_outlet!(coupled::Coupled, harmonics::Harmonics, outlet::OutletLaw)
    (; inflow_harmonics, outlet_flow, stored, pressure) = coupled
    @inbounds for k in eachindex(outlet_flow)
        omega, d = harmonics.omega[k], inflow_harmonics[k] - outlet_flow[k]
        set!(stored, k, (d, im * omega * d, -omega^2 * d))
    end
    synthesise!(stored, harmonics)
    if isnan(outlet.resistance)
        @inbounds for k in eachindex(outlet_flow)
            y = outlet_flow[k]
            set!(pressure, k, (outlet.impedance[k] * y, outlet.rate[k] * y))
        end
        synthesise!(pressure, harmonics)
    else
        q, d, p = coupled.inflow.signals, stored.signals, pressure.signals
        @inbounds for signal in 1:2
            @simd for t in axes(p, 1)
                p[t, signal] = outlet.resistance * (q[t, signal] - d[t, signal])
            end
        end
    end
    return nothing
end

"""
    left_over!(coupled, shown, total, kappa, offset)

Fill `left` with e·d − κ·∂V/∂t, from e, the volume that belongs to P, P² and the modes, κ,
and the constant part of P.
"""
function left_over!(coupled::Coupled, shown, total, kappa, offset)
    q, stored, pressure = signals(coupled)
    left = coupled.left.signals
    @inbounds @simd for t in eachindex(shown)
        q0, q1, q2 = q[t, 1], q[t, 2], q[t, 3]
        d0, d1, d2 = stored[t, 1], stored[t, 2], stored[t, 3]
        p, p1 = pressure[t, 1] + offset, pressure[t, 2]
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
    signals(coupled)

Of the inflow, of what is stored, and of the pressure; see [`Coupled`](@ref).
"""
signals(coupled::Coupled) =
    (coupled.inflow.signals, coupled.stored.signals, coupled.pressure.signals)

"""
    advance!(coupled)

Add to the harmonics of the outlet flow what was left over, solved for; return the sum of the
amplitudes, which no signal exceeds.
"""
function advance!(coupled::Coupled{T}) where {T}
    (; left, outlet_flow, solve) = coupled
    amplitudes = zero(T)
    @inbounds for k in eachindex(outlet_flow)
        step = solve[k] * complex(left.real[k], left.imaginary[k])
        outlet_flow[k] += step
        amplitudes += sqrt(abs2(step))
    end
    return amplitudes
end

"""
    functions_of_time!(coupled, g, kappa, offset)

Fill `flow`, `area` and `reverses` from the signals of inflow and outlet.
"""
function functions_of_time!(coupled::Coupled, g, kappa, offset)
    (; flow, area) = coupled
    q, d, pressure = signals(coupled)
    coupled.reverses = false
    @inbounds for t in eachindex(g)
        inflow, stored = (q[t, 1], q[t, 2], q[t, 3]), (d[t, 1], d[t, 2], d[t, 3])
        p, p_rate = pressure[t, 1] + offset, pressure[t, 2]
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
    FieldsRoom(n_points, n_times)

Room for one field, (z, time), and for the functions of z that make it up, (z, 3 + k).
"""
struct FieldsRoom
    field::Matrix{Float64}
    in_z::Matrix{Float64}
end

FieldsRoom(n_points::Integer, n_times::Integer) =
    FieldsRoom(zeros(n_points, n_times), zeros(n_points, 3 + N_MODES))

"""
    fields!(flow, area, pressure, coupled, vessel, room)

Flow (mL/s), area (cm²) and pressure (dyn/cm²) of one case, each (z, time): sums of products
of functions of z and of time.
"""
function fields!(flow, area, pressure, coupled::Coupled, vessel::VesselModes, room::FieldsRoom)
    # Modes of reversed flow, the last, are zero where there is none.
    n_used, mean = 3 + N_MODES - (coupled.reverses ? 0 : N_SQUARES), coupled.mean_pressure
    function write!(field, in_z, in_time, rows)
        @views mul!(room.field, in_z[:, 1:length(rows)], in_time[rows, :])
        copy_past_cache!(field, room.field)
    end
    at_mean!(room.in_z, vessel.flow, vessel.flow_slope, mean)
    write!(flow, room.in_z, coupled.flow, 1:n_used)
    at_mean!(room.in_z, vessel.area, vessel.area_slope, mean)
    write!(area, room.in_z, coupled.area, 1:n_used)
    write!(pressure, vessel.pressure, coupled.area, 2:n_used)
    return nothing
end

"""
    at_mean!(at, functions, slope, mean)

Fill `at` with a vessel's functions of z, (z, function), at this mean of P: those after the
first three belong to the modes, whose `slope` (z, mode) it multiplies.
"""
function at_mean!(at, functions, slope, mean)
    n_other = size(functions, 2) - size(slope, 2)
    @inbounds for column in axes(functions, 2), i in axes(functions, 1)
        moved = column > n_other ? mean * slope[i, column - n_other] : 0.0
        at[i, column] = functions[i, column] + moved
    end
    return at
end
