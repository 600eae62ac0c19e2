# Flow, area and pressure of one case, coupled: a spatial differential equation for Q.
#
#     ∂Q/∂z = −κ·(1 − g)·∂S/∂t,    Q(z₀, t) = Q_in(t),
#     S     = π·(r_u + u_r[p])²,                           (wall)
#     p     = p_d + 𝒵 Q(L) + losses[Q],                    (outlet, losses)
#
# periodic in time. With κ = 1 and g = 0 it is continuity. The learned g is a function of the
# response of the passive linear tube, which follows from the inflow alone: the equation with
# g = 0 and the learned κ, without the losses and the square in S, is linear in Q.
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
#     (ē + κ·A(ω))·Δy = e·d − κ·∂V/∂t,
#
# where A(ω) is ∂V/∂t of a small y about the mean flow and pressure, and ē lies between the
# mean of e and the middle of its range, with which fewer passes are needed than with either.

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
    OutletLaw(parameters, n_times, period)

p(L) = p_d + 𝒵 Q(L) with 𝒵(ω) = R₁ + R₂/(1 + iωR₂C); `parameters` are R₁, R₂, C, p_d. Of
Nyquist's harmonic the instants show the part in phase only, and no slope.

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

function OutletLaw(parameters, n_times, period)
    r1, r2, compliance, distal_pressure = parameters
    omega = frequencies(n_times, period)
    impedance = r1 .+ r2 ./ (1 .+ im .* omega .* r2 .* compliance)
    rate = im .* omega .* impedance
    iseven(n_times) && ((impedance[end], rate[end]) = (real(impedance[end]), 0))
    resistance = r2 * compliance == 0 ? r1 + r2 : NaN
    return OutletLaw(impedance, rate, resistance, distal_pressure)
end

"""
    Coupled(T, harmonics)

The functions of time of one case, which [`couple!`](@ref) finds; k as in
[`VesselModes`](@ref).

  - `flow`: of the flow: Q_in, and −κ(1 − g)·∂_t of P = p(L) − p₀, of P² and of the modes,
    (3 + k, time).
  - `area`: of the area: P², 1, P and the modes; without the first those of the pressure,
    (3 + k, time).
  - `largest_inflow`: of all instants, mL/s; `mean_pressure`: the mean of P that the inflow
    gives.
  - `change`: no change of Q(L) in the last pass was larger, mL/s; `settled`: whether there
    need be no more.
  - `reverses`: whether some flow goes back; else the last three modes are zero.
  - `inflow`: q, and `share`: g, (time); `total`: of the volume, what belongs to P, to P² and
    to the modes.
  - `passive`: ∂q/∂t, and ∂P/∂t and Q(L) of the passive tube; `stored`: d and ∂d/∂t;
    `pressure`: P without its constant part, and ∂P/∂t; `second_rates`: of q and d; `left`:
    what a pass has left over.
  - `inflow_harmonics`, `outlet_flow`: of q and Q(L); `driven`, `linear`: what of κ·∂V/∂t does
    not depend on Q(L), and its factor where it is linear with constant coefficients; `solve`:
    a pass multiplies by it what is left over, (harmonic).
"""
mutable struct Coupled{T, W <: Waves{T}}
    const flow::Matrix{T}
    const area::Matrix{T}
    largest_inflow::Float64
    mean_pressure::Float64
    change::T
    settled::Bool
    reverses::Bool
    const inflow::Vector{Float64}
    const share::Vector{T}
    const total::Vector{Float64}
    const passive::W
    const stored::W
    const pressure::W
    const second_rates::W
    const left::W
    const inflow_harmonics::Vector{Complex{T}}
    const outlet_flow::Vector{Complex{T}}
    const driven::Vector{Complex{T}}
    const linear::Vector{Complex{T}}
    const solve::Vector{Complex{T}}
end

function Coupled(::Type{T}, harmonics::Harmonics, waves...) where {T}
    n_times, n = harmonics.n_times, length(harmonics.omega)
    functions() = Matrix{T}(undef, 3 + N_MODES, n_times)
    in_time = zeros(n_times), zeros(T, n_times), zeros(2 + N_MODES)
    spectra = (Vector{Complex{T}}(undef, n) for _ in 1:5)
    return Coupled(
        functions(), functions(), NaN, NaN, T(NaN), false, false, in_time..., waves...,
        spectra...,
    )
