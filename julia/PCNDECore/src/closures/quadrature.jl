# Integrals along the vessel, and harmonics over the cycle.

"""
    cumulative_integral(density, z)

∫ f dz' from the first point by the trapezoidal rule, (z).
"""
cumulative_integral(density, z) =
    cumulative_sum((density[2:end] .+ density[1:(end - 1)]) ./ 2 .* diff(z))

"""
    integral_to_outlet(density, z)

∫ f dz' from each point to the last one by the trapezoidal rule, (z).
"""
function integral_to_outlet(density, z)
    integral = cumulative_integral(density, z)
    return integral[end] .- integral
end

"""
    cumulative_sum(pieces)

Sum of the pieces (z − 1) before each point, (z).
"""
cumulative_sum(pieces) = cumsum([zero(eltype(pieces)); pieces])

"""
    frequencies(n_times, period)

Angular frequencies ω of the harmonics of a real signal, rad/s.
"""
frequencies(n_times::Integer, period::Real) = collect(2π .* (0:(n_times ÷ 2)) ./ period)

"""
    Harmonics(n_times, period)

Discrete Fourier transform of real signals as two matrices. For short signals, the matrix
product is as fast as a fast Fourier transform, and it accepts dual numbers. A signal is the
sum of an even part (cosines) and an odd part (sines), so half of the cycle is sufficient.

# Fields

  - `omega`: [`frequencies`](@ref), rad/s; 0 for the Nyquist harmonic, whose derivative is
    zero at the time points.
  - `cosine`, `sine`: values at the time points of the first half, (time, harmonic).
  - `weight`: factor of each harmonic in the signal; 2/n, but 1/n for the mean and the Nyquist
    harmonic.
  - `n_times`: number of time points in the cycle.
"""
struct Harmonics
    omega::Vector{Float64}
    cosine::Matrix{Float64}
    sine::Matrix{Float64}
    weight::Vector{Float64}
    n_times::Int
end

function Harmonics(n_times::Integer, period::Real)
    omega = frequencies(n_times, period)
    iseven(n_times) && (omega[end] = 0.0)
    orders = time_points = 0:(n_times ÷ 2)
    roots = cispi.(2 .* (0:(n_times - 1)) ./ n_times)
    table = [roots[mod(k * t, n_times) + 1] for t in time_points, k in orders]
    weight = [k == 0 || 2k == n_times ? 1.0 : 2.0 for k in orders] ./ n_times
    return Harmonics(omega, real.(table), imag.(table), weight, n_times)
end

"""
    Spectra(T, harmonics, n_signals)

Buffers for real signals and their harmonics.

# Fields

  - `signals`: (time, signal).
  - `real`, `imaginary`: parts of the harmonics, (harmonic, signal).
  - `even`, `odd`: parts of the signals in the first half of the cycle, (time, signal).
"""
struct Spectra{T, M <: AbstractMatrix{T}}
    signals::M
    real::M
    imaginary::M
    even::M
    odd::M
end

function Spectra(::Type{T}, harmonics::Harmonics, n_signals) where {T}
    n = length(harmonics.omega)
    buffer(rows) = zeros(T, rows, n_signals)
    return Spectra(buffer(harmonics.n_times), buffer(n), buffer(n), buffer(n), buffer(n))
end

"""
    select(spectra, signals)

Views of some of the signals and their harmonics.
"""
function select(spectra::Spectra, signals)
    (columns(matrix) = view(matrix, :, signals))
    return Spectra(
        columns(spectra.signals), columns(spectra.real), columns(spectra.imaginary),
        columns(spectra.even), columns(spectra.odd),
    )
end

"""
    analyze!(spectra, harmonics)

Compute `real` and `imaginary` from the signals: a + ib stands for a·cos − b·sin.
"""
function analyze!(spectra::Spectra, harmonics::Harmonics)
    (; signals, even, odd) = spectra
    (; cosine, sine, weight, n_times) = harmonics
    @inbounds for signal in axes(signals, 2)
        even[1, signal], odd[1, signal] = signals[1, signal], 0
        for t in 2:size(even, 1)
            after, before = signals[t, signal], signals[n_times + 2 - t, signal]
            even[t, signal], odd[t, signal] = after + before, before - after
        end
        # The time point in the middle of the cycle is its own mirror image.
        iseven(n_times) && (even[end, signal] /= 2)
    end
    multiply!(spectra.real, cosine', even)
    multiply!(spectra.imaginary, sine', odd)
    spectra.real .*= weight
    spectra.imaginary .*= weight
    return nothing
end

"""
    synthesize!(spectra, harmonics)

Compute the signals from `real` and `imaginary`.
"""
function synthesize!(spectra::Spectra, harmonics::Harmonics)
    (; signals, even, odd) = spectra
    (; cosine, sine, n_times) = harmonics
    multiply!(even, cosine, spectra.real)
    multiply!(odd, sine, spectra.imaginary)
    @inbounds for signal in axes(signals, 2)
        signals[1, signal] = even[1, signal]
        @simd for t in 2:size(even, 1)
            signals[t, signal] = even[t, signal] - odd[t, signal]
            signals[n_times + 2 - t, signal] = even[t, signal] + odd[t, signal]
        end
    end
    return nothing
end

"""
    multiply!(product, a, b)

`product = a * b` by BLAS. The values and derivatives of dual numbers are multiplied as
separate columns.
"""
multiply!(product::Matrix{Float64}, a, b::Matrix{Float64}) = mul!(product, a, b)

function multiply!(product::Matrix{T}, a, b::Matrix{T}) where {T <: Dual}
    components = permutedims(reinterpret(reshape, Float64, b), (2, 3, 1))
    result = reshape(a * reshape(components, size(b, 1), :), size(product)..., :)
    permutedims!(reinterpret(reshape, Float64, product), result, (3, 1, 2))
    return product
end
