"""Both pressure stages: a network in time, then constant–tanh–constant in space."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig, Physics
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS, unpack
from pcnde_bridge.engines.jax.separable import Separable
from pcnde_bridge.engines.parameters import layer_sizes
from pcnde_bridge.hemodynamics.pressure_losses import pressure_drop


def temporal(
    parameters: jax.Array,
    flow: jax.Array,
    area: jax.Array,
    area_undeformed: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q), the network over z at each instant.

    Parameters
    ----------
    parameters : array of shape (size,)
        The network.
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    area_undeformed : array of shape (case, z)
        S_u, cm²; r₀ is the radius of its first point.
    config : PCNDEConfig
        Network and constants.

    Returns
    -------
    array of shape (case, time, z)
        p̂/p_ref.
    """
    hidden, (matrix, bias) = _hidden(parameters, flow, area, area_undeformed, config)
    return 1 + _scale(area_undeformed, config.physics)[:, None, None] * (hidden @ matrix + bias)


def temporal_mean(
    parameters: jax.Array,
    flow: jax.Array | Separable,
    area: jax.Array | Separable,
    area_undeformed: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """Mean of :func:`temporal` over z, (case, time), without its values at every point."""
    hidden, (matrix, bias) = _hidden(parameters, flow, area, area_undeformed, config)
    mean = hidden @ jnp.mean(matrix, axis=1) + jnp.mean(bias)
    return 1 + _scale(area_undeformed, config.physics)[:, None] * mean


def _hidden(
    parameters: jax.Array,
    flow: jax.Array | Separable,
    area: jax.Array | Separable,
    area_undeformed: jax.Array,
    config: PCNDEConfig,
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Last hidden layer of g_θ, (case, time, hidden), and the linear layer after it."""
    stage, physics = config.temporal_pressure, config.physics
    activation, n_points = ACTIVATIONS[stage.activation], area_undeformed.shape[1]
    widths = layer_sizes("temporal_pressure", config, 0, n_points)
    (first, bias), *middle, last = unpack(parameters, widths)
    q = flow.values() if isinstance(flow, Separable) else flow
    drop = _drop(q, area_undeformed[:, None], physics.turbulent_coefficient, physics)
    if stage.pressure_drop_input == "normalized":
        drop = drop / physics.reference_pressure
    for_area, for_change, for_drop, for_flow = jnp.split(first, 4)
    # S and S − S_u enter linearly: one product does for both.
    values = (
        area @ (for_area + for_change)
        - (area_undeformed @ for_change)[:, None]
        + drop @ for_drop
        + flow @ for_flow
        + bias
    )
    for matrix, bias in middle:
        values = activation(values) @ matrix + bias
    return activation(values), last


def _scale(area_undeformed: jax.Array, physics: Physics) -> jax.Array:
    """E·h/(r₀·p_ref) of every case."""
    radius = jnp.sqrt(area_undeformed[:, 0] / jnp.pi)
    stiffness = physics.young_modulus * physics.wall_thickness / radius
    return stiffness / physics.reference_pressure


def spatial(
    parameters: jax.Array,
    mean: jax.Array,
    flow: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """p* constant up to L/3, a tanh at the stenosis, constant from 2L/3.

    The drop is that of the flow through the stenosis, so that the outer parts
    are constant in z.

    Parameters
    ----------
    parameters : array of shape (2 + 2·time,)
        a₁, a₂, b₁(t), b₂(t).
    mean : array of shape (case, time)
        p̂*, the first stage's result, averaged over z.
    flow : array of shape (case, time, z)
        Q, mL/s.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    z : array of shape (z,)
        Points, cm.
    config : PCNDEConfig
        Constants, and the equation's form.

    Returns
    -------
    array of shape (case, time, z)
        p/p_ref.
    """
    physics = config.physics
    a1, a2 = parameters[0], parameters[1]
    b1, b2 = jnp.split(parameters[2:], 2)
    after = jnp.clip(jnp.searchsorted(z, physics.stenosis_position), 1, z.shape[0] - 1)
    share = (physics.stenosis_position - z[after - 1]) / (z[after] - z[after - 1])
    at_stenosis = (1 - share) * flow[:, :, after - 1] + share * flow[:, :, after]
    coefficient = physics.turbulent_coefficient + a2
    drop = _drop(at_stenosis, area_undeformed, coefficient, physics)
    drop = drop / physics.reference_pressure + b1
    start, third = z[0], (z[-1] - z[0]) / 3
    inside = jnp.clip(z, start + third, start + 2 * third)
    step = jnp.tanh(10 * b2[:, None] * (inside - physics.stenosis_position))
    if config.spatial_pressure.form == "printed":
        step = jnp.where(z <= start + third, 0.0, step)
    else:
        step = step / 2
    return (mean + a1)[:, :, None] - drop[:, :, None] * step


def _drop(
    flow: jax.Array, area_undeformed: jax.Array, coefficient: jax.Array | float, physics: Physics
) -> jax.Array:
    """Δp of Seeley and Young, dyn/cm²; the healthy area is the first point's."""
    drop: jax.Array = pressure_drop(
        flow,
        area_undeformed[..., :1],
        jnp.min(area_undeformed, axis=-1, keepdims=True),
        physics.stenosis_length,
        density=physics.density,
        viscosity=physics.viscosity,
        turbulent_coefficient=coefficient,  # type: ignore[arg-type]
    )
    return drop
