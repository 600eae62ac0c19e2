"""Momentum equation ∂Q/∂z = f_θ(Q, S) as a neural ODE in z (diffrax, Tsit5).

The last layer of f_θ is linear, f = W·h(Q, S) + b, so the solution is

    Q(z) = Q_in + z·b + W·H(z),   dH/dz = h(Q, S),   H(0) = 0,

with H as wide as the last hidden layer (8 in the paper) in place of Q's n_t
instants.  Runge–Kutta steps, their error estimate and their interpolation are
affine in the state, so stepping H gives the same Q as stepping Q, number by
number but for round-off, at a tenth of the work.  The error is measured on Q.
The area's part of the first layer is linear in S, and S is linear in z between
grid points, so that part is computed once on the grid and interpolated.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.adaptive_tsit5 import Here, march
from pcnde_bridge.engines.jax.fixed_step_tsit5 import integrate
from pcnde_bridge.engines.jax.mlp import ACTIVATIONS, unpack
from pcnde_bridge.engines.parameters import layer_sizes


class FlowNetwork(NamedTuple):
    """f_θ taken apart: what its first layer makes of Q and S, the middle, the last layer.

    Attributes
    ----------
    from_flow, from_area : array of shape (time, hidden)
        Weights of the first layer.
    first_bias : array of shape (hidden,)
        Its bias.
    middle : list of (matrix, bias)
        The hidden layers between.
    last, last_bias : array of shape (hidden, time) and (time,)
        W (transposed) and b of the linear last layer.
    """

    from_flow: jax.Array
    from_area: jax.Array
    first_bias: jax.Array
    middle: list[tuple[jax.Array, jax.Array]]
    last: jax.Array
    last_bias: jax.Array


def take_apart(parameters: jax.Array, n_times: int, config: PCNDEConfig) -> FlowNetwork:
    """Read the network from its parameter vector."""
    widths = layer_sizes("flow", config, n_times, 0)
    (first, first_bias), *middle, (last, last_bias) = unpack(parameters, widths)
    return FlowNetwork(first[:n_times], first[n_times:], first_bias, middle, last, last_bias)


def solve(
    parameters: jax.Array,
    inflow: jax.Array,
    area: jax.Array,
    weight: jax.Array,
    z: jax.Array,
    config: PCNDEConfig,
) -> tuple[jax.Array, jax.Array]:
    """Integrate cases with common steps.

    Parameters
    ----------
    parameters : array of shape (size,)
        The network.
    inflow : array of shape (case, time)
        Q_in, mL/s.
    area : array of shape (case, time, z)
        S, cm².
    weight : array of shape (case,)
        1, or 0 for a case that only fills a batch and must not steer the steps.
    z : array of shape (z,)
        Points of the result, cm.
    config : PCNDEConfig
        Network and tolerances.

    Returns
    -------
    flow : array of shape (case, time, z)
        Q, mL/s.
    solved : array of shape (case,)
        Whether the integration came to its end.
    """
    network = take_apart(parameters, inflow.shape[1], config)
    if config.flow.steps is not None:
        return _solve_in_equal_steps(network, inflow, area, z, config)
    from_area = jnp.einsum("ntz,th->nzh", area, network.from_area)
    hidden, solved = solve_hidden(network, inflow, from_area, weight, z, config)
    flow = (
        inflow[:, :, None]
        + network.last_bias[:, None] * (z - z[0])
        + jnp.einsum("nzh,ht->ntz", hidden, network.last)
    )
    return flow, solved


def solve_hidden(
    network: FlowNetwork,
    inflow: jax.Array,
    from_area: jax.Array,
    weight: jax.Array,
    z: jax.Array,
    config: PCNDEConfig,
) -> tuple[jax.Array, jax.Array]:
    """Integrate dH/dz = h, with the error measured on Q.

    Parameters
    ----------
    network : FlowNetwork
        f_θ.
    inflow : array of shape (case, time)
        Q_in, mL/s.
    from_area : array of shape (case, z, hidden)
        The area's part of the first layer, at the points.
    weight, z, config
        As in :func:`solve`.

    Returns
    -------
    hidden : array of shape (case, z, hidden)
        H at the points.
    solved : array of shape (case,)
        Whether the integration came to its end.
    """
    if config.flow.steps is not None:
        state = _in_equal_steps(network, inflow, jnp.moveaxis(from_area, 2, 0), z, config)
        return jnp.moveaxis(state, 0, 2), _all_finite(state)
    stage = config.flow
    activation = ACTIVATIONS[stage.activation]
    last, last_bias = network.last, network.last_bias
    on_grid = jnp.moveaxis(from_area, 1, 0) + network.first_bias + inflow @ network.from_flow
    along_bias, along_hidden = last_bias @ network.from_flow, last @ network.from_flow

    def rate(here: Here, position: jax.Array, state: jax.Array) -> jax.Array:
        values = activation(here(on_grid) + (position - z[0]) * along_bias + state @ along_hidden)
        for matrix, bias in network.middle:
            values = activation(values @ matrix + bias)
        return values

    def size_of_flow(position: jax.Array, state: jax.Array) -> jax.Array:
        return jnp.abs(inflow + (position - z[0]) * last_bias + state @ last)

    def scaled_error(
        z0: jax.Array, z1: jax.Array, y0: jax.Array, y1: jax.Array, error: jax.Array
    ) -> jax.Array:
        size = jnp.maximum(size_of_flow(z0, y0), size_of_flow(z1, y1))
        return (error @ last) / (stage.atol + stage.rtol * size)

    start = jnp.zeros((inflow.shape[0], last.shape[0]))
    hidden, solved = march(rate, scaled_error, start, weight, z, stage)
    return jnp.moveaxis(hidden, 0, 1), solved


def _solve_in_equal_steps(
    network: FlowNetwork, inflow: jax.Array, area: jax.Array, z: jax.Array, config: PCNDEConfig
) -> tuple[jax.Array, jax.Array]:
    """See :func:`solve`; each product is made case by case, as the arrays lie in memory."""
    n_cases = inflow.shape[0]

    def for_each_case(matrix: jax.Array) -> jax.Array:
        return jnp.broadcast_to(matrix, (n_cases, *matrix.shape))

    from_area = for_each_case(network.from_area.T) @ area
    hidden = _in_equal_steps(network, inflow, jnp.moveaxis(from_area, 1, 0), z, config)
    flow = (
        inflow[:, :, None]
        + network.last_bias[:, None] * (z - z[0])
        + for_each_case(network.last.T) @ jnp.moveaxis(hidden, 0, 1)
    )
    return flow, _all_finite(hidden)


def _all_finite(hidden: jax.Array) -> jax.Array:
    """Whether H (hidden, case, z) is finite, case by case."""
    return jnp.all(jnp.isfinite(hidden), axis=(0, 2))


def _in_equal_steps(
    network: FlowNetwork, inflow: jax.Array, from_area: jax.Array, z: jax.Array, config: PCNDEConfig
) -> jax.Array:
    """H at the points from the area's part of the first layer; both (hidden, case, z)."""
    activation = ACTIVATIONS[config.flow.activation]
    of_case = (network.first_bias + inflow @ network.from_flow).T
    along_bias = network.last_bias @ network.from_flow
    along_hidden = (network.last @ network.from_flow).T
    middle = [(matrix.T, bias[:, None]) for matrix, bias in network.middle]

    def rate(drive: jax.Array, state: jax.Array) -> jax.Array:
        values = activation(drive + along_hidden @ state)
        for matrix, bias in middle:
            values = activation(matrix @ values + bias)
        return values

    drive = from_area + of_case[:, :, None] + along_bias[:, None, None] * (z - z[0])
    return integrate(rate, drive, z, config.flow.steps or 0, len(network.last))
