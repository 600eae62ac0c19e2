"""L-BFGS with weight decay and early stopping, with which preset ``fast`` fits a network."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

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
    run = _Run(objective, start, settings, iterations, unit, validate, on_iteration, first)
    lbfgs(run.evaluate, start, settings.memory, iterations, run.accept)
    return run.result()


@dataclass
class _Run:
    """State of one minimization: the last iterate, and the best one by the validation error."""

    objective: Objective
    start: Array
    settings: FullBatch
    iterations: int
    unit: float
    validate: Callable[[Array], float] | None
    on_iteration: OnIteration | None
    first: float

    def __post_init__(self) -> None:
        decay = self.settings.weight_decay * float(self.start @ self.start)
        self._ceiling = _DIVERGED * (self.first / self.unit + decay)
        self._losses, self._last = [self.first], self.start
        self._best, self._best_error, self._best_number = self.start, math.inf, 0
        self._validated = 0  # number of the last validated iterate
        self._message = ""

    def evaluate(self, x: Array) -> tuple[float, Array]:
        """Return the function to minimize, always finite, and its gradient."""
        loss, gradient = self.objective(x)
        if not (math.isfinite(loss) and np.isfinite(gradient).all()):
            # A wall that rises from the last iterate on.
            way = x - self._last
            return self._ceiling, way * (2 * self._ceiling / max(float(way @ way), _TINY))
        decay = self.settings.weight_decay
        return loss / self.unit + decay * float(x @ x), gradient / self.unit + 2 * decay * x

    def accept(self, x: Array, value: float) -> None:
        """Take an iterate; raise StopIteration once the validation error falls no more."""
        number, self._last = len(self._losses), x
        loss = (value - self.settings.weight_decay * float(x @ x)) * self.unit
        self._losses.append(loss)
        if self.on_iteration is not None:
            self.on_iteration(number, loss)
        if self.validate is None:
            self._best = x
        elif number % self.settings.check_every == 0 or number == self.iterations:
            error, self._validated = self.validate(x), number
            if error < self._best_error:
                self._best, self._best_error, self._best_number = x, error, number
            elif number - self._best_number >= self.settings.patience:
                self._message = "validation error falls no more"
                raise StopIteration

    def result(self) -> Fit:
        """Return the best iterate, and why the minimization ended."""
        number = len(self._losses) - 1
        # L-BFGS may have converged between two validations.
        validate = self.validate if self._validated < number else None
        if validate is not None and validate(self._last) < self._best_error:
            self._best = self._last
        if not self._message and number >= self.iterations:
            self._message = "all iterations done"
        converged = not self._message
        message = self._message or "loss falls no more"
        return Fit(self._best, np.array(self._losses), converged, message)
