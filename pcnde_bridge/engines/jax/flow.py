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

from typing import Any

import diffrax
import jax
import jax.numpy as jnp

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.network import ACTIVATIONS, unpack
from pcnde_bridge.engines.jax.step_control import PIController
from pcnde_bridge.parameters import layer_sizes

_CHECKPOINTS = 16  # more than the steps of a usual solve, so that none is repeated


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
    solved : array of shape ()
        Whether the integration came to its end.
    """
    stage = config.flow
    activation = ACTIVATIONS[stage.activation]
    n_times, n_points = inflow.shape[1], z.shape[0]
    layers = unpack(parameters, layer_sizes("flow", config, n_times, n_points))
    (first, first_bias), *middle, (last, last_bias) = layers
    from_flow = first[:n_times]
    on_grid = jnp.moveaxis(area, 2, 0) @ first[n_times:] + first_bias + inflow @ from_flow
    along_bias, along_hidden = last_bias @ from_flow, last @ from_flow

    def hidden(position: Any, state: jax.Array, _: None) -> jax.Array:
        i = jnp.clip(jnp.searchsorted(z, position, side="right") - 1, 0, n_points - 2)
        share = (position - z[i]) / (z[i + 1] - z[i])
        drive = (1 - share) * on_grid[i] + share * on_grid[i + 1]
        distance = position - z[0]
        values = activation(drive + distance * along_bias + state @ along_hidden)
        for matrix, bias in middle:
            values = activation(values @ matrix + bias)
        return values

    def to_flow(distance: jax.Array, state: jax.Array) -> jax.Array:
        return inflow + distance * last_bias + state @ last

    def error_norm(
        z0: jax.Array, z1: jax.Array, y0: jax.Array, y1: jax.Array, error: jax.Array
    ) -> jax.Array:
        size = jnp.maximum(jnp.abs(to_flow(z0 - z[0], y0)), jnp.abs(to_flow(z1 - z[0], y1)))
        scaled = (error @ last) / (stage.atol + stage.rtol * size)
        mean = jnp.sum(weight[:, None] * scaled**2) / (jnp.sum(weight) * n_times)
        return jnp.sqrt(mean)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(hidden),
        diffrax.Tsit5(),
        z[0],
        z[-1],
        (z[1] - z[0]) if stage.first_step is None else stage.first_step,
        jnp.zeros((inflow.shape[0], last.shape[0])),
        saveat=diffrax.SaveAt(ts=z),
        stepsize_controller=PIController(error_norm),
        adjoint=diffrax.RecursiveCheckpointAdjoint(checkpoints=_CHECKPOINTS),
        max_steps=stage.max_steps,
        throw=False,
    )
    flow = (
        inflow[:, :, None]
        + last_bias[:, None] * (z - z[0])
        + jnp.einsum("znh,ht->ntz", solution.ys, last)
    )
    solved = (solution.result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(flow))
    return flow, solved
