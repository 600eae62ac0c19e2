# Coupled flow, area and pressure of one case, as a differential equation for Q in space:
#
#     ∂Q/∂z = −κ·(1 − g)·∂S/∂t,    Q(z₀, t) = Q_in(t),
#     S     = π·(r_u + u_r[p])²,                           (wall)
#     p     = p_d + 𝒵 Q(L) + losses[Q],                    (outlet, losses)
#
# periodic in time. With κ = 1 and g = 0 it is the continuity equation. The learned g is a
# function of the response of the passive linear tube, which follows from the inflow alone:
# with g = 0, the learned κ, no losses and no square in S, the equation is linear in Q.
#
# The wall is linear in p, and the losses are a sum of few products of functions of z and t.
# The integrals over z are therefore computed once for each vessel, exactly on its grid. Only
# the outlet flow y = Q(L) is unknown, or equivalently the stored flow d = Q_in − y:
#
#     e·d = κ·∂V/∂t,    e(t) = 1/(1 − g),
#
# with the vessel's volume V(t), a function of P = 𝒵y + p_d − p₀ and of the losses. Each
# coupling pass is a fixed-point iteration that solves the linear part with constant
# coefficients, harmonic by harmonic, for the residual of the pass before:
#
#     (ē + κ·A(ω))·Δy = e·d − κ·∂V/∂t,
#
# where A(ω) is ∂V/∂t of a small y about the mean flow and pressure. The constant ē is the
# average of the mean and the midrange of e, which needs fewer passes than either.

"""
    OutletLaw(response, harmonics)

p(L) = p_d + 𝒵 Q(L); `response` (harmonic, 2) has 𝒵(ω) and the harmonics of p_d, each multiplied by
the number of time points. For the Nyquist harmonic, the time points show only the part in phase,
and no derivative.

# Fields

  - `impedance`, `rate`: 𝒵, dyn·s/cm⁵, and iω𝒵, (harmonic).
  - `source`: harmonics of p_d without its mean, dyn/cm².
  - `resistance`: 𝒵 if it is the same for all harmonics and p_d is constant, else NaN.
  - `distal_pressure`: mean of p_d, dyn/cm².
"""
struct OutletLaw
    impedance::Vector{ComplexF64}
    rate::Vector{ComplexF64}
    source::Vector{ComplexF64}
    resistance::Float64
    distal_pressure::Float64
end

function OutletLaw(response, harmonics::Harmonics)
    impedance, source = response[:, 1], response[:, 2] .* harmonics.weight
    if iseven(harmonics.n_times)
        impedance[end], source[end] = real(impedance[end]), real(source[end])
    end
    distal_pressure, source[1] = real(source[1]), 0
    rate = im .* harmonics.omega .* impedance
    is_resistance = allequal(impedance) && all(iszero, source)
    resistance = is_resistance ? real(impedance[1]) : NaN
    return OutletLaw(impedance, rate, source, resistance, distal_pressure)
end

"""
    outlet_laws(outlets, harmonics, n_cases)

[`OutletLaw`](@ref) of each case from the real and imaginary parts of the harmonics,
(2·harmonic, 2, case), of all cases or of one that they share.
"""
function outlet_laws(outlets, harmonics::Harmonics, n_cases)
    laws = map(eachslice(outlets; dims = 3)) do parts
        OutletLaw(@views(complex.(parts[1:2:end, :], parts[2:2:end, :])), harmonics)
    end
    return length(laws) == 1 ? fill(only(laws), n_cases) : collect(laws)
end

