# Periodic area by Fourier series: S_n = −a(z)/(iω_n) ∂Q_n/∂z.

"""
    fourier_area_problem(flow, initial_area, target, period, z, stage)

S = Ŝ(t=0) − a·(I(t) − I(0)) + b as a [`LinearArea`](@ref) in `[a; b]`. I is the integral
over time of ∂Q/∂z without its mean, from the first `stage.terms` terms of the Fourier
series.

# Arguments

  - `flow`: Q, mL/s, (z, time, case).
  - `initial_area`: Ŝ(z, t=0), cm², (z, case).
  - `target`: cm², (z, time, case).
  - `period`: s.
  - `z`: points, cm.
"""
function fourier_area_problem(flow, initial_area, target, period, z, stage::FourierAreaStage)
    n_times = size(flow, 2)
    analysis, synthesis = fourier_integral(n_times, stage)
    change = similar(flow)
    for case in axes(flow, 3)
        coefficients = derivative_along_z(flow[:, :, case] * analysis, z)
        mul!(view(change,:,:,case), coefficients, synthesis, -period, 0.0)
    end
    # The anchor is the value at the first time point.
    change .-= change[:, 1:1, :]
    return LinearArea(initial_area, change, ones(n_times), target)
end

"""
    fourier_integral(n_times, stage)

Matrices that integrate a periodic signal in time by its Fourier series: `analysis`
(time × 2(terms − 1)) maps to the cosine and sine parts of the harmonics, and `synthesis`
(2(terms − 1) × time) maps these to the integral of the signal without its mean, divided by
the period.
"""
function fourier_integral(n_times, stage::FourierAreaStage)
    harmonics = 1:(stage.terms - 1)
    angle = [2π * k * t / n_times for t in 0:(n_times - 1), k in harmonics]
    analysis = [cos.(angle) sin.(angle)] ./ n_times
    divisor = 2π .* (harmonics .+ (stage.frequency == "next" ? 1 : 0))'
    sides = stage.sides == "two" ? 2 : 1
    # Q_n = c − i·s, so the real part of Q_n·exp(iωt)/(iω) is (c·sin ωt − s·cos ωt)/ω.
    synthesis = sides .* [sin.(angle) ./ divisor -cos.(angle) ./ divisor]
    return analysis, permutedims(synthesis)
end