end

"""
    Together(T, harmonics)

Some cases, [`Coupled`](@ref), whose signals lie side by side: one product of matrices
transforms those of all, in a fraction of the time.
"""
struct Together{T, C <: Coupled{T}, W <: Waves{T}}
    cases::Vector{C}
    passive::W
    stored::W
    pressure::W
    second_rates::W
    left::W
end

function Together(::Type{T}, harmonics::Harmonics) where {T}
    numbers = (3, 2, 2, 2, 1)
    waves = map(n -> Waves(T, harmonics, n * CASES_TOGETHER), numbers)
    cases = map(1:CASES_TOGETHER) do case
        own = map((w, n) -> among(w, ((case - 1) * n + 1):(case * n)), waves, numbers)
        Coupled(T, harmonics, own...)
    end
    return Together(cases, waves...)
end

"""
Cases whose signals are transformed together.
"""
const CASES_TOGETHER = 8

"""
    couple!(together, outlet, wall, correction, shifts, vessels, inflow, harmonics, settings,
        tolerance = 0.0)

Find the outlet flow of some cases, and all functions of time with it; return the
[`Coupled`](@ref) of each.

# Arguments

  - `outlet`: [`OutletLaw`](@ref) of these harmonics.
  - `wall`, `correction`: parameters; `shifts`: for each case, see [`hidden_share!`](@ref).
  - `vessels`: [`VesselModes`](@ref) of each.
  - `inflow`: Q_in, mL/s, (time, case), of no more than `CASES_TOGETHER`.
  - `harmonics`: [`Harmonics`](@ref) of these instants.
  - `settings`: a [`CorrectionClosure`](@ref).
  - `tolerance`: a case's passes end once the next would change Q(L) by less, relative to the
    largest inflow, if it changed it as much less as the last one did; with 0 all passes are
    made, as derivatives need it.
"""
function couple!(
    together::Together{T}, outlet::OutletLaw, wall, correction::Vector{T}, shifts, vessels,
    inflow, harmonics::Harmonics, settings::CorrectionClosure, tolerance::Float64 = 0.0,
) where {T}
    kappa = storage_factor(correction)
    offset = outlet.distal_pressure - wall[end]
    cases = view(together.cases, axes(inflow, 2))
    for (i, case) in pairs(cases)
        @views begin_case!(case, vessels[i], outlet, inflow[:, i], offset)
    end
    analyse!(together.left, harmonics)
    foreach(case -> linearise!(case, outlet, kappa, harmonics), cases)
    synthesise!(together.passive, harmonics)
    for (i, case) in pairs(cases)
        (; share, solve, passive) = case
        @views u, y = passive.signals[:, 2], passive.signals[:, 3]
        hidden_share!(share, correction, u, y, shifts[i], settings.hidden)
        shown(g) = 1 / (1 - g)
        middle = (maximum(shown, share) + minimum(shown, share)) / 2
        solve .= inverse.((sum(shown, share) / length(share) + middle) / 2 .+ solve)
    end
    after_outlet!(together, cases, harmonics, outlet)
    for _ in 1:settings.passes
        all(case -> case.settled, cases) && break
        for case in cases
            case.settled || left_over!(case, kappa, offset)
        end
        analyse!(together.left, harmonics)
        for case in cases
            case.settled || advance!(case, tolerance)
        end
        after_outlet!(together, cases, harmonics, outlet)
    end
    functions_of_time!(together, cases, harmonics, kappa, offset)
    return cases
end

"""
    begin_case!(coupled, vessel, outlet, inflow, offset)

Take the inflow, with what of the pressure and the volume follows from its mean.
"""
function begin_case!(coupled::Coupled{T}, vessel, outlet::OutletLaw, inflow, offset) where {T}
    (; left, total) = coupled
    copyto!(coupled.inflow, inflow)
    left.signals .= coupled.inflow
    coupled.mean_pressure = real(outlet.impedance[1]) * mean_flow(coupled) + offset
    coupled.largest_inflow = maximum(abs, inflow)
    coupled.settled, coupled.change = false, zero(T)
    @views at_outlet = (vessel.flow[end:end, 2:end], vessel.flow_slope[end:end, :])
    at_mean!(transpose(total), at_outlet..., coupled.mean_pressure)
    return nothing
end

