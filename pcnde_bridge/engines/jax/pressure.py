"""Pressure stages: a network in time, then constant–tanh–constant in space."""

from typing import Any

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines import shared_terms as terms
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS
from pcnde_bridge.engines.jax.separable import Separable
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs
from pcnde_bridge.engines.parameters import layer_sizes, unpack_network


def temporal(
    parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Return p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q), the network over z.

    Parameters
    ----------
    parameters : array of shape (size,)
        The network.
    inputs : tuple of arrays
        See :class:`~pcnde_bridge.engines.protocol.Engine`; r₀ is the radius of the
        first point.
    grid : tuple
        Points and period; not used.
    config : PCNDEConfig
        Network and constants.

    Returns
    -------
    array of shape (case, time, z)
        p̂/p_ref.
    """
    hidden, (matrix, bias) = _hidden(parameters, inputs, config)
    scale = terms.pressure_scale(inputs[-1], config.physics, jnp)
    return 1 + scale[:, None, None] * (hidden @ matrix + bias)


def temporal_mean(
    parameters: jax.Array, inputs: tuple[Any, Any, jax.Array], config: PCNDEConfig
) -> jax.Array:
    """Return the mean of :func:`temporal` over z, (case, time), without its pointwise values.

    Flow and area may be :class:`~pcnde_bridge.engines.jax.separable.Separable`.
    """
    hidden, (matrix, bias) = _hidden(parameters, inputs, config)
    scale = terms.pressure_scale(inputs[-1], config.physics, jnp)
    return 1 + scale[:, None] * (hidden @ jnp.mean(matrix, axis=1) + jnp.mean(bias))


def _hidden(
    parameters: jax.Array, inputs: tuple[Any, ...], config: PCNDEConfig
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Return the last hidden layer of g_θ, (case, time, hidden), and the linear output layer.

    The network's inputs are those of :func:`~pcnde_bridge.engines.shared_terms.network_inputs`.
    """
    flow, area, area_undeformed = inputs
    stage, n_points = config.temporal_pressure, area_undeformed.shape[1]
    activation = ACTIVATIONS[stage.activation]
    widths = layer_sizes("temporal_pressure", config, 0, n_points)
    (first, bias), *middle, last = unpack_network(parameters, widths)
    q = flow.values() if isinstance(flow, Separable) else flow
    drop = terms.network_drop(q, area_undeformed, config)
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
    parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Return p*, see :func:`spatial_from_mean`, from the first stage's p̂* (case, time, z)."""
    temporal, *others = inputs
    return spatial_from_mean(parameters, (jnp.mean(temporal, axis=2), *others), grid[0], config)


def spatial_from_mean(
    parameters: jax.Array, inputs: Inputs, z: jax.Array, config: PCNDEConfig
) -> jax.Array:
    """Return p*: constant up to L/3, a tanh at the stenosis, constant from 2L/3.

    The drop is that of the flow through the stenosis, so that the outer parts
    are constant in z.

    Parameters
    ----------
    parameters : array of shape (2 + 2·time,)
        a₁, a₂, b₁(t), b₂(t).
    inputs : tuple of arrays
        p̂*, the first stage's result, averaged over z, (case, time), then Q (case, time, z), mL/s,
        and S_u (case, z), cm².
    z : array of shape (z,)
        Points, cm.
    config : PCNDEConfig
        Constants, and the equation's form.

    Returns
    -------
    array of shape (case, time, z)
        p/p_ref.
    """
    mean, flow, area_undeformed = inputs
    physics = config.physics
    a1, a2 = parameters[0], parameters[1]
    b1, b2 = jnp.split(parameters[2:], 2)
    at_stenosis = terms.flow_at_stenosis(flow, z, physics, jnp)
    coefficient = physics.turbulent_coefficient + a2
    drop = terms.stenosis_drop(at_stenosis, area_undeformed, coefficient, physics)
    drop = drop / physics.reference_pressure + b1
    height, distance = terms.step_profile(z, config, jnp)
    step = height * jnp.tanh(terms.STEEPNESS * b2[:, None] * distance)
    return (mean + a1)[:, :, None] - drop[:, :, None] * step
