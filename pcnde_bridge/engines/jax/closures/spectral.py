"""Integrals along the vessel and derivatives over the cycle."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def from_inlet(density: jax.Array, z: jax.Array) -> jax.Array:
    """∫_{z₀}^{z} f dz' of f (..., z) by the trapezoidal rule, (..., z)."""
    pieces = (density[..., 1:] + density[..., :-1]) / 2 * jnp.diff(z)
    return summed_from_inlet(pieces)


def to_outlet(density: jax.Array, z: jax.Array) -> jax.Array:
    """∫_z^L f dz' of f (..., z) by the trapezoidal rule, (..., z)."""
    integral = from_inlet(density, z)
    return integral[..., -1:] - integral


def summed_from_inlet(pieces: jax.Array) -> jax.Array:
    """Add up the pieces (..., z − 1) that lie before each point, (..., z)."""
    return jnp.concatenate([jnp.zeros_like(pieces[..., :1]), jnp.cumsum(pieces, axis=-1)], axis=-1)


def frequencies(n_times: int, period: jax.Array) -> jax.Array:
    """ω of the harmonics of a real signal, rad/s."""
    return 2 * jnp.pi * jnp.arange(n_times // 2 + 1) / period


def derivative(n_times: int, period: jax.Array) -> jax.Array:
    """iω, rad/s, but 0 of Nyquist's harmonic, which has no slope at the instants."""
    i_omega = 1j * frequencies(n_times, period)
    return i_omega.at[-1].set(0.0) if n_times % 2 == 0 else i_omega


def rate(signal: jax.Array, period: jax.Array) -> jax.Array:
    """∂f/∂t of a periodic signal (..., time), exact for its Fourier series."""
    n_times = signal.shape[-1]
    return jnp.fft.irfft(derivative(n_times, period) * jnp.fft.rfft(signal), n=n_times)
