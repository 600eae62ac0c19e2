"""The closures of preset ``physics`` in JAX: values, Jacobians and coupled predictions.

One module for each closure; ``engine`` couples them.
"""
