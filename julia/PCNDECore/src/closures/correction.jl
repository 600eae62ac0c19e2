# The learned share g of the wall's storage that the averaged flow does not show.
#
# A network of two local quantities of the passive tube, the rate u of its outlet pressure
# and its outlet flow y, gives at every instant
#
#     g = c·sigmoid(N_θ(u/u_scale, y/y_scale) + shift),
#
# where the ceiling c is the largest share that the training cases show.

"""
    storage_factor(parameters)

κ: how much flow goes into a change of the wall's volume; 1 where volume is conserved.
"""
storage_factor(parameters) = parameters[1]

"""
    hidden_share!(share, parameters, pressure_rate, flow, shift, hidden)

Fill `share` with g, (time).

# Arguments

  - `parameters`: κ, c, u_scale (dyn/cm²/s), y_scale (mL/s), then per layer weights (in × out,
    row by row) and bias.
  - `pressure_rate`, `flow`: u and y, (time).
  - `shift`: added before the sigmoid.
  - `hidden`: widths of the hidden layers.
"""
function hidden_share!(share, parameters, pressure_rate, flow, shift, hidden)
    _, ceiling, u_scale, y_scale = parameters
    x = similar(share, length(flow), 2)
    @views x[:, 1] .= pressure_rate ./ u_scale
    @views x[:, 2] .= flow ./ y_scale
    at, n = 4, 2
    for m in hidden
        x = tanh.(layer(x, parameters, at, n, m))
        at, n = at + (n + 1) * m, m
    end
    share .= ceiling .* NNlib.sigmoid.(vec(layer(x, parameters, at, n, 1)) .+ shift)
    return share
end

"""
    layer(x, parameters, at, n, m)

x·W + b, (time, m), of x (time, n), with W and b after the first `at` parameters.
"""
function layer(x, parameters, at, n, m)
    @views weight = reshape(parameters[(at + 1):(at + n * m)], m, n)
    @views bias = parameters[(at + n * m + 1):(at + (n + 1) * m)]
    product = x * weight'
    product .+= bias'
    return product
end
