"""Momentum equation in time, ∂Q/∂t = f_θ(Q) or f_θ(Q, t), by the classical Runge–Kutta method.

Each point of the vessel has one ordinary differential equation, and the network couples them.
After each step the inlet's value is replaced by Q_in.  Gradients are those of the discrete steps.
"""

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs
from pcnde_bridge.engines.parameters import layer_sizes, unpack_network


def solve(
    parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Integrate one cycle, from its first time point to its last.

    Parameters
    ----------
    parameters : array of shape (size,)
        The network.
    inputs : tuple of arrays
        See :class:`~pcnde_bridge.engines.protocol.Engine`.
    grid : tuple
        Points, cm, and period, s.
    config : PCNDEConfig
        Network, and steps between two time points.

    Returns
    -------
    array of shape (case, time, z)
        Q, mL/s; not finite where the solution diverges.
    """
    (inflow, initial_flow), (_, period) = inputs, grid
    stage = config.temporal_flow
    n_times, n_points = inflow.shape[1], initial_flow.shape[1]
    activation = ACTIVATIONS[stage.activation]
    layers = unpack_network(parameters, layer_sizes("temporal_flow", config, n_times, n_points))
    (first, first_bias), *middle, (last, last_bias) = layers
    per_second = n_times * stage.steps / period
    step = 1 / per_second

    def rate(flow: jax.Array, at: jax.Array) -> jax.Array:
        values = flow @ first[:n_points] + first_bias
        if stage.time_input:
            values = values + at / (n_times * stage.steps) * first[n_points]
        values = activation(values)
        for matrix, bias in middle:
            values = activation(values @ matrix + bias)
        return values @ last + last_bias

    def advance(flow: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        at, inlet = now
        k1 = rate(flow, at)
        k2 = rate(flow + step / 2 * k1, at + 0.5)
        k3 = rate(flow + step / 2 * k2, at + 0.5)
        k4 = rate(flow + step * k3, at + 1)
        flow = flow + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        flow = flow.at[:, 0].set(inlet)
        return flow, flow

    share = jnp.arange(1, stage.steps + 1) / stage.steps
    between = inflow[:, :-1, None] * (1 - share) + inflow[:, 1:, None] * share
    inlet = between.reshape(len(inflow), -1).T
    initial_flow = initial_flow.at[:, 0].set(inflow[:, 0])
    _, after = jax.lax.scan(advance, initial_flow, (jnp.arange(len(inlet)), inlet))
    flow = jnp.concatenate([initial_flow[None], after[stage.steps - 1 :: stage.steps]])
    return jnp.moveaxis(flow, 0, 1)
