"""Integration along the vessel by Tsit5 of diffrax, for the momentum equation."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from pcnde_bridge.config.settings import FlowStage

_CHECKPOINTS = 16  # more than the steps of a usual solve, so that none is recomputed

Interpolate = Callable[[jax.Array], jax.Array]
"""Interpolates values at the points, (z, ...), linearly to one position."""


def integrate(
    rate: Callable[[Interpolate, jax.Array, jax.Array], jax.Array],
    flow: Callable[[jax.Array, jax.Array], jax.Array],
    flow_error: Callable[[jax.Array], jax.Array],
    start: jax.Array,
    weight: jax.Array,
    z: jax.Array,
    stage: FlowStage,
) -> jax.Array:
    """Integrate cases with common steps.

    Parameters
    ----------
    rate : callable
        ``(interpolate, z, state)``: the state's derivative with respect to z, (case, number).
    flow : callable
        ``(z, state)``: Q, (case, time), on which the error is measured.
    flow_error : callable
        ``(error)``: error of Q, (case, time), from the error of the state.
    start : array of shape (case, number)
        State at the first point.
    weight : array of shape (case,)
        1, or 0 for a case that pads a batch and must not influence the steps.
    z : array of shape (z,)
        Points, cm.
    stage : FlowStage
        Tolerances and steps.

    Returns
    -------
    array of shape (z, case, number)
        States at the points; infinite where the integration did not reach them.
    """
    import diffrax  # takes long, and not every model needs it

    from pcnde_bridge.engines.jax.pi_controller import PIController

    def slope(position: Any, state: jax.Array, _: None) -> jax.Array:
        i = jnp.clip(jnp.searchsorted(z, position, side="right") - 1, 0, z.size - 2)
        share = (position - z[i]) / (z[i + 1] - z[i])
        return rate(lambda at: (1 - share) * at[i] + share * at[i + 1], position, state)

    def error_norm(
        z0: jax.Array, z1: jax.Array, state0: jax.Array, state1: jax.Array, error: jax.Array
    ) -> jax.Array:
        size = jnp.maximum(jnp.abs(flow(z0, state0)), jnp.abs(flow(z1, state1)))
        scaled = flow_error(error) / (stage.atol + stage.rtol * size)
        mean = jnp.sum(weight[:, None] * scaled**2) / (jnp.sum(weight) * scaled.shape[1])
        return jnp.sqrt(mean)

    if stage.steps is None:
        first_step = (z[1] - z[0]) if stage.first_step is None else stage.first_step
        control: diffrax.AbstractStepSizeController[Any, Any] = PIController(error_norm)
        most = stage.max_steps
    else:
        first_step = (z[-1] - z[0]) / stage.steps
        # One more step, for round-off in their sum.
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
    return solution.ys
