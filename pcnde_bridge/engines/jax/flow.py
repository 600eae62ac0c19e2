"""Momentum equation ∂Q/∂z = f_θ(Q, S) as a neural ODE in z (diffrax, Tsit5).

The last layer of f_θ is linear, f = W·h(Q, S) + b, so the solution is

    Q(z) = Q_in + z·b + W·H(z),   dH/dz = h(Q, S),   H(0) = 0,

with H as wide as the last hidden layer (8 in the paper) instead of Q's n_t
time points.  Runge–Kutta steps, their error estimate and their interpolation are
affine in the state, so integrating H gives the same Q as integrating Q up to
round-off, at a tenth of the cost.  The error is measured on Q.  The first layer's
product with S is linear in S, and S is linear in z between the points, so the
product is computed once at the points and interpolated.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.adaptive_tsit5 import Interpolate, integrate
from pcnde_bridge.engines.jax.fixed_step_tsit5 import integrate as integrate_in_fixed_steps
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs
from pcnde_bridge.engines.parameters import layer_sizes, unpack_network


class FlowNetwork(NamedTuple):
    """Layers of f_θ, the first split into the parts for Q and S.

    Attributes
    ----------
    from_flow, from_area : array of shape (time, hidden)
        Weights of the first layer.
    first_bias : array of shape (hidden,)
        Its bias.
    middle : list of (matrix, bias)
        The other hidden layers.
    last, last_bias : array of shape (hidden, time) and (time,)
        W (transposed) and b of the linear last layer.
    """

    from_flow: jax.Array
    from_area: jax.Array
    first_bias: jax.Array
    middle: list[tuple[jax.Array, jax.Array]]
    last: jax.Array
    last_bias: jax.Array


def split_network(parameters: jax.Array, n_times: int, config: PCNDEConfig) -> FlowNetwork:
    """Return the network of a parameter vector."""
    widths = layer_sizes("flow", config, n_times, 0)
    (first, first_bias), *middle, (last, last_bias) = unpack_network(parameters, widths)
    return FlowNetwork(first[:n_times], first[n_times:], first_bias, middle, last, last_bias)


def solve(
    parameters: jax.Array, inputs: Inputs, weight: jax.Array, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Integrate cases with common steps.

    Parameters
    ----------
    parameters : array of shape (size,)
        The network.
    inputs : tuple of arrays
        See :class:`~pcnde_bridge.engines.protocol.Engine`.
    weight : array of shape (case,)
        1, or 0 for a case that pads a batch and must not influence the steps.
    grid : tuple
        Points, cm, and period, s.
    config : PCNDEConfig
        Network and tolerances.

    Returns
    -------
    array of shape (case, time, z)
        Q, mL/s; not finite where the integration did not reach the last point.
    """
    (inflow, area), (z, _) = inputs, grid
    network = split_network(parameters, inflow.shape[1], config)
    if config.flow.steps is None:
        from_area = jnp.einsum("ntz,th->nzh", area, network.from_area)
        hidden = solve_hidden(network, (inflow, from_area), weight, z, config)
        gained = jnp.einsum("nzh,ht->ntz", hidden, network.last)
    else:
        # Products are batched over cases, in the memory order of the arrays.
        first, last = (
            jnp.broadcast_to(matrix.T, (len(inflow), *matrix.T.shape))
            for matrix in (network.from_area, network.last)
        )
        from_area = jnp.moveaxis(first @ area, 1, 0)
        hidden = _hidden_in_fixed_steps(network, inflow, from_area, z, config)
        gained = last @ jnp.moveaxis(hidden, 0, 1)
    return inflow[:, :, None] + network.last_bias[:, None] * (z - z[0]) + gained


def solve_hidden(
    network: FlowNetwork, inputs: Inputs, weight: jax.Array, z: jax.Array, config: PCNDEConfig
) -> jax.Array:
    """Integrate dH/dz = h, with the error measured on Q.

    Parameters
    ----------
    network : FlowNetwork
        f_θ.
    inputs : tuple of arrays
        Q_in (case, time), mL/s, and the product of S and the first layer at the points,
        (case, z, hidden).
    weight, z, config
        As in :func:`solve`.

    Returns
    -------
    array of shape (case, z, hidden)
        H at the points; not finite where the integration did not reach the last one.
    """
    inflow, from_area = inputs
    if config.flow.steps is not None:
        state = _hidden_in_fixed_steps(network, inflow, jnp.moveaxis(from_area, 2, 0), z, config)
        return jnp.moveaxis(state, 0, 2)
    stage = config.flow
    activation = ACTIVATIONS[stage.activation]
    last, last_bias = network.last, network.last_bias
    on_grid = jnp.moveaxis(from_area, 1, 0) + network.first_bias + inflow @ network.from_flow
    along_bias, along_hidden = last_bias @ network.from_flow, last @ network.from_flow

    def rate(interpolate: Interpolate, position: jax.Array, state: jax.Array) -> jax.Array:
        drive = interpolate(on_grid) + (position - z[0]) * along_bias
        values = activation(drive + state @ along_hidden)
        for matrix, bias in network.middle:
            values = activation(values @ matrix + bias)
        return values

    def flow(position: jax.Array, state: jax.Array) -> jax.Array:
        return inflow + (position - z[0]) * last_bias + state @ last

    start = jnp.zeros((inflow.shape[0], last.shape[0]))
    hidden = integrate(rate, flow, lambda error: error @ last, start, weight, z, stage)
    return jnp.moveaxis(hidden, 0, 1)


def _hidden_in_fixed_steps(
    network: FlowNetwork, inflow: jax.Array, from_area: jax.Array, z: jax.Array, config: PCNDEConfig
) -> jax.Array:
    """Return H at the points from the product of S and the first layer; both (hidden, case, z)."""
    activation = ACTIVATIONS[config.flow.activation]
    per_case = (network.first_bias + inflow @ network.from_flow).T
    along_bias = network.last_bias @ network.from_flow
    along_hidden = (network.last @ network.from_flow).T
    middle = [(matrix.T, bias[:, None]) for matrix, bias in network.middle]

    def rate(drive: jax.Array, state: jax.Array) -> jax.Array:
        values = activation(drive + along_hidden @ state)
        for matrix, bias in middle:
            values = activation(matrix @ values + bias)
        return values

    drive = from_area + per_case[:, :, None] + along_bias[:, None, None] * (z - z[0])
    return integrate_in_fixed_steps(rate, drive, z, config.flow.steps or 0, len(network.last))
