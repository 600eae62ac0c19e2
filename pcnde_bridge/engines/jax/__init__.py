"""The embedded engine: the equations in JAX, solved with diffrax or with fixed steps.

The class is :class:`pcnde_bridge.engines.jax.engine.JaxEngine`; importing it imports JAX.
"""