"""
    CoupledCase(T, harmonics)

Functions of time of one case, computed by [`couple!`](@ref); k as in [`VesselModes`](@ref).

# Fields

  - `flow`: Q_in, and −κ(1 − g)·∂_t of P = p(L) − p₀, of P² and of the modes, (3 + k, time).
  - `area`: P², 1, P and the modes; without the first also those of the pressure, (3 + k, time).
  - `largest_inflow`: maximum of |Q_in|, mL/s.
  - `mean_pressure`: mean of P that the mean inflow gives, dyn/cm².
  - `change`: bound of the change of Q(L) in the last pass, mL/s.
  - `converged`: whether no further pass is needed.
  - `has_reversed_flow`: whether flow is reversed at some time; otherwise the last eight modes
    are zero.
  - `inflow`, `share`: q and g, (time).
  - `volume`: contributions of P, P² and the modes to the vessel's volume.
  - `reference_flow`: Q₀ of the losses, mL/s.
  - `passive`: ∂q/∂t, ∂²q/∂t², and ∂P/∂t and Q(L) of the passive tube.
  - `stored`: d and ∂d/∂t.
  - `pressure`: P without its constant part, and ∂P/∂t.
  - `second_rate`: ∂²d/∂t².
  - `residual`: residual of a pass.
  - `inflow_harmonics`, `outlet_flow`: harmonics of q and Q(L).
  - `driven`, `linear`: the part of κ·∂V/∂t that does not depend on Q(L), and the factor of
    the part that is linear with constant coefficients, (harmonic).
  - `solve`: inverse of ē + κ·A(ω), (harmonic).
  - `outlet`: its [`OutletLaw`](@ref).
"""
mutable struct CoupledCase{T, S <: Spectra{T}}
    const flow::Matrix{T}
    const area::Matrix{T}
    largest_inflow::Float64
    mean_pressure::Float64
    reference_flow::Float64
    change::T
    converged::Bool
    has_reversed_flow::Bool
    const inflow::Vector{Float64}
    const share::Vector{T}
    const volume::Vector{Float64}
    const passive::S
    const stored::S
    const pressure::S
    const second_rate::S
    const residual::S
    const inflow_harmonics::Vector{Complex{T}}
    const outlet_flow::Vector{Complex{T}}
    const driven::Vector{Complex{T}}
    const linear::Vector{Complex{T}}
    const solve::Vector{Complex{T}}
    outlet::OutletLaw
end

function CoupledCase(::Type{T}, harmonics::Harmonics, spectra...) where {T}
    n_times, n = harmonics.n_times, length(harmonics.omega)
    functions() = Matrix{T}(undef, 3 + N_MODES, n_times)
    vectors = zeros(n_times), zeros(T, n_times), zeros(2 + N_MODES)
    coefficients = (Vector{Complex{T}}(undef, n) for _ in 1:5)
    return CoupledCase(
        functions(), functions(), NaN, NaN, NaN, T(NaN), false, false, vectors..., spectra...,
        coefficients..., OutletLaw(zeros(ComplexF64, n, 2), harmonics),
    )
end

"""
    CoupledBatch(T, harmonics)

Several cases, [`CoupledCase`](@ref), whose signals are stored side by side, so that one
matrix product transforms the signals of all cases.
"""
struct CoupledBatch{T, C <: CoupledCase{T}, S <: Spectra{T}}
    cases::Vector{C}
    passive::S
    stored::S
    pressure::S
    second_rate::S
    residual::S
end

function CoupledBatch(::Type{T}, harmonics::Harmonics) where {T}
    numbers = (4, 2, 2, 1, 1)
    spectra = map(n -> Spectra(T, harmonics, n * BATCH_SIZE), numbers)
    cases = map(1:BATCH_SIZE) do case
        own = map((s, n) -> select(s, ((case - 1) * n + 1):(case * n)), spectra, numbers)
        CoupledCase(T, harmonics, own...)
    end
    return CoupledBatch(cases, spectra...)
end

"""
Number of cases whose signals are transformed at the same time.
"""
const BATCH_SIZE = 8

