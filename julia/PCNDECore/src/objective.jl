"""
Squared error as a function of a flat parameter vector, which a fit minimizes.

Subtypes have the methods `value!(objective, parameters)` and
`value_and_gradient!(gradient, objective, parameters)`. Both return the loss, which is `Inf`
where the equation cannot be integrated. An objective reuses its work arrays, so only one
caller may use it at a time.
"""
abstract type Objective end

"""
    set_weight!(objective, weight)

Set the weight (case) of each case's squares in the loss; it is 1 by default. Only the loss
of the flow accepts different weights.
"""
function set_weight!(objective::Objective, weight)
    allequal(weight) ||
        throw(ArgumentError("only the loss of the flow accepts different weights"))
    return objective
end
