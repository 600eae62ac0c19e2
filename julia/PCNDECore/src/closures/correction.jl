# Learned share g of the wall's storage that the averaged flow does not show.
#
# The inputs of a network are two quantities of the passive tube, the rate u of its outlet
# pressure and its outlet flow y. At every time point,
#
#     g = c·sigmoid(N_θ(u/u_scale, y/y_scale) + shift),
#
# where c is the largest share in the training cases.

"""
    storage_factor(parameters)

κ, the flow per change of the volume under the wall; 1 where volume is conserved.
"""
storage_factor(parameters) = parameters[1]

"""
    hidden_share!(share, parameters, pressure_rate, flow, shift, hidden)

Compute g, (time).

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
    offset, n = 4, 2
    for m in hidden
        x = tanh.(layer(x, parameters, offset, n, m))
        offset, n = offset + (n + 1) * m, m
    end
    share .= ceiling .* NNlib.sigmoid.(vec(layer(x, parameters, offset, n, 1)) .+ shift)
    return share
end

"""
    layer(x, parameters, offset, n, m)

x·W + b, (time, m), for x (time, n), with W and b after the first `offset` parameters.
"""
function layer(x, parameters, offset, n, m)
    @views weight = reshape(parameters[(offset + 1):(offset + n * m)], m, n)
    @views bias = parameters[(offset + n * m + 1):(offset + (n + 1) * m)]
    product = x * weight'
    product .+= bias'
    return product
end