"""
    couple!(batch, outlets, wall, correction, shifts, vessels, inflow, harmonics, settings,
        tolerance = 0.0)

Solve for the outlet flow of some cases, compute their functions of time, and return the
[`CoupledCase`](@ref) of each.

# Arguments

  - `batch`: a [`CoupledBatch`](@ref) of these harmonics.
  - `outlets`: [`OutletLaw`](@ref) of each case.
  - `wall`, `correction`: parameters.
  - `shifts`: one value for each case, see [`hidden_share!`](@ref).
  - `vessels`: [`VesselModes`](@ref) of each case.
  - `inflow`: Q_in, mL/s, (time, case), of at most `BATCH_SIZE` cases.
  - `harmonics`: [`Harmonics`](@ref) of these time points.
  - `settings`: a [`CorrectionClosure`](@ref).
  - `tolerance`: relative to the largest inflow. The passes of a case end when the next one,
    extrapolated from the last two, would change Q(L) by less. With 0, which derivatives
    need, all passes are run.
"""
function couple!(
    batch::CoupledBatch{T}, outlets, wall, correction::Vector{T}, shifts, vessels,
    inflow, harmonics::Harmonics, settings::CorrectionClosure, tolerance::Float64 = 0.0,
) where {T}
    kappa = storage_factor(correction)
    cases = view(batch.cases, axes(inflow, 2))
    for (i, case) in pairs(cases)
        case.outlet = outlets[i]
        @views initialize_case!(case, vessels[i], inflow[:, i], wall[end])
    end
    analyze!(batch.residual, harmonics)
    foreach(case -> linearize!(case, kappa, harmonics), cases)
    synthesize!(batch.passive, harmonics)
    for (i, case) in pairs(cases)
        (; share, solve, passive) = case
        @views u, y = passive.signals[:, 3], passive.signals[:, 4]
        hidden_share!(share, correction, u, y, shifts[i], settings.hidden)
        factor(g) = 1 / (1 - g)
        middle = (maximum(factor, share) + minimum(factor, share)) / 2
        solve .= inverse.((sum(factor, share) / length(share) + middle) / 2 .+ solve)
    end
    update_signals!(batch, cases, harmonics)
    for _ in 1:settings.passes
        all(case -> case.converged, cases) && break
        for case in cases
            case.converged || set_residual!(case, kappa, wall[end])
        end
        analyze!(batch.residual, harmonics)
        for case in cases
            case.converged || correct_outlet_flow!(case, tolerance)
        end
        update_signals!(batch, cases, harmonics)
    end
    set_time_functions!(batch, cases, harmonics, kappa, wall[end])
    return cases
end

"""
    initialize_case!(coupled, vessel, inflow, zero_pressure)

Set the inflow and the parts of pressure and volume that follow from its mean.
"""
function initialize_case!(
    coupled::CoupledCase{T}, vessel, inflow, zero_pressure,
) where {T}
    (; residual, volume, outlet) = coupled
    copyto!(coupled.inflow, inflow)
    residual.signals .= coupled.inflow
    offset = outlet.distal_pressure - zero_pressure
    coupled.mean_pressure = real(outlet.impedance[1]) * mean_flow(coupled) + offset
    coupled.largest_inflow = maximum(abs, inflow)
    coupled.reference_flow = vessel.reference_flow
    coupled.converged, coupled.change = false, zero(T)
    @views at_outlet = (vessel.flow[end:end, 2:end], vessel.flow_slope[end:end, :])
    modes_at_mean!(transpose(volume), at_outlet..., coupled.mean_pressure)
    return nothing
end

mean_flow(coupled::CoupledCase) = sum(coupled.inflow) / length(coupled.inflow)

