"""L-BFGS with weight decay, with which preset ``fast`` fits a network."""

from __future__ import annotations

import math

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config.settings import FullBatch
from pcnde_bridge.engines.types import LBFGS, Fit, Objective, OnIteration
from pcnde_bridge.errors import SolveError

_DIVERGED = 10.0  # loss of a diverging trial step, relative to the first loss
_TINY = 1e-300


def minimize(
    objective: Objective,
    start: Array,
    settings: FullBatch,
    iterations: int,
    unit: float,
    lbfgs: LBFGS,
    on_iteration: OnIteration | None = None,
) -> Fit:
    """Minimize objective(x)/unit + weight_decay·|x|².

    Parameters
    ----------
    objective : callable
        Loss and gradient.  Where the loss is not finite the step is shortened.
    start : array of shape (n,)
        First iterate.
    settings : FullBatch
        Memory and weight decay.
    iterations : int
        Largest number of iterations.
    unit : float
        Size of the loss, relative to which the weight decay is measured.
    lbfgs : callable
        Runs the iterations; see :meth:`pcnde_bridge.engines.protocol.Engine.lbfgs`.
    on_iteration : callable, optional
        Called with the number and loss of each iteration; may raise to stop.

    Raises
    ------
    SolveError
        If the loss is not finite at the start.
    """
    first, _ = objective(start)
    if not math.isfinite(first):
        raise SolveError(
            f"The loss is not finite at the first parameters of the fit (loss {first}): the "
            "equation diverges there. Check the data's units, or start from another seed."
        )
    decay, losses, last = settings.weight_decay, [first], start
    ceiling = _DIVERGED * (first / unit + decay * float(start @ start))

    def evaluate(x: Array) -> tuple[float, Array]:
        loss, gradient = objective(x)
        if not (math.isfinite(loss) and np.isfinite(gradient).all()):
            # A wall that rises from the last iterate on.
            way = x - last
            return ceiling, way * (2 * ceiling / max(float(way @ way), _TINY))
        return loss / unit + decay * float(x @ x), gradient / unit + 2 * decay * x

    def accept(x: Array, value: float) -> None:
        nonlocal last
        last = x
        losses.append((value - decay * float(x @ x)) * unit)
        if on_iteration is not None:
            on_iteration(len(losses) - 1, losses[-1])

    lbfgs(evaluate, start, settings.memory, iterations, accept)
    converged = len(losses) <= iterations
    message = "loss falls no more" if converged else "all iterations done"
    return Fit(last, np.array(losses), converged, message)
