"""What happened in training: one record for every iteration of the optimizer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge.engines.closure_parameters import CLOSURES
from pcnde_bridge.engines.parameters import STAGES

# Files keep a stage as its place in this order.
_ORDER = (*STAGES, *CLOSURES)


class Iteration(NamedTuple):
    """One iteration of the optimizer.

    Attributes
    ----------
    stage : str
        One of the paper's five stages, or a closure of the ``physics`` preset.
    epoch, batch, iteration : int
        Counted from 1; the pressure stages have epoch and batch 1.  Of preset ``fast``
        the epoch is the round, and the batch of the flow the start, then the equation.
    loss : float
        After the iteration: mL²/s² for flow (in the mean), cm⁴ for area,
        p_ref² for pressure.
    seconds : float
        Since training began, over all runs that a checkpoint joins.
    """

    stage: str
    epoch: int
    batch: int
    iteration: int
    loss: float
    seconds: float


OnRecord = Callable[[Iteration], None]
"""Called with every iteration as it comes."""


def to_frame(history: Sequence[Iteration]) -> pd.DataFrame:
    """History as a frame with one row for every iteration."""
    return pd.DataFrame(list(history), columns=list(Iteration._fields))


def to_array(history: Sequence[Iteration]) -> npt.NDArray[np.float64]:
    """History as numbers, (iteration, field); the stage as its place in the order."""
    rows = [(_ORDER.index(r.stage), *r[1:]) for r in history]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(Iteration._fields))


def from_array(array: npt.NDArray[np.float64]) -> list[Iteration]:
    """Inverse of :func:`to_array`."""
    return [
        Iteration(_ORDER[int(s)], int(e), int(b), int(i), float(loss), float(seconds))
        for s, e, b, i, loss, seconds in array
    ]


class Recorder:
    """Keeps the iterations of one unit, and passes each on as it comes."""

    def __init__(self, began: float, on_record: OnRecord | None) -> None:
        self.iterations: list[Iteration] = []
        self._began = began
        self._on_record = on_record

    def __call__(self, stage: str, epoch: int, batch: int) -> Callable[[int, float], None]:
        """Return what an engine calls with each iteration's number and loss."""

        def on_iteration(number: int, loss: float) -> None:
            seconds = time.perf_counter() - self._began
            self.iterations.append(Iteration(stage, epoch, batch, number, loss, seconds))
            if self._on_record is not None:
                self._on_record(self.iterations[-1])

        return on_iteration