mean_flow(coupled::Coupled) = sum(coupled.inflow) / length(coupled.inflow)

"""
    linearise!(coupled, outlet, kappa, harmonics)

Fill the harmonics of what follows from the inflow alone, the passive tube's among it, and
`solve` with κ·A(ω).
"""
function linearise!(coupled::Coupled, outlet::OutletLaw, kappa, harmonics)
    (; left, inflow_harmonics, outlet_flow, driven, linear, solve, total) = coupled
    mean = mean_flow(coupled)
    # What belongs to q, d, ∂q/∂t, ∂d/∂t and q·d; d comes with −y.
    _, _, of_inflow, of_stored, of_inflow_rate, of_stored_rate = total
    of_product = mean >= 0 ? total[8] : total[11]
    @inbounds for k in eachindex(solve)
        turned, rate = im * harmonics.omega[k], outlet.rate[k]
        q = complex(left.real[k], left.imaginary[k])
        y = q * inverse(1 + kappa * total[1] * rate)
        set!(coupled.passive, k, (turned * q, rate * y, y))
        inflow_harmonics[k], outlet_flow[k] = q, y
        as_flow = turned * (of_stored + turned * of_stored_rate)
        driven[k] = kappa * (turned * (of_inflow + turned * of_inflow_rate) + as_flow) * q
        linear[k] = kappa * (rate * total[1] - as_flow)
        about_mean =
            rate * 2 * coupled.mean_pressure * total[2] - turned * of_product * mean
        solve[k] = linear[k] + kappa * about_mean
    end
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
    after_outlet!(together, cases, harmonics, outlet)

Fill the signals of what is stored and of the pressure from the harmonics of inflow and
outlet flow.
"""
function after_outlet!(together::Together, cases, harmonics::Harmonics, outlet::OutletLaw)
    for case in cases
        (; inflow_harmonics, outlet_flow, stored) = case
        @inbounds for k in eachindex(outlet_flow)
            d = inflow_harmonics[k] - outlet_flow[k]
            set!(stored, k, (d, im * harmonics.omega[k] * d))
        end
    end
    synthesise!(together.stored, harmonics)
    if isnan(outlet.resistance)
        for case in cases
            (; outlet_flow, pressure) = case
            @inbounds for k in eachindex(outlet_flow)
                y = outlet_flow[k]
                set!(pressure, k, (outlet.impedance[k] * y, outlet.rate[k] * y))
            end
        end
        synthesise!(together.pressure, harmonics)
    else
        for case in cases
            q, q1, d, p =
                case.inflow, case.passive.signals, case.stored.signals, case.pressure.signals
            @inbounds @simd for t in eachindex(q)
                p[t, 1] = outlet.resistance * (q[t] - d[t, 1])
                p[t, 2] = outlet.resistance * (q1[t, 1] - d[t, 2])
            end
        end
    end
    return nothing
end

"""
    left_over!(coupled, kappa, offset)

Fill `left` with e·d − κ·∂V/∂t, without the part of it that is linear with constant
coefficients; `offset` is the constant part of P.
"""
function left_over!(coupled::Coupled, kappa, offset)
    (; inflow, share, total) = coupled
    q1, d, p, left =
        (w.signals for w in (coupled.passive, coupled.stored, coupled.pressure, coupled.left))
    @inbounds @simd for t in eachindex(inflow)
        q0, d0 = inflow[t], d[t, 1]
        forward = goes_forward(q0, d0)
        (s1, s2, s3) = square_rates(q0, q1[t, 1], d0, d[t, 2])
        squares =
            ifelse(forward, total[7], total[10]) * s1 +
            ifelse(forward, total[8], total[11]) * s2 +
            ifelse(forward, total[9], total[12]) * s3
        filling = total[2] * (2 * (p[t, 1] + offset) * p[t, 2]) + squares
        left[t] = d0 / (1 - share[t]) - kappa * filling
    end
    return nothing
end

"""
    advance!(coupled, tolerance)

