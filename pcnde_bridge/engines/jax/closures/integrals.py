"""Integrals along the vessel."""

import jax
import jax.numpy as jnp


def from_inlet(density: jax.Array, z: jax.Array) -> jax.Array:
    """Return ∫_{z₀}^{z} f dz' of f (..., z) by the trapezoidal rule, (..., z)."""
    pieces = (density[..., 1:] + density[..., :-1]) / 2 * jnp.diff(z)
    return summed_from_inlet(pieces)


def to_outlet(density: jax.Array, z: jax.Array) -> jax.Array:
    """Return ∫_z^L f dz' of f (..., z) by the trapezoidal rule, (..., z)."""
    integral = from_inlet(density, z)
    return integral[..., -1:] - integral


def summed_from_inlet(pieces: jax.Array) -> jax.Array:
    """Add up the pieces (..., z − 1) that lie before each point, (..., z)."""
    return jnp.concatenate([jnp.zeros_like(pieces[..., :1]), jnp.cumsum(pieces, axis=-1)], axis=-1)
