"""Pressure stages: a network in time, then constant–tanh–constant in space."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS
from pcnde_bridge.engines.jax.separable import Separable
from pcnde_bridge.engines.parameters import layer_sizes, unpack_network
from pcnde_bridge.engines.shared_terms import (
    STEEPNESS,
    flow_at_stenosis,
    network_drop,
    pressure_scale,
    stenosis_drop,
    step_profile,
)


def temporal(
    parameters: jax.Array,
    flow: jax.Array,
    area: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    period: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """Return p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q), the network over z.

    Parameters
    ----------
    parameters : array of shape (size,)
        The network.
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    area_undeformed : array of shape (case, z)
        S_u, cm²; r₀ is the radius of its first point.
    z, period
        The grid; not used.
    config : PCNDEConfig
        Network and constants.

    Returns
    -------
    array of shape (case, time, z)
        p̂/p_ref.
    """
    hidden, (matrix, bias) = _hidden(parameters, flow, area, area_undeformed, config)
    scale: jax.Array = pressure_scale(area_undeformed, config.physics, jnp)
    return 1 + scale[:, None, None] * (hidden @ matrix + bias)


def temporal_mean(
    parameters: jax.Array,
    flow: jax.Array | Separable,
    area: jax.Array | Separable,
    area_undeformed: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """Return the mean of :func:`temporal` over z, (case, time), without its pointwise values."""
    hidden, (matrix, bias) = _hidden(parameters, flow, area, area_undeformed, config)
    mean = hidden @ jnp.mean(matrix, axis=1) + jnp.mean(bias)
    scale: jax.Array = pressure_scale(area_undeformed, config.physics, jnp)
    return 1 + scale[:, None] * mean


def _hidden(
    parameters: jax.Array,
    flow: jax.Array | Separable,
    area: jax.Array | Separable,
    area_undeformed: jax.Array,
    config: PCNDEConfig,
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Return the last hidden layer of g_θ, (case, time, hidden), and the linear output layer.

    The inputs are those of :func:`~pcnde_bridge.engines.shared_terms.network_inputs`.
    """
    stage, n_points = config.temporal_pressure, area_undeformed.shape[1]
    activation = ACTIVATIONS[stage.activation]
    widths = layer_sizes("temporal_pressure", config, 0, n_points)
    (first, bias), *middle, last = unpack_network(parameters, widths)
    q = flow.values() if isinstance(flow, Separable) else flow
    drop = network_drop(q, area_undeformed, config)
    for_area, for_change, for_drop, for_flow = jnp.split(first, 4)
    # S and S − S_u enter linearly: one product serves both.
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


def spatial(
    parameters: jax.Array,
    temporal: jax.Array,
    flow: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    period: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """Return p*, see :func:`spatial_from_mean`, from the first stage's p̂* (case, time, z)."""
    mean = jnp.mean(temporal, axis=2)
    return spatial_from_mean(parameters, mean, flow, area_undeformed, z, config)


def spatial_from_mean(
    parameters: jax.Array,
    mean: jax.Array,
    flow: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    config: PCNDEConfig,
) -> jax.Array:
    """Return p*: constant up to L/3, a tanh at the stenosis, constant from 2L/3.

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
    at_stenosis = flow_at_stenosis(flow, z, physics, jnp)
    coefficient = physics.turbulent_coefficient + a2
    drop: jax.Array = stenosis_drop(at_stenosis, area_undeformed, coefficient, physics)
    drop = drop / physics.reference_pressure + b1
    height, distance = step_profile(z, config, jnp)
    step: jax.Array = height * jnp.tanh(STEEPNESS * b2[:, None] * distance)
    return (mean + a1)[:, :, None] - drop[:, :, None] * step
