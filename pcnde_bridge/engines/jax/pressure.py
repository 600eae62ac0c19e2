"""Both pressure stages: a network in time, then constant–tanh–constant in space."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig, Physics
from pcnde_bridge.engines.jax.network import ACTIVATIONS, unpack
from pcnde_bridge.parameters import layer_sizes
from pcnde_bridge.stenosis import pressure_drop


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
    stage, physics = config.temporal_pressure, config.physics
    activation, n_points = ACTIVATIONS[stage.activation], flow.shape[2]
    layers = unpack(parameters, layer_sizes("temporal_pressure", config, flow.shape[1], n_points))
    drop = _drop(flow, area_undeformed[:, None], physics.turbulent_coefficient, physics)
    if stage.pressure_drop_input == "normalised":
        drop = drop / physics.reference_pressure
    inputs = (area, area - area_undeformed[:, None], drop, flow)
    (first, first_bias), *rest = layers
    values = first_bias + sum(
        part @ matrix for part, matrix in zip(inputs, jnp.split(first, 4), strict=True)
    )
    for matrix, bias in rest:
        values = activation(values) @ matrix + bias
    radius = jnp.sqrt(area_undeformed[:, 0] / jnp.pi)
    stiffness = physics.young_modulus * physics.wall_thickness / radius
    return 1 + (stiffness / physics.reference_pressure)[:, None, None] * values


def spatial(
    parameters: jax.Array,
    temporal_pressure: jax.Array,
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
    temporal_pressure, flow : array of shape (case, time, z)
        p̂*, and Q, mL/s.
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
    at_stenosis = jax.vmap(jax.vmap(lambda q: jnp.interp(physics.stenosis_position, z, q)))(flow)
    coefficient = physics.turbulent_coefficient + a2
    drop = _drop(at_stenosis, area_undeformed, coefficient, physics)
    drop = drop / physics.reference_pressure + b1
    start, third = z[0], (z[-1] - z[0]) / 3
    inside = jnp.clip(z, start + third, start + 2 * third)
    step = jnp.tanh(10 * b2[:, None] * (inside - physics.stenosis_position))
    mean = jnp.mean(temporal_pressure, axis=2) + a1
    if config.spatial_pressure.form == "printed":
        step = jnp.where(z <= start + third, 0.0, step)
    else:
        step = step / 2
    return mean[:, :, None] - drop[:, :, None] * step


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
