"""Momentum equation with a network and physics terms (section 3.6 of the paper).

    ∂Q/∂z = f_θ(Q, S) + N/(2(1+δ)) + ½ (Q/S) ∂S/∂z − (S/Q) ∂Q/∂t / (2(1+δ)),

where each term is optional; δ = 1/3 and N = −8πν belong to a parabolic profile.  The terms are
not in the span of the last layer, so Q itself is integrated.  Without terms the result is that of
:mod:`pcnde_bridge.engines.jax.flow`, at higher cost.
"""

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.adaptive_tsit5 import Interpolate, integrate
from pcnde_bridge.engines.jax.area import flow_slope
from pcnde_bridge.engines.jax.flow import split_network
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs

DELTA = 1 / 3
"""δ of a parabolic velocity profile."""


def solve(
    parameters: jax.Array, inputs: Inputs, weight: jax.Array, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Integrate cases with common steps; see :func:`pcnde_bridge.engines.jax.flow.solve`."""
    (inflow, area), (z, period) = inputs, grid
    stage = config.flow
    activation = ACTIVATIONS[stage.activation]
    network = split_network(parameters, inflow.shape[1], config)
    on_grid = jnp.einsum("ntz,th->znh", area, network.from_area) + network.first_bias
    # (z, case, time): S and ∂S/∂z, linear between the points.
    area_on_grid, slope_on_grid = (jnp.moveaxis(a, 2, 0) for a in (area, flow_slope(area, z)))
    friction = -8 * jnp.pi * config.physics.viscosity / config.physics.density

    def rate(interpolate: Interpolate, _: jax.Array, flow: jax.Array) -> jax.Array:
        values = activation(interpolate(on_grid) + flow @ network.from_flow)
        for matrix, bias in network.middle:
            values = activation(values @ matrix + bias)
        result = values @ network.last + network.last_bias
        if "friction" in stage.terms:
            result = result + friction / (2 * (1 + DELTA))
        if "convection" in stage.terms:
            result = result + flow / interpolate(area_on_grid) * interpolate(slope_on_grid) / 2
        if "inertia" in stage.terms:
            rise = change_in_time(flow, period)
            result = result - interpolate(area_on_grid) / flow * rise / (2 * (1 + DELTA))
        return result

    integrated = (lambda _, state: state), (lambda error: error)  # Q itself
    return jnp.transpose(integrate(rate, *integrated, inflow, weight, z, stage), (1, 2, 0))


def change_in_time(flow: jax.Array, period: jax.Array) -> jax.Array:
    """Return ∂Q/∂t, mL/s², of Q (case, time), by central differences over the cycle."""
    spacing = period / flow.shape[1]
    return (jnp.roll(flow, -1, axis=1) - jnp.roll(flow, 1, axis=1)) / (2 * spacing)