"""
    linearize!(coupled, kappa, harmonics)

Compute the harmonics that follow from the inflow alone, including those of the passive tube,
and set `solve` to κ·A(ω).
"""
function linearize!(coupled::CoupledCase, kappa, harmonics)
    (; residual, inflow_harmonics, outlet_flow, driven, linear, solve, volume, outlet) = coupled
    of_inflow, of_stored = volume[3], volume[4]
    of_directed = directed_volume(coupled)
    @inbounds for k in eachindex(solve)
        i_omega, rate = im * harmonics.omega[k], outlet.rate[k]
        source_rate = i_omega * outlet.source[k]
        q = complex(residual.real[k], residual.imaginary[k])
        y = (q - kappa * volume[1] * source_rate) * inverse(1 + kappa * volume[1] * rate)
        passive_rate = rate * y + source_rate
        set_harmonic!(coupled.passive, k, (i_omega * q, i_omega^2 * q, passive_rate, y))
        inflow_harmonics[k], outlet_flow[k] = q, y
        driven[k] =
            kappa * (i_omega^2 * (of_inflow + of_stored) * q + volume[1] * source_rate)
        linear[k] = kappa * (rate * volume[1] - i_omega^2 * of_stored)
        about_mean = rate * 2 * coupled.mean_pressure * volume[2] - i_omega * of_directed
        solve[k] = linear[k] + kappa * about_mean
    end
    return nothing
end

"""
    directed_volume(coupled)

Derivative of the volume with respect to d, about the mean flow, by the modes that depend on the
direction of the flow: d, f'(q)·d and q·d.
"""
function directed_volume(coupled::CoupledCase)
    (; volume, reference_flow) = coupled
    mean = mean_flow(coupled)
    direction, before = mean >= 0 ? (1, 4) : (-1, 4 + N_DIRECTED)
    size = abs(mean) / reference_flow
    total =
        volume[before + 2] +
        rational_slope(size) * volume[before + 4] +
        size * volume[before + 6]
    return direction * total / reference_flow
end

"""
    inverse(number)

1 / number for a complex number of moderate size, without protection against overflow.
"""
inverse(number) = conj(number) / abs2(number)

"""
    set_harmonic!(spectra, harmonic, values)

Set one harmonic of each signal to a complex number.
"""
@inline function set_harmonic!(spectra::Spectra, harmonic, values::NTuple{N, Any}) where {N}
    ntuple(Val(N)) do signal
        @inbounds spectra.real[harmonic, signal] = real(values[signal])
        @inbounds spectra.imaginary[harmonic, signal] = imag(values[signal])
        nothing
    end
    return nothing
end

"""
    update_signals!(batch, cases, harmonics)

Compute the stored flow and the pressure in time from the harmonics of inflow and outlet flow.
"""
function update_signals!(batch::CoupledBatch, cases, harmonics::Harmonics)
    for case in cases
        (; inflow_harmonics, outlet_flow, stored) = case
        @inbounds for k in eachindex(outlet_flow)
            d = inflow_harmonics[k] - outlet_flow[k]
            set_harmonic!(stored, k, (d, im * harmonics.omega[k] * d))
        end
    end
    synthesize!(batch.stored, harmonics)
    if any(case -> isnan(case.outlet.resistance), cases)
        for case in cases
            (; outlet_flow, pressure) = case
            (; impedance, rate, source) = case.outlet
            @inbounds for k in eachindex(outlet_flow)
                y, s = outlet_flow[k], source[k]
                s_rate = im * harmonics.omega[k] * s
                set_harmonic!(pressure, k, (impedance[k] * y + s, rate[k] * y + s_rate))
            end
        end
        synthesize!(batch.pressure, harmonics)
    end
    for case in cases
        (; resistance) = case.outlet
        isnan(resistance) && continue
        q, q_rates, d, p =
            case.inflow, case.passive.signals, case.stored.signals, case.pressure.signals
        @inbounds @simd for t in eachindex(q)
            p[t, 1] = resistance * (q[t] - d[t, 1])
            p[t, 2] = resistance * (q_rates[t, 1] - d[t, 2])
        end
    end
    return nothing
end

