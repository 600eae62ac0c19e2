# Results that are larger than the processor's cache.

"""
Numbers in a line of the cache.
"""
const LINE = 8

const Line = Vec{LINE, Float64}

"""
Arrays whose numbers lie one after the other.
"""
const Contiguous = Union{DenseArray{Float64}, Base.FastContiguousSubArray{Float64}}

"""
    copy_past_cache!(target, source)

`copyto!(target, source)`, not through the processor's cache: memory that is not read before
it is written, and does not drive out what is needed next.
"""
function copy_past_cache!(target::Contiguous, source::Contiguous)
    n = length(source)
    length(target) == n || throw(DimensionMismatch("$(length(target)) of $n numbers"))
    GC.@preserve target source begin
        to, from = pointer(target), pointer(source)
        # One by one up to the first whole line, and after the last.
        first = min(n, Int((-UInt(to) % 64) ÷ 8))
        last = first + (n - first) ÷ LINE * LINE
        for i in Iterators.flatten((1:first, (last + 1):n))
            unsafe_store!(to, unsafe_load(from, i), i)
        end
        for i in first:LINE:(last - 1)
            vstorent(vload(Line, from + 8i), to + 8i)
        end
    end
    return target
end
