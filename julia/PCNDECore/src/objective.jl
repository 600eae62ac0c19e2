"""
What a fit minimises: a squared error as a function of a flat parameter vector.

Subtypes have the methods `value!(objective, parameters)` and
`value_and_gradient!(gradient, objective, parameters)`, both returning the loss,
which is `Inf` where the equation cannot be integrated. They keep their arrays, so
an objective serves one caller at a time.
"""
abstract type Objective end

"""
    set_weight!(objective, weight)

Set the weight (case) of each case's squares in the loss, which is 1 until then. All but the
flow's loss take equal weights only.
"""
function set_weight!(objective::Objective, weight)
    allequal(weight) || throw(ArgumentError("only the loss of the flow has weights"))
    return objective
end
