"""A state taken along the vessel by Tsit5, as the momentum equation asks for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

from pcnde_bridge.config import FlowStage
from pcnde_bridge.engines.jax.pi_controller import PIController

_CHECKPOINTS = 16  # more than the steps of a usual solve, so that none is repeated

Here = Callable[[jax.Array], jax.Array]
"""Takes values at the points, (z, ...), returns them at one place, linear between."""


def march(
    rate: Callable[[Here, jax.Array, jax.Array], jax.Array],
    scaled_error: Callable[..., jax.Array],
    start: jax.Array,
    weight: jax.Array,
    z: jax.Array,
    stage: FlowStage,
) -> tuple[jax.Array, jax.Array]:
    """Integrate cases with common steps.

    Parameters
    ----------
    rate : callable
        ``(here, z, state)``: the state's derivative by z, (case, number).
    scaled_error : callable
        ``(z0, z1, state0, state1, error)``: error of a step over what is tolerated,
        (case, time).
    start : array of shape (case, number)
        State at the first point.
    weight : array of shape (case,)
        1, or 0 for a case that only fills a batch and must not steer the steps.
    z : array of shape (z,)
        Points, cm.
    stage : FlowStage
        Tolerances and steps.

    Returns
    -------
    states : array of shape (z, case, number)
        At the points.
    solved : array of shape (case,)
        Whether the integration came to its end.
    """

    def slope(position: Any, state: jax.Array, _: None) -> jax.Array:
        i = jnp.clip(jnp.searchsorted(z, position, side="right") - 1, 0, z.size - 2)
        share = (position - z[i]) / (z[i + 1] - z[i])
        return rate(lambda at: (1 - share) * at[i] + share * at[i + 1], position, state)

    def error_norm(*step: jax.Array) -> jax.Array:
        scaled = scaled_error(*step)
        mean = jnp.sum(weight[:, None] * scaled**2) / (jnp.sum(weight) * scaled.shape[1])
        return jnp.sqrt(mean)

    if stage.steps is None:
        first_step = (z[1] - z[0]) if stage.first_step is None else stage.first_step
        control: diffrax.AbstractStepSizeController[Any, Any] = PIController(error_norm)
        most = stage.max_steps
    else:
        first_step = (z[-1] - z[0]) / stage.steps
        # One more than the steps, for round-off in their sum.
        control, most = diffrax.ConstantStepSize(), stage.steps + 1
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(slope),
        diffrax.Tsit5(),
        z[0],
        z[-1],
        first_step,
        start,
        saveat=diffrax.SaveAt(ts=z),
        stepsize_controller=control,
        adjoint=diffrax.RecursiveCheckpointAdjoint(checkpoints=_CHECKPOINTS),
        max_steps=most,
        throw=False,
    )
    finite = jnp.all(jnp.isfinite(solution.ys), axis=(0, 2))
    return solution.ys, (solution.result == diffrax.RESULTS.successful) & finite
