# Products of matrices whose sums are short: much work goes into few numbers of each.

"""
Columns that are computed together.
"""
const COLUMNS = 4

"""
    short_sums!(c, a, b)

`c = a * b` for an `a` of few columns, of which BLAS makes less use.
"""
function short_sums!(c::Contiguous, a::Contiguous, b::AbstractMatrix{Float64})
    n, n_columns = size(c)
    size(a) == (n, size(b, 1)) && size(b, 2) == n_columns ||
        throw(DimensionMismatch("$(size(c)) is not that of $(size(a)) times $(size(b))"))
    n < LINE && return mul!(c, a, b)
    whole = n_columns - n_columns % COLUMNS
    GC.@preserve a c begin
        to, from = pointer(c), pointer(a)
        for column in 1:COLUMNS:whole
            columns!(to, from, n, b, column, Val(COLUMNS))
        end
        for column in (whole + 1):n_columns
            columns!(to, from, n, b, column, Val(1))
        end
    end
    return c
end

# Line by line; the last one may share numbers with that before it.
function columns!(to, from, n, b, column, width)
    for row in 1:LINE:(n - LINE)
        line!(to, from, row, n, b, column, width)
    end
    line!(to, from, n - LINE + 1, n, b, column, width)
    return nothing
end

@inline function line!(to, from, row, n, b, column, width)
    sums = line_sums(from, row, n, b, column, width)
    ntuple(w -> vstore(sums[w], to + 8 * (row - 1 + (column + w - 2) * n)), width)
    return nothing
end

@inline function line_sums(from, row, n, b, column, width)
    sums = ntuple(_ -> zero(Line), width)
    for k in axes(b, 1)
        line = vload(Line, from + 8 * (row - 1 + (k - 1) * n))
        factors = ntuple(w -> @inbounds(b[k, column + w - 1]), width)
        sums = map((factor, sum) -> muladd(line, Line(factor), sum), factors, sums)
    end
    return sums
end
