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

ω of the harmonics of a real signal, rad/s.
"""
frequencies(n_times::Integer, period::Real) = collect(2π .* (0:(n_times ÷ 2)) ./ period)

"""
    Harmonics(n_times, period)

The discrete Fourier transform of real signals as two matrices, which few instants make as
fast as a fast one, and which take the derivative's numbers as they are. A signal is the sum
of an even part, of the cosines, and an odd one, of the sines: half of the cycle is enough.

  - `omega`: [`frequencies`](@ref), rad/s, but 0 of Nyquist's, which has no slope at the instants.
  - `cosine`, `sine`: at the instants of the first half, (time, harmonic).
  - `share`: of each harmonic in the signal; all but the mean and Nyquist's stand for two.
  - `n_times`: instants of the cycle.
"""
struct Harmonics
    omega::Vector{Float64}
    cosine::Matrix{Float64}
    sine::Matrix{Float64}
    share::Vector{Float64}
    n_times::Int
end

function Harmonics(n_times::Integer, period::Real)
    omega = frequencies(n_times, period)
    iseven(n_times) && (omega[end] = 0.0)
    orders = instants = 0:(n_times ÷ 2)
    turn = cispi.(2 .* (0:(n_times - 1)) ./ n_times)
    waves = [turn[mod(k * t, n_times) + 1] for t in instants, k in orders]
    share = [k == 0 || 2k == n_times ? 1.0 : 2.0 for k in orders] ./ n_times
    return Harmonics(omega, real.(waves), imag.(waves), share, n_times)
end

"""
    Waves(T, harmonics, n_signals)

Room for some real signals and their harmonics.

  - `signals`: (time, signal).
  - `real`, `imaginary`: parts of their harmonics, (harmonic, signal).
  - `even`, `odd`: parts of the signals in the first half of the cycle, (time, signal).
"""
struct Waves{T, M <: AbstractMatrix{T}}
    signals::M
    real::M
    imaginary::M
    even::M
    odd::M
end

function Waves(::Type{T}, harmonics::Harmonics, n_signals) where {T}
    n = length(harmonics.omega)
    room(rows) = zeros(T, rows, n_signals)
    return Waves(room(harmonics.n_times), room(n), room(n), room(n), room(n))
end

"""
    among(waves, signals)

Some of the signals, in the same memory.
"""
function among(waves::Waves, signals)
    (part(matrix) = view(matrix, :, signals))
    return Waves(
        part(waves.signals), part(waves.real), part(waves.imaginary), part(waves.even),
        part(waves.odd),
    )
end

"""
    analyse!(waves, harmonics)

Fill `real` and `imaginary` with the harmonics of the signals: a + ib for a·cos − b·sin.
"""
function analyse!(waves::Waves, harmonics::Harmonics)
    (; signals, even, odd) = waves
    (; cosine, sine, share, n_times) = harmonics
    @inbounds for signal in axes(signals, 2)
        even[1, signal], odd[1, signal] = signals[1, signal], 0
        for t in 2:size(even, 1)
            after, before = signals[t, signal], signals[n_times + 2 - t, signal]
            even[t, signal], odd[t, signal] = after + before, before - after
        end
        # The instant in the middle of the cycle is its own mirror image.
        iseven(n_times) && (even[end, signal] /= 2)
    end
    times!(waves.real, cosine', even)
    times!(waves.imaginary, sine', odd)
    waves.real .*= share
    waves.imaginary .*= share
    return nothing
end

"""
    synthesise!(waves, harmonics)

Fill the signals from `real` and `imaginary`.
"""
function synthesise!(waves::Waves, harmonics::Harmonics)
    (; signals, even, odd) = waves
    (; cosine, sine, n_times) = harmonics
    times!(even, cosine, waves.real)
    times!(odd, sine, waves.imaginary)
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
    rate(harmonics, signals)

∂f/∂t of periodic signals (signal, time), exact for their Fourier series.
"""
function rate(harmonics::Harmonics, signals::AbstractMatrix{Float64})
    waves = Waves(Float64, harmonics, size(signals, 1))
    permutedims!(waves.signals, signals, (2, 1))
    analyse!(waves, harmonics)
    (; real, imaginary) = waves
    # iω·(a + ib) = −ωb + iωa.
    real[:, :], imaginary[:, :] = .-harmonics.omega .* imaginary, harmonics.omega .* real
    synthesise!(waves, harmonics)
    return permutedims(waves.signals)
end

"""
    times!(product, a, b)

`product = a * b` by BLAS, for numbers with derivatives too: each of their parts makes
columns of its own.
"""
times!(product::Matrix{Float64}, a, b::Matrix{Float64}) = mul!(product, a, b)

function times!(product::Matrix{T}, a, b::Matrix{T}) where {T <: Dual}
    parts = permutedims(reinterpret(reshape, Float64, b), (2, 3, 1))
    found = reshape(a * reshape(parts, size(b, 1), :), size(product)..., :)
    permutedims!(reinterpret(reshape, Float64, product), found, (3, 1, 2))
    return product
end
