"""SciPy's L-BFGS with weight decay, with which preset ``fast`` fits a network."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.engines.types import (
    Fit,
    Objective,
    OnIteration,
    check_start,
    ignore,
    is_finite,
)

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

_DIVERGED = 10.0  # loss of a diverging trial step, relative to the first loss
_TINY = 1e-300


class Options(NamedTuple):
    """Options of :func:`minimize`.

    Attributes
    ----------
    memory : int
        Pairs of steps and gradient changes that L-BFGS stores.
    weight_decay : float
        Factor of the squared parameters.
    iterations : int
        Largest number of iterations.
    unit : float
        Size of the loss, relative to which the weight decay is measured.
    """

    memory: int
    weight_decay: float
    iterations: int
    unit: float


def minimize(
    objective: Objective,
    start: Array,
    options: Options,
    on_iteration: OnIteration = ignore,
) -> Fit:
    """Minimize objective(x)/unit + weight_decay·|x|².

    Parameters
    ----------
    objective : callable
        Loss and gradient.  Where the loss is not finite the step is shortened.
    start : array of shape (n,)
        First iterate.
    options : Options
        Unit of the loss, weight decay, and limits of the search.
    on_iteration : callable
        Called with the number and loss of each iteration; may raise to stop.

    Raises
    ------
    SolveError
        If the loss is not finite at the start.
    """
    from scipy.optimize import minimize as minimize_by_scipy

    memory, decay, iterations, unit = options
    first, gradient = objective(start)
    check_start(first, gradient)
    losses, last = [first], start
    ceiling = _DIVERGED * (first / unit + decay * float(start @ start))

    def evaluate(x: Array) -> tuple[float, Array]:
        loss, gradient = objective(x)
        if not is_finite(loss, gradient):
            # A wall that rises from the last iterate on.
            way = x - last
            return ceiling, way * (2 * ceiling / max(float(way @ way), _TINY))
        return loss / unit + decay * float(x @ x), gradient / unit + 2 * decay * x

    def accept(intermediate_result: OptimizeResult) -> None:
        nonlocal last
        last = intermediate_result.x.copy()
        losses.append((float(intermediate_result.fun) - decay * float(last @ last)) * unit)
        on_iteration(len(losses) - 1, losses[-1])

    limits = {"maxiter": iterations, "maxfun": 20 * iterations, "maxcor": memory}
    without_tolerances = {**limits, "ftol": 0.0, "gtol": 0.0}
    minimize_by_scipy(
        evaluate, start, jac=True, method="L-BFGS-B", callback=accept, options=without_tolerances
    )
    converged = len(losses) <= iterations
    message = "loss falls no more" if converged else "all iterations done"
    return Fit(last, np.array(losses), converged, message)
