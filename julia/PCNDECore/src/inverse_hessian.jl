"""
    InverseHessian(scale, n)

The n × n matrix `scale·I + Σ factor·a·bᵀ`, stored as its terms.

`Optim.BFGS` starts from a scaled identity and adds three outer products of vectors in each
iteration. The paper's fits take 5 to 250 iterations with up to 2724 parameters, so that the
vectors need far less memory than the matrix. The update and the product of a dense matrix
take longer than the loss and its gradient. To Optim, this is a matrix like any other; the
results are equal to round-off.
"""
mutable struct InverseHessian <: AbstractMatrix{Float64}
    scale::Float64
    const n::Int
    const factors::Vector{Float64}
    const left::Vector{Vector{Float64}}
    const right::Vector{Vector{Float64}}
end

function InverseHessian(scale::Real, n::Integer)
    return InverseHessian(scale, n, Float64[], Vector{Float64}[], Vector{Float64}[])
end

Base.size(h::InverseHessian) = (h.n, h.n)

function Base.getindex(h::InverseHessian, i::Int, j::Int)
    sum_ = h.scale * (i == j)
    for (factor, a, b) in zip(h.factors, h.left, h.right)
        sum_ += factor * a[i] * b[j]
    end
    return sum_
end

function LinearAlgebra.mul!(y::Vector{Float64}, h::InverseHessian, x::Vector{Float64})
    y .= h.scale .* x
    for (factor, a, b) in zip(h.factors, h.left, h.right)
        axpy!(factor * dot(b, x), a, y)
    end
    return y
end

# Optim's update: h += factor·a·bᵀ.
function LinearAlgebra.mul!(
    h::InverseHessian,
    a::Vector{Float64},
    b::Adjoint{Float64, Vector{Float64}},
    factor::Number,
    retain::Number,
)
    isone(retain) || throw(ArgumentError("an InverseHessian can only be added to"))
    push!(h.factors, factor)
    push!(h.left, copy(a))
    push!(h.right, copy(parent(b)))
    return h
end

# Optim's reset: h .= fresh.
Base.BroadcastStyle(::Type{InverseHessian}) = ArrayStyle{InverseHessian}()

function Base.copyto!(h::InverseHessian, source::Broadcasted{ArrayStyle{InverseHessian}})
    source.f === identity ||
        throw(ArgumentError("an InverseHessian can only be set to another one"))
    fresh::InverseHessian = only(source.args)
    h.scale = fresh.scale
    for (old, new) in ((h.factors, fresh.factors), (h.left, fresh.left), (h.right, fresh.right))
        append!(empty!(old), new)
    end
    return h
end
