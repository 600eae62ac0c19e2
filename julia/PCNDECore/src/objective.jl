"""
What a fit minimises: a squared error as a function of a flat parameter vector.

Subtypes have the methods `value!(objective, parameters)` and
`value_and_gradient!(gradient, objective, parameters)`, both returning the loss,
which is `Inf` where the equation cannot be integrated. They keep their arrays, so
an objective serves one caller at a time.
"""
abstract type Objective end
