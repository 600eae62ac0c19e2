r"""Boundary layer and jet of a steady flow along a vessel.

A core of uniform speed is surrounded by a layer of thickness d·r_u with a quadratic profile,
u = U·(2y − y²) with the distance from the wall y·d·r_u.  In a straight vessel d = 1 is
Poiseuille's parabola.  With

    m = 1 − 2d/3 + d²/6,    k = 1 − 14d/15 + 4d²/15

the means of u/U and (u/U)² over the cross-section, Bernoulli's equation on the axis and the
momentum balance of the cross-section give

    (dE/dd + m'/m³)·d' = −(ln S_u)'·(1 − k)/m² + c_g·4πν/(Q·m)·(d⁶ − 1/d),    E = k/m²,

where c_g scales the growth of the layer by viscosity (1 for the quadratic profile).  The layer
becomes thin where the vessel narrows, and grows back downstream.

Behind a narrowing the flow separates where the vessel widens faster than a free jet.  The jet's
radius r_j grows by

    dr_j/dz = s + s_ν·πν·r_j/Q

until the jet fills the vessel again, r_j = r_u/√β: a parabola has β = 4/3 times the momentum of a
uniform flow through the same area.  The first term is that of a turbulent jet, the second that of
a laminar one.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

_STEPS = 2
"""Steps of the layer's equation in each interval between two points."""

_THINNEST = 0.02
"""Smallest thickness of the layer, relative to the radius."""

_GAMMA = 1 - 1 / math.sqrt(2)
"""Coefficient of the L-stable Rosenbrock method of second order (ROS2)."""


def mean_speed(thickness: jax.Array) -> jax.Array:
    """Return m, the mean speed over that of the core."""
    return 1 - 2 / 3 * thickness + thickness**2 / 6


def along_vessel(
    area: jax.Array,
    z: jax.Array,
    viscosity: jax.Array,
    growth: jax.Array,
    momentum: jax.Array,
    spread: jax.Array,
    viscous_spread: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """March layer and jet from the inlet, where the flow is Poiseuille's.

    Parameters
    ----------
    area : array of shape (z,)
        S_u, cm².
    z : array of shape (z,)
        Points, cm.
    viscosity : array of shape (flow,)
        πν/Q of each flow, 1/cm.
    growth, momentum, spread, viscous_spread : scalars
        c_g, β, s and s_ν.

    Returns
    -------
    thickness, jet : arrays of shape (flow, z)
        d, and the area A_j of the jet, cm², which is S_u/β where the flow fills the vessel.
    """
    filled = jnp.sqrt(area / (jnp.pi * momentum))

    def advance(
        before: tuple[jax.Array, jax.Array], interval: tuple[jax.Array, ...]
    ) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
        d, radius = before
        dz, slope, limit = interval
        for _ in range(_STEPS):
            d = _layer_step(d, dz / _STEPS, slope, 4 * growth * viscosity)
        half = dz / 2 * viscous_spread * viscosity
        radius = jnp.minimum((radius * (1 + half) + dz * spread) / (1 - half), limit)
        return (d, radius), (d, radius)

    steps = jnp.diff(z)
    first = jnp.ones_like(viscosity), jnp.full_like(viscosity, filled[0])
    intervals = steps, jnp.diff(jnp.log(area)) / steps, filled[1:]
    _, marched = jax.lax.scan(advance, first, intervals)
    thickness, radius = (
        jnp.concatenate([start[:, None], rest.T], axis=1)
        for start, rest in zip(first, marched, strict=True)
    )
    # Exactly S_u/β where the flow fills the vessel: a straight vessel has no jet at all.
    jet = jnp.where(radius >= filled, area / momentum, jnp.pi * radius**2)
    return thickness, jet


def _layer_step(d: jax.Array, dz: jax.Array, slope: jax.Array, growth: jax.Array) -> jax.Array:
    """Advance d by a linearly implicit step, which is stable for any growth and step."""

    def rate(d: jax.Array) -> jax.Array:
        m, m_d = mean_speed(d), -2 / 3 + d / 3
        k, k_d = 1 - 14 / 15 * d + 4 / 15 * d**2, -14 / 15 + 8 / 15 * d
        inertia = k_d / m**2 - 2 * k * m_d / m**3 + m_d / m**3
        return (-slope * (1 - k) / m**2 + growth / m * (d**6 - 1 / d)) / inertia

    value, derivative = jax.jvp(rate, (d,), (jnp.ones_like(d),))
    matrix = 1 - _GAMMA * dz * derivative
    first = value / matrix
    second = (rate(jnp.clip(d + dz * first, _THINNEST, 1.0)) - 2 * first) / matrix
    return jnp.clip(d + dz * (1.5 * first + 0.5 * second), _THINNEST, 1.0)
