# Non-temporal stores for results that are larger than the processor's cache.

"""
Number of Float64 values in a cache line of 64 bytes.
"""
const SIMD_WIDTH = 8

const SIMDVector = Vec{SIMD_WIDTH, Float64}

is_contiguous(a) =
    stride(a, 1) == 1 &&
    all(k -> stride(a, k + 1) == stride(a, k) * size(a, k), 1:(ndims(a) - 1))

check_contiguous(arrays...) =
    all(is_contiguous, arrays) ||
    throw(ArgumentError("an array's memory is not contiguous: pass a copy"))

"""
    streaming_copy!(target, source)

`copyto!(target, source)` with non-temporal stores, which bypass the processor's cache: the
target is not read before it is written, and the cached data stays in the cache.
"""
function streaming_copy!(target::StridedArray{Float64}, source::StridedArray{Float64})
    n = length(source)
    check_contiguous(target, source)
    length(target) == n || throw(DimensionMismatch("$(length(target)) of $n numbers"))
    GC.@preserve target source begin
        to, from = pointer(target), pointer(source)
        # Copy single values up to the first aligned line, and after the last complete one.
        first = min(n, Int((-UInt(to) % 64) ÷ 8))
        last = first + (n - first) ÷ SIMD_WIDTH * SIMD_WIDTH
        for i in Iterators.flatten((1:first, (last + 1):n))
            unsafe_store!(to, unsafe_load(from, i), i)
        end
        for i in first:SIMD_WIDTH:(last - 1)
            vstorent(vload(SIMDVector, from + 8i), to + 8i)
        end
    end
    return target
end
