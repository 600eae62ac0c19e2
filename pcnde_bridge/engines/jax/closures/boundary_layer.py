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

import math
from typing import Any

import jax
import jax.numpy as jnp

_Jet = tuple[jax.Array, jax.Array]
"""Area and volume of the jet."""

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
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """March layer and jet from the inlet, where the flow is Poiseuille's.

    Parameters
    ----------
    area, z : arrays of shape (..., z)
        S_u, cm², and the points, cm.
    viscosity : array of shape (..., flow)
        πν/Q of each flow, 1/cm.
    growth, momentum, spread, viscous_spread : scalars
        c_g, β, s and s_ν.

    Returns
    -------
    thickness, jet, volume : arrays of shape (..., flow, z)
        d; the area A_j of the jet, cm², which is S_u/β where the flow fills the vessel; and the
        jet's volume since its beginning, cm³.
    """
    steps = jnp.diff(z)
    filled = area / momentum
    layer_growth, jet_growth = 4 * growth * viscosity, viscous_spread * viscosity / 2

    def grow_layer(d: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        after = _layer_step(d, *step, layer_growth)
        return after, after

    def grow_jet(before: _Jet, interval: tuple[jax.Array, ...]) -> tuple[_Jet, _Jet]:
        jet, volume = before
        dz, last_limit, limit = interval
        # The implicit midpoint rule.
        half = dz * jet_growth
        radius = (jnp.sqrt(jet / jnp.pi) * (1 + half) + dz * spread) / (1 - half)
        grown = jnp.pi * radius**2
        # Exactly S_u/β where the flow fills the vessel: a straight vessel has no jet.
        fills = grown >= limit
        after = jnp.where(fills, limit, grown)
        begins = jnp.where(jet >= last_limit, 0.0, jet)
        volume = jnp.where(fills, 0.0, volume + dz * (begins + after) / 2)
        return (after, volume), (after, volume)

    def march(function: Any, first: Any, intervals: tuple[jax.Array, ...], stride: int) -> Any:
        along = tuple(jnp.moveaxis(values, -1, 0)[..., None] for values in intervals)
        _, later = jax.lax.scan(function, first, along)
        return jax.tree.map(
            lambda start, rest: jnp.moveaxis(
                jnp.concatenate([start[None], rest[stride - 1 :: stride]]), 0, -1
            ),
            first,
            later,
        )

    one = jnp.ones_like(filled[..., :1] * viscosity)
    slope = jnp.diff(jnp.log(area)) / steps
    layer_steps = (jnp.repeat(values, _STEPS, axis=-1) for values in (steps / _STEPS, slope))
    thickness = march(grow_layer, one, tuple(layer_steps), _STEPS)
    intervals = steps, filled[..., :-1], filled[..., 1:]
    jet, volume = march(grow_jet, (filled[..., :1] * one, 0 * one), intervals, 1)
    return thickness, jet, volume


def _layer_step(d: jax.Array, dz: jax.Array, slope: jax.Array, growth: jax.Array) -> jax.Array:
    """Advance d by a linearly implicit step, which is stable for any growth and step."""
    rate, derivative = _layer_rate(d, slope, growth)
    matrix = 1 - _GAMMA * dz * derivative
    first = rate / matrix
    middle, _ = _layer_rate(jnp.clip(d + dz * first, _THINNEST, 1.0), slope, growth)
    second = (middle - 2 * first) / matrix
    return jnp.clip(d + dz * (1.5 * first + 0.5 * second), _THINNEST, 1.0)


def _layer_rate(d: jax.Array, slope: jax.Array, growth: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return d', 1/cm, and its derivative in d, from the equation multiplied by m³."""
    m, m_d, m_dd = mean_speed(d), d / 3 - 2 / 3, 1 / 3
    k, k_d, k_dd = 1 - 14 / 15 * d + 4 / 15 * d**2, 8 / 15 * d - 14 / 15, 8 / 15
    viscous, viscous_d = d**6 - 1 / d, 6 * d**5 + 1 / d**2
    inertia = k_d * m + (1 - 2 * k) * m_d
    inertia_d = k_dd * m - k_d * m_d + (1 - 2 * k) * m_dd
    force = growth * m**2 * viscous - slope * (1 - k) * m
    force_d = growth * m * (2 * m_d * viscous + m * viscous_d) + slope * (k_d * m - (1 - k) * m_d)
    rate = force / inertia
    return rate, (force_d - rate * inertia_d) / inertia
