"""JAX engine: the equations in JAX, integrated with diffrax or with fixed steps.

Importing :mod:`pcnde_bridge.engines.jax.engine` imports JAX.
"""
