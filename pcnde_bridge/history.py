"""What happened in training: one record for every iteration of the optimiser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge.parameters import STAGES


class Iteration(NamedTuple):
    """One iteration of the optimiser.

    Attributes
    ----------
    stage : str
        One of the five stages.
    epoch, batch, iteration : int
        Counted from 1; the pressure stages have epoch and batch 1.
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


def to_frame(history: Sequence[Iteration]) -> pd.DataFrame:
    """History as a frame with one row for every iteration."""
    return pd.DataFrame(list(history), columns=list(Iteration._fields))


def to_array(history: Sequence[Iteration]) -> npt.NDArray[np.float64]:
    """History as numbers, (iteration, field); the stage as its place in the order."""
    rows = [(STAGES.index(r.stage), *r[1:]) for r in history]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(Iteration._fields))


def from_array(array: npt.NDArray[np.float64]) -> list[Iteration]:
    """Inverse of :func:`to_array`."""
    return [
        Iteration(STAGES[int(s)], int(e), int(b), int(i), float(loss), float(seconds))
        for s, e, b, i, loss, seconds in array
    ]
