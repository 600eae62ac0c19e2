# Fully connected network: a Lux `Chain`, and kernels that evaluate and differentiate it in
# place.

const ACTIVATIONS = Dict{String, Function}(
    "tanh" => tanh,
    "gelu" => NNlib.gelu,
    "relu" => NNlib.relu,
    "sigmoid" => NNlib.sigmoid,
    "swish" => NNlib.swish,
)

"""
    chain(widths, activation)

Lux `Chain` of `Dense` layers from `widths[1]` inputs to `widths[end]` outputs, with a linear
last layer.
"""
function chain(widths::AbstractVector{<:Integer}, activation::AbstractString)
    σ = ACTIVATIONS[activation]
    last = length(widths) - 1
    layers = (
        Dense(widths[i] => widths[i + 1], i < last ? σ : identity) for i in 1:last
    )
    return Chain(layers...)
end

# Like Lux, replace some activations by faster ones of the same accuracy.
fast(σ) = σ
fast(::typeof(tanh)) = NNlib.tanh_fast
fast(::typeof(NNlib.sigmoid)) = NNlib.sigmoid_fast

"""
Activation of a [`Network`](@ref). It is not a type parameter: solver and gradients are compiled
once for all activations.
"""
const Activation = Union{(typeof(fast(σ)) for σ in values(ACTIVATIONS))...}

"""
    specialized(f, σ)

Call `f(σ)`, compiled for the type of σ, without dynamic dispatch. Julia itself distinguishes at
most four types of a union.
"""
@inline specialized(f, σ::Activation) = σ isa typeof(NNlib.tanh_fast) ? f(σ) : f(σ)

"""
    Network(chain)

Activation and matrices `[W b]` (out × in + 1) of a `Chain`, for inputs with an additional
row of ones. A layer's weight and bias are adjacent in the flat parameter vector, so each
matrix is one contiguous part of it.
"""
struct Network
    activation::Activation
    matrices::Vector{Matrix{Float64}}
end

function Network(chain::Chain)
    layers = values(chain.layers)
    return Network(
        fast(first(layers).activation),
        [zeros(layer.out_dims, layer.in_dims + 1) for layer in layers],
    )
end

Base.length(network::Network) = sum(length, network.matrices)

"""
    load!(network, parameters)

Set the matrices from the flat parameter vector.
"""
function load!(network::Network, parameters::AbstractVector{Float64})
    expected, actual = length(network), length(parameters)
    if expected != actual
        throw(DimensionMismatch("the network has $expected parameters, not $actual"))
    end
    offset = 0
    for matrix in network.matrices
        copyto!(matrix, 1, parameters, offset + 1, length(matrix))
        offset += length(matrix)
    end
    return network
end

"""
    derivative(activation, x, y)

dy/dx for `y = activation(x)`.
"""
derivative(::Union{typeof(tanh), typeof(NNlib.tanh_fast)}, x, y) = 1 - y * y
derivative(::Union{typeof(NNlib.sigmoid), typeof(NNlib.sigmoid_fast)}, x, y) = y * (1 - y)
derivative(::typeof(NNlib.relu), x, y) = x > 0 ? one(y) : zero(y)
function derivative(::typeof(NNlib.swish), x, y)
    s = NNlib.sigmoid_fast(x)
    return s + y * (1 - s)
end
# y = x/2·(1 + tanh u) with u = √(2/π)·(x + 0.044715·x³)
function derivative(::typeof(NNlib.gelu), x, y)
    λ, cubic = sqrt(2 / π), 0.044715 * x^2
    t = NNlib.tanh_fast(λ * x * (1 + cubic))
    return (1 + t + λ * x * (1 + 3 * cubic) * (1 - t^2)) / 2
end

"""
    Activations(widths, columns)

Buffers for the values of the hidden layers before and after their activation. `after` has an
additional row of ones for the bias of the next layer.
"""
struct Activations
    before::Vector{Matrix{Float64}}
    after::Vector{Matrix{Float64}}
end

function Activations(widths::AbstractVector{<:Integer}, columns::Integer)
    before = [zeros(width, columns) for width in widths]
    after = [ones(width + 1, columns) for width in widths]
    return Activations(before, after)
end

"""
    forward!(activations, network, columns)

Evaluate the hidden layers from `before[1]`, for the first `columns` columns only.
"""
function forward!(a::Activations, network::Network, columns::Integer)
    for layer in eachindex(a.before)
        before, after = a.before[layer], a.after[layer]
        if layer > 1
            mul!(
                view(before, :, 1:columns),
                network.matrices[layer],
                view(a.after[layer - 1], :, 1:columns),
            )
        end
        specialized(σ -> activate!(after, before, σ, columns), network.activation)
    end
    return a
end

function activate!(after, before, σ::F, columns) where {F}
    @inbounds for column in 1:columns
        @simd ivdep for row in axes(before, 1)
            after[row, column] = σ(before[row, column])
        end
    end
    return after
end

"""
    times_derivative!(result, factor, before, after, activation)

`result = factor · dy/dx` elementwise; `factor` and `after` may have additional rows.
"""
function times_derivative!(result, factor, before, after, activation::Activation)
    return specialized(activation) do σ
        times_derivative_of!(result, factor, before, after, σ)
    end
end

function times_derivative_of!(result, factor, before, after, σ::F) where {F}
    @inbounds for column in axes(result, 2)
        @simd ivdep for row in axes(result, 1)
            result[row, column] =
                factor[row, column] * derivative(σ, before[row, column], after[row, column])
        end
    end
    return result
end
