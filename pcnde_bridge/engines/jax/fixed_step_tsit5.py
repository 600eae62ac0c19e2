"""Integration in fixed steps of Tsit5, for the momentum equation; it compiles in a second.

It integrates dH/dz = h of :mod:`pcnde_bridge.engines.jax.flow`.  Because the steps are known in
advance, everything independent of the state is computed for all steps in one matrix product each:
the drive at every stage, and the interpolant at every point.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge._typing import Array

# Coefficients of θ, θ², θ³, θ⁴ in the weights of the seven slopes (Tsitouras 2011).
# fmt: off
_INTERPOLANT = np.array([
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-2.763706197274826, 0.1317, 3.9302962368947516, -12.411077166933676,
     37.50931341651104, -27.896526289197286, 1.5],
    [2.9132554618219126, -0.2234, -5.941033872131505, 30.33818863028232,
     -88.1789048947664, 65.09189467479366, -4.0],
    [-1.0530884977290216, 0.1017, 2.490627285651253, -16.548102889244902,
     47.37952196281928, -34.87065786149661, 2.5],
])
# fmt: on


@cache
def _tableau() -> tuple[Array, Array]:
    """Return weights and positions of the slopes.

    Row i has the weights of the earlier slopes in the state where slope i + 1 is evaluated; the
    last row gives the state after the step.
    """
    import diffrax  # takes long, and not every model needs it

    tableau = diffrax.Tsit5.tableau
    weights = np.zeros((6, 7))
    for row, found in zip(weights, tableau.a_lower, strict=True):
        row[: len(found)] = found
    return weights, np.asarray(tableau.c)


def integrate(
    rate: Callable[[jax.Array, jax.Array], jax.Array],
    drive: jax.Array,
    z: jax.Array,
    steps: int,
    size: int,
) -> jax.Array:
    """Integrate dy/dz = rate(drive(z), y) from y = 0.

    Parameters
    ----------
    rate : callable
        Derivative (n, case) for a drive (m, case) and a state (n, case).
    drive : array of shape (m, case, z)
        Drive at the points; linear between them.
    z : array of shape (z,)
        Points, cm.
    steps : int
        Number of equal steps from the first point to the last.
    size : int
        n, the length of the state.

    Returns
    -------
    array of shape (n, case, z)
        y at the points.
    """
    of_slopes, positions = _tableau()
    step = (z[-1] - z[0]) / steps
    starts = z[0] + step * jnp.arange(steps)
    hats = _hat_functions(z, (starts[:, None] + step * positions).ravel())
    drives = jnp.einsum("mnz,zk->kmn", drive, hats)
    drives = drives.reshape(steps, len(positions), *drives.shape[1:])

    def advance(
        before: tuple[jax.Array, jax.Array], drives: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        state, slope = before

        def stage(slopes: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
            number, weights, at_stage = row
            now = state + step * jnp.tensordot(weights, slopes, 1)
            return slopes.at[number].set(rate(at_stage, now)), now

        # A loop, so that the rate is compiled once instead of six times.
        slopes = jnp.zeros((7, *state.shape)).at[0].set(slope)
        slopes, states = jax.lax.scan(stage, slopes, (jnp.arange(1, 7), of_slopes, drives))
        return (states[-1], slopes[-1]), jnp.concatenate([state[None], slopes])

    nothing = jnp.zeros((size, drive.shape[1]))
    first = nothing, rate(drive[:, :, 0], nothing)
    _, stored = jax.lax.scan(advance, first, drives)
    step_of = jnp.clip(jnp.searchsorted(starts, z, side="right") - 1, 0, steps - 1)
    share = (z - starts[step_of]) / step
    weights = step * (share[:, None] ** jnp.arange(1, 5)) @ _INTERPOLANT
    weights = jnp.concatenate([jnp.ones_like(weights[:, :1]), weights], axis=1)
    matrix = jax.nn.one_hot(step_of, steps)[:, :, None] * weights[:, None, :]
    return jnp.einsum("zjk,jkmn->mnz", matrix, stored)


def _hat_functions(z: jax.Array, positions: jax.Array) -> jax.Array:
    """Return the matrix (z, position) that interpolates linearly between the points."""
    i = jnp.clip(jnp.searchsorted(z, positions, side="right") - 1, 0, z.shape[0] - 2)
    share = (positions - z[i]) / (z[i + 1] - z[i])
    points = jnp.arange(z.shape[0])[:, None]
    return (1 - share) * (points == i) + share * (points == i + 1)
