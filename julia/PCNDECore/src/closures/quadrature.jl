# Integrals along the vessel, and harmonics and derivatives over the cycle.

"""
    from_inlet(density, z)

∫ f dz' from the first point, by the trapezoidal rule, (z).
"""
from_inlet(density, z) =
    summed_from_inlet((density[2:end] .+ density[1:(end - 1)]) ./ 2 .* diff(z))

"""
    to_outlet(density, z)

∫ f dz' up to the last point, by the trapezoidal rule, (z).
"""
function to_outlet(density, z)
    integral = from_inlet(density, z)
    return integral[end] .- integral
end

"""
    summed_from_inlet(pieces)

The sum of the pieces (z − 1) that lie before each point, (z).
"""
summed_from_inlet(pieces) = cumsum([zero(eltype(pieces)); pieces])

"""
    frequencies(n_times, period)

ω of the harmonics of a real signal, rad/s; that of Nyquist, which has no slope, is 0.
"""
function frequencies(n_times::Integer, period::Real)
    omega = 2π .* (0:(n_times ÷ 2)) ./ period
    iseven(n_times) && (omega = [omega[1:(end - 1)]; 0.0])
    return collect(omega)
end

"""
    Harmonics(n_times, period)

The discrete Fourier transform of real signals as two matrices, which few instants make as
fast as a fast one, and which take the derivative's numbers as they are.

  - `omega`: [`frequencies`](@ref), rad/s.
  - `analysis`: (time, 2·harmonic), to the real and then the imaginary parts.
  - `synthesis`: (2·harmonic, time), back.
"""
struct Harmonics
    omega::Vector{Float64}
    analysis::Matrix{Float64}
    synthesis::Matrix{Float64}
end

function Harmonics(n_times::Integer, period::Real)
    omega = frequencies(n_times, period)
    orders, instants = 0:(length(omega) - 1), 0:(n_times - 1)
    turn = cispi.(2 .* instants ./ n_times)
    waves = [turn[mod(k * t, n_times) + 1] for k in orders, t in instants]
    cosine, sine = real.(waves), imag.(waves)
    # All harmonics but the mean and Nyquist's stand for two of a real signal.
    weight = [k == 0 || 2k == n_times ? 1.0 : 2.0 for k in orders] ./ n_times
    return Harmonics(omega, [cosine' -sine'], [weight .* cosine; -weight .* sine])
end

"""
    spectrum(harmonics, signal)

Complex harmonics of a real signal (time), as of `rfft`.
"""
function spectrum(harmonics::Harmonics, signal::Vector)
    parts = times(reshape(signal, 1, :), harmonics.analysis)
    n = length(harmonics.omega)
    return [complex(parts[k], parts[n + k]) for k in 1:n]
end

"""
    signals(harmonics, spectra)

The real signals of some spectra, (signal, time), as of `irfft`.
"""
function signals(harmonics::Harmonics, spectra::Vector{Vector{Complex{T}}}) where {T}
    n = length(harmonics.omega)
    parts = Matrix{T}(undef, length(spectra), 2n)
    for (row, spectrum) in enumerate(spectra), k in 1:n
        parts[row, k], parts[row, n + k] = reim(spectrum[k])
    end
    return times(parts, harmonics.synthesis)
end

"""
    rate(harmonics, signals)

∂f/∂t of periodic signals (signal, time), exact for their Fourier series.
"""
function rate(harmonics::Harmonics, signals::AbstractMatrix{Float64})
    (; omega, analysis, synthesis) = harmonics
    n = length(omega)
    cosine, sine = synthesis[1:n, :], synthesis[(n + 1):end, :]
    # iω·(a + ib) = −ωb + iωa.
    derivative = analysis * [omega .* sine; -omega .* cosine]
    return signals * derivative
end

"""
    times(a, b)

`a * b` by BLAS, for numbers with derivatives too: each of their parts is a row of its own.
"""
times(a::Matrix{Float64}, b::Matrix{Float64}) = a * b

function times(a::Matrix{<:Dual}, b::Matrix{Float64})
    product = similar(a, size(a, 1), size(b, 2))
    mul!(reinterpret(Float64, product), reinterpret(Float64, a), b)
    return product
end