Add to the harmonics of the outlet flow what was left over, solved for. No signal changes by
more than the sum of the amplitudes.
"""
function advance!(coupled::Coupled{T}, tolerance) where {T}
    (; left, outlet_flow, driven, linear, solve) = coupled
    amplitudes = zero(T)
    @inbounds for k in eachindex(outlet_flow)
        products = complex(left.real[k], left.imaginary[k])
        step = solve[k] * (products - driven[k] - linear[k] * outlet_flow[k])
        outlet_flow[k] += step
        amplitudes += sqrt(abs2(step))
    end
    limit = tolerance * coupled.largest_inflow
    # Of the first pass nothing can be told from the one before.
    coupled.settled = amplitudes^2 <= limit * max(amplitudes, coupled.change)
    coupled.change = amplitudes
    return nothing
end

"""
    functions_of_time!(together, cases, harmonics, kappa, offset)

Fill `flow`, `area` and `reverses` from what inflow and outlet flow are.
"""
function functions_of_time!(together::Together, cases, harmonics::Harmonics, kappa, offset)
    for case in cases
        (; inflow_harmonics, outlet_flow, second_rates) = case
        @inbounds for k in eachindex(outlet_flow)
            turned_twice, q = -harmonics.omega[k]^2, inflow_harmonics[k]
            set!(second_rates, k, (turned_twice * q, turned_twice * (q - outlet_flow[k])))
        end
    end
    synthesise!(together.second_rates, harmonics)
    foreach(case -> functions_of_time!(case, kappa, offset), cases)
    return nothing
end

function functions_of_time!(coupled::Coupled, kappa, offset)
    (; flow, area, inflow, share) = coupled
    q1, d, p, second = (
        w.signals for
        w in (coupled.passive, coupled.stored, coupled.pressure, coupled.second_rates)
    )
    coupled.reverses = false
    @inbounds for t in eachindex(inflow)
        flows = inflow[t], q1[t, 1], second[t, 1]
        stored = d[t, 1], d[t, 2], second[t, 2]
        moved, rate = p[t, 1] + offset, p[t, 2]
        modes, rates = modes_in_time(flows, stored)
        storage = -kappa * (1 - share[t])
        fill_column!(flow, t, (flows[1], (storage .* (rate, 2 * moved * rate, rates...))...))
        fill_column!(area, t, (moved^2, one(moved), moved, modes...))
        goes_forward(flows[1], stored[1]) || (coupled.reverses = true)
    end
    return nothing
end

@inline function fill_column!(matrix, column, values::NTuple{N, Any}) where {N}
    ntuple(row -> @inbounds(matrix[row, column] = values[row]), Val(N))
    return nothing
end

"""
    FieldsRoom(n_points, n_times)

Room for some instants of a field, (z, time), and for the functions of z that make it up,
(z, 3 + k).
"""
struct FieldsRoom
    field::Matrix{Float64}
    in_z::Matrix{Float64}
end

function FieldsRoom(n_points::Integer, n_times::Integer)
    together = clamp(NUMBERS_TOGETHER ÷ n_points, 1, n_times)
    return FieldsRoom(zeros(n_points, together), zeros(n_points, 3 + N_MODES))
end

"""
About so many numbers of a field are computed before they are written: they fit the
processor's nearest cache.
"""
const NUMBERS_TOGETHER = 2048

"""
    fields!(flow, area, pressure, coupled, vessel, room)

Flow (mL/s), area (cm²) and pressure (dyn/cm²) of one case, each (z, time): sums of products
of functions of z and of time.
"""
function fields!(flow, area, pressure, coupled::Coupled, vessel::VesselModes, room::FieldsRoom)
    # Modes of reversed flow, the last, are zero where there is none.
    n_used, mean = 3 + N_MODES - (coupled.reverses ? 0 : N_SQUARES), coupled.mean_pressure
    function write!(field, in_z, in_time, rows)
        n_times = size(field, 2)
        for instants in Iterators.partition(1:n_times, size(room.field, 2))
            @views part = room.field[:, 1:length(instants)]
            @views short_sums!(part, in_z[:, 1:length(rows)], in_time[rows, instants])
            @views copy_past_cache!(field[:, instants], part)
        end
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

Fill `at` with a vessel's functions of z, (z, function), at this mean of P: the last ones
belong to the modes, whose `slope` (z, mode) it multiplies.
"""
function at_mean!(at, functions, slope, mean)
    n_other = size(functions, 2) - size(slope, 2)
    @inbounds for column in axes(functions, 2), i in axes(functions, 1)
        moved = column > n_other ? mean * slope[i, column - n_other] : 0.0
        at[i, column] = functions[i, column] + moved
    end
    return at
end