"""
    set_residual!(coupled, kappa, zero_pressure)

Set `residual` to e·d − κ·∂V/∂t without the linear part with constant coefficients.
"""
function set_residual!(coupled::CoupledCase, kappa, zero_pressure)
    (; inflow, share, volume, reference_flow) = coupled
    offset = coupled.outlet.distal_pressure - zero_pressure
    q_rates, d, p, residual = (
        s.signals for
        s in (coupled.passive, coupled.stored, coupled.pressure, coupled.residual)
    )
    of_square = volume[2]
    of_forward = ntuple(mode -> volume[4 + mode], Val(N_DIRECTED))
    of_back = ntuple(mode -> volume[4 + N_DIRECTED + mode], Val(N_DIRECTED))
    @inbounds @simd for t in eachindex(inflow)
        flows, stored = (inflow[t], q_rates[t, 1], q_rates[t, 2]), (d[t, 1], d[t, 2])
        forward = is_forward(flows[1], stored[1])
        rates = directed_rates(flows, stored, reference_flow)
        directed =
            sum(map((a, b, rate) -> ifelse(forward, a, b) * rate, of_forward, of_back, rates))
        filling = of_square * (2 * (p[t, 1] + offset) * p[t, 2]) + directed
        residual[t] = stored[1] / (1 - share[t]) - kappa * filling
    end
    return nothing
end

"""
    correct_outlet_flow!(coupled, tolerance)

Solve for the correction of the outlet flow and add it. The sum of the correction's amplitudes
bounds its value at every time.
"""
function correct_outlet_flow!(coupled::CoupledCase{T}, tolerance) where {T}
    (; residual, outlet_flow, driven, linear, solve) = coupled
    amplitudes = zero(T)
    @inbounds for k in eachindex(outlet_flow)
        products = complex(residual.real[k], residual.imaginary[k])
        step = solve[k] * (products - driven[k] - linear[k] * outlet_flow[k])
        outlet_flow[k] += step
        amplitudes += sqrt(abs2(step))
    end
    limit = tolerance * coupled.largest_inflow
    # The first pass has no predecessor to extrapolate from.
    coupled.converged = amplitudes^2 <= limit * max(amplitudes, coupled.change)
    coupled.change = amplitudes
    return nothing
end

"""
    set_time_functions!(batch, cases, harmonics, kappa, zero_pressure)

Compute `flow`, `area` and `has_reversed_flow` from inflow and outlet flow.
"""
function set_time_functions!(
    batch::CoupledBatch, cases, harmonics::Harmonics, kappa, zero_pressure,
)
    for case in cases
        (; inflow_harmonics, outlet_flow, second_rate) = case
        @inbounds for k in eachindex(outlet_flow)
            d = inflow_harmonics[k] - outlet_flow[k]
            set_harmonic!(second_rate, k, (-harmonics.omega[k]^2 * d,))
        end
    end
    synthesize!(batch.second_rate, harmonics)
    foreach(case -> set_time_functions!(case, kappa, zero_pressure), cases)
    return nothing
end

function set_time_functions!(coupled::CoupledCase, kappa, zero_pressure)
    (; flow, area, inflow, share, reference_flow) = coupled
    offset = coupled.outlet.distal_pressure - zero_pressure
    q_rates, d, p, d2 = (
        s.signals for
        s in (coupled.passive, coupled.stored, coupled.pressure, coupled.second_rate)
    )
    coupled.has_reversed_flow = false
    @inbounds for t in eachindex(inflow)
        flows = inflow[t], q_rates[t, 1], q_rates[t, 2]
        stored = d[t, 1], d[t, 2], d2[t, 1]
        pressure, rate = p[t, 1] + offset, p[t, 2]
        modes, rates = temporal_modes(flows, stored, reference_flow)
        storage = -kappa * (1 - share[t])
        fill_column!(flow, t, (flows[1], (storage .* (rate, 2 * pressure * rate, rates...))...))
        fill_column!(area, t, (pressure^2, one(pressure), pressure, modes...))
        is_forward(flows[1], stored[1]) || (coupled.has_reversed_flow = true)
    end
    return nothing
end

@inline function fill_column!(matrix, column, values::NTuple{N, Any}) where {N}
    ntuple(row -> @inbounds(matrix[row, column] = values[row]), Val(N))
    return nothing
end
