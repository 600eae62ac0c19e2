"""Step size controller of DifferentialEquations.jl's Tsit5, for diffrax.

With it both engines take the same steps, so that their results agree far below the
tolerance of the solve.  It is the proportional-integral controller of Hairer and Wanner
(Solving Ordinary Differential Equations II, section IV.2) with the exponents 7/50 and 2/25.
It differs from diffrax's controller in the error assumed before the first step and after
a rejected step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

_BETA1, _BETA2 = 7 / 50, 2 / 25
_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 10.0
_FIRST_ERROR = 1e-4


class PIController(diffrax.AbstractStepSizeController[Any, Any]):
    """Proportional-integral controller for an error measured by ``error_norm``.

    Attributes
    ----------
    error_norm : callable
        ``(t0, t1, y0, y1, y_error) -> scalar``; a step with at most 1 is accepted.
    """

    error_norm: Callable[..., jax.Array]

    def wrap(self, direction: Any) -> PIController:
        """Return the controller for an integration in the given direction."""
        return self

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, dt0: Any, *_: Any) -> tuple[Any, Any]:
        """Return the end of the first step, and the error assumed before it."""
        return t0 + dt0, jnp.asarray(_FIRST_ERROR)

    def adapt_step_size(self, t0: Any, t1: Any, y0: Any, y1: Any, *others: Any) -> Any:
        """Accept or reject the step, and choose the next."""
        _, y_error, _, previous = others
        error = jax.lax.stop_gradient(self.error_norm(t0, t1, y0, y1, y_error))
        accept = error <= 1
        proportional = error**_BETA1
        # The factor is the largest for an error of zero, and the smallest for NaN.
        accepted = jnp.clip(
            _SAFETY * previous**_BETA2 / jnp.maximum(proportional, 1e-300), _SHRINK, _GROW
        )
        rejected = jnp.maximum(_SAFETY / proportional, _SHRINK)
        factor = jnp.where(accept, accepted, rejected)
        factor = jax.lax.stop_gradient(jnp.where(jnp.isfinite(factor), factor, _SHRINK))
        next_t0 = jnp.where(accept, t1, t0)
        next_t1 = next_t0 + factor * (t1 - t0)
        state = jnp.where(accept, jnp.maximum(error, _FIRST_ERROR), previous)
        return accept, next_t0, next_t1, False, state, diffrax.RESULTS.successful
