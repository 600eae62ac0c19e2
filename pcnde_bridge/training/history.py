"""History of a training run: one record for every iteration of the optimizer."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from pcnde_bridge._typing import AnyArray, Array
from pcnde_bridge.engines.closure_parameters import CLOSURES
from pcnde_bridge.engines.parameters import STAGES
from pcnde_bridge.engines.types import Fit, ignore
from pcnde_bridge.engines.types import OnIteration as OnLoss

# Files store a stage as its position in this order.
_ORDER = (*STAGES, *CLOSURES)


class Iteration(NamedTuple):
    """One iteration of the optimizer.

    Attributes
    ----------
    stage : str
        One of the paper's five stages, or a closure of the ``physics`` preset.
    epoch, batch, iteration : int
        Counted from 1; the pressure stages have epoch and batch 1.  With preset ``fast`` the
        epoch is the round, and the batch numbers the flow's fits: one for each start on the
        reference flow, then those through the equation.
    loss : float
        Loss after the iteration: mL²/s² for flow (in the mean), cm⁴ for area, p_ref² for
        pressure; closures have the relative squared error.
    seconds : float
        Time since training began, over all runs that a checkpoint joins.
    outcome : str
        At the last iteration of a fit, how it ended, such as ``"converged: gradient
        tolerance"`` or ``"stopped: all iterations done"``; empty before.
    """

    stage: str
    epoch: int
    batch: int
    iteration: int
    loss: float
    seconds: float
    outcome: str = ""


OnIteration = Callable[[Iteration], None]
"""Callback with every iteration; it may raise to stop."""

RunFit = Callable[[str, int, int, Callable[[OnLoss], Fit]], Array]
"""Signature of :meth:`Recorder.run`."""


def to_frame(history: Sequence[Iteration]) -> pd.DataFrame:
    """Return the history as a frame with one row for every iteration."""
    return pd.DataFrame(list(history), columns=list(Iteration._fields))


def to_arrays(history: Sequence[Iteration]) -> dict[str, AnyArray]:
    """Return the history as arrays for a file.

    Returns
    -------
    dict of arrays
        ``history``, shape (iteration, 6), with the stage as its position in a fixed order,
        and ``history_outcomes``, ASCII text of shape (iteration,).
    """
    rows = [(_ORDER.index(r.stage), *r[1:-1]) for r in history]
    numbers = np.array(rows, dtype=np.float64).reshape(len(rows), len(Iteration._fields) - 1)
    return {"history": numbers, "history_outcomes": np.array([r.outcome for r in history], "S")}


def from_arrays(arrays: Mapping[str, AnyArray]) -> tuple[Iteration, ...]:
    """Return the history of a file; older files have no outcomes.

    Raises
    ------
    KeyError, TypeError, ValueError, IndexError
        If the arrays are missing or do not hold a history.
    """
    numbers = arrays["history"]
    outcomes = arrays.get("history_outcomes", np.full(len(numbers), b"", "S"))
    return tuple(
        Iteration(_ORDER[int(s)], int(e), int(b), int(i), float(loss), float(t), end.decode())
        for (s, e, b, i, loss, t), end in zip(numbers, outcomes, strict=True)
    )


@dataclass
class Recorder:
    """Iterations of one training step, passed on as they come.

    Attributes
    ----------
    began : float
        Time (``time.perf_counter``) at which training began.
    on_iteration, on_fit_end : callable
        Called with every :class:`Iteration`, which may raise to stop, and with the outcome of
        every fit.
    iterations : list of Iteration
        All iterations so far.
    """

    began: float
    on_iteration: OnIteration = ignore
    on_fit_end: Callable[[str], None] = ignore
    iterations: list[Iteration] = field(default_factory=list)

    def run(self, stage: str, epoch: int, batch: int, fit: Callable[[OnLoss], Fit]) -> Array:
        """Run one fit, record it, and return its parameters.

        Parameters
        ----------
        stage, epoch, batch
            Fields of the fit's iterations.
        fit : callable
            Runs the optimizer with the given ``on_iteration``.
        """
        first = len(self.iterations)

        def on_iteration(number: int, loss: float) -> None:
            seconds = time.perf_counter() - self.began
            self.iterations.append(Iteration(stage, epoch, batch, number, loss, seconds))
            self.on_iteration(self.iterations[-1])

        found = fit(on_iteration)
        outcome = f"{'converged' if found.converged else 'stopped'}: {found.message}"
        if len(self.iterations) > first:
            self.iterations[-1] = self.iterations[-1]._replace(outcome=outcome)
        self.on_fit_end(outcome)
        return found.parameters
