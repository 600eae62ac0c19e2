"""L-BFGS with weight decay and early stopping, with which preset ``fast`` fits a network."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import FullBatch
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
    validate: Callable[[Array], float] | None = None,
    on_iteration: OnIteration | None = None,
    *,
    lbfgs: LBFGS,
) -> Fit:
    """Minimize objective(x)/unit + weight_decay·|x|².

    Parameters
    ----------
    objective : callable
        Loss and gradient.  Where the loss is not finite the step is shortened.
    start : array of shape (n,)
        First iterate.
    settings : FullBatch
        Memory, weight decay and patience.
    iterations : int
        Largest number of iterations.
    unit : float
        Size of the loss, relative to which the weight decay is measured.
    validate : callable, optional
        Error on cases that the objective does not contain, evaluated every few iterations;
        the fit ends once it has not fallen for ``settings.patience`` iterations.
    on_iteration : callable, optional
        Called with the number and loss of each iteration; may raise to stop.
    lbfgs : callable
        Runs the iterations; see :meth:`pcnde_bridge.engines.protocol.Engine.lbfgs`.

    Returns
    -------
    Fit
        The iterate of the smallest validation error, or the last one.

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
    decay = settings.weight_decay
    ceiling = _DIVERGED * (first / unit + decay * float(start @ start))
    losses, last, validated = [first], start, 0
    best, best_error, best_number = start, math.inf, 0
    message = ""

    def total(x: Array) -> tuple[float, Array]:
        loss, gradient = objective(x)
        if not (math.isfinite(loss) and np.isfinite(gradient).all()):
            # A wall that rises from the last iterate on.
            way = x - last
            return ceiling, way * (2 * ceiling / max(float(way @ way), _TINY))
        return loss / unit + decay * float(x @ x), gradient / unit + 2 * decay * x

    def accept(x: Array, value: float) -> None:
        nonlocal last, validated, best, best_error, best_number, message
        number, last = len(losses), x
        losses.append((value - decay * float(x @ x)) * unit)
        if on_iteration is not None:
            on_iteration(number, losses[-1])
        if validate is None:
            best = x
        elif number % settings.check_every == 0 or number == iterations:
            error, validated = validate(x), number
            if error < best_error:
                best, best_error, best_number = x, error, number
            elif number - best_number >= settings.patience:
                message = "validation error falls no more"
                raise StopIteration

    lbfgs(total, start, settings.memory, iterations, accept)
    number = len(losses) - 1
    # L-BFGS may have converged between two validations.
    if validate is not None and validated < number and validate(last) < best_error:
        best = last
    if not message and number >= iterations:
        message = "all iterations done"
    return Fit(best, np.array(losses), not message, message or "loss falls no more")
