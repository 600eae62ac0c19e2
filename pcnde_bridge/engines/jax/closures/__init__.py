"""Closures of the ``physics`` preset in JAX: values, Jacobians and coupled predictions.

Each closure has its own module; ``coupling`` couples them, and ``engine`` calls them.
"""
