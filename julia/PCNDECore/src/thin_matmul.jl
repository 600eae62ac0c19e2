# Matrix products with a short inner dimension.

"""
Number of columns of the result that are computed at the same time.
"""
const BLOCK_COLUMNS = 4

"""
    thin_matmul!(c, a, b)

`c = a * b` for a matrix `a` with few columns, for which BLAS is slower.
"""
function thin_matmul!(
    c::StridedMatrix{Float64}, a::StridedMatrix{Float64}, b::AbstractMatrix{Float64},
)
    check_contiguous(c, a)
    n, n_columns = size(c)
    size(a) == (n, size(b, 1)) && size(b, 2) == n_columns ||
        throw(DimensionMismatch("$(size(c)) is not that of $(size(a)) times $(size(b))"))
    n < SIMD_WIDTH && return mul!(c, a, b)
    blocked = n_columns - n_columns % BLOCK_COLUMNS
    GC.@preserve a c begin
        to, from = pointer(c), pointer(a)
        for column in 1:BLOCK_COLUMNS:blocked
            column_block!(to, from, n, b, column, Val(BLOCK_COLUMNS))
        end
        for column in (blocked + 1):n_columns
            column_block!(to, from, n, b, column, Val(1))
        end
    end
    return c
end

# The last tile of rows may overlap the one before.
function column_block!(to, from, n, b, column, width)
    for row in 1:SIMD_WIDTH:(n - SIMD_WIDTH)
        tile!(to, from, row, n, b, column, width)
    end
    tile!(to, from, n - SIMD_WIDTH + 1, n, b, column, width)
    return nothing
end

@inline function tile!(to, from, row, n, b, column, width)
    sums = tile_sums(from, row, n, b, column, width)
    ntuple(w -> vstore(sums[w], to + 8 * (row - 1 + (column + w - 2) * n)), width)
    return nothing
end

@inline function tile_sums(from, row, n, b, column, width)
    sums = ntuple(_ -> zero(SIMDVector), width)
    for k in axes(b, 1)
        values = vload(SIMDVector, from + 8 * (row - 1 + (k - 1) * n))
        factors = ntuple(w -> @inbounds(b[k, column + w - 1]), width)
        sums = map((factor, sum) -> muladd(values, SIMDVector(factor), sum), factors, sums)
    end
    return sums
end
