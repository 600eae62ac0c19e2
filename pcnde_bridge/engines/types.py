"""Arrays that go into the stages of an engine and come out of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from pcnde_bridge._typing import Array, BoolArray, IntArray
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.errors import SolveError

Result = TypeVar("Result")

OnIteration = Callable[[int, float], None]
"""Callback with an iteration's number, from 1, and its loss; it may raise to stop."""

Objective = Callable[[Array], tuple[float, Array]]
"""Loss and gradient at a parameter vector; the loss is infinite where the equation diverges."""

StageInputs = tuple[Array, ...]
"""Inputs of a stage, see :class:`pcnde_bridge.engines.protocol.Engine`; each (case, ...)."""

Problem = Callable[[Array], tuple[Array, Array]]
"""Value of a closure and its Jacobian (one more axis) at the closure's parameters."""


def ignore(*_: object) -> None:
    """Do nothing: the default callback."""


def is_finite(loss: float, gradient: Array) -> bool:
    """Return whether a loss and its gradient are finite."""
    return math.isfinite(loss) and bool(np.isfinite(gradient).all())


def check_start(loss: float, gradient: Array) -> None:
    """Raise SolveError unless loss and gradient are finite where a fit starts."""
    if not is_finite(loss, gradient):
        raise SolveError(
            f"The loss is not finite at the first parameters of the fit (loss {loss}): the "
            "equation diverges there. Check the data's units, or start from another seed."
        )


def solve_most(solve: Callable[[IntArray], Result], count: int) -> tuple[Result, BoolArray]:
    """Solve rows, with another in place of each that fails.

    Parameters
    ----------
    solve : callable
        Takes the indices of rows, always as many.
    count : int
        Number of rows.

    Returns
    -------
    result : object
        What ``solve`` returns.
    failed : array of bool, shape (count,)
        Rows whose results are those of another row.

    Raises
    ------
    SolveError
        If all rows fail, or it is not known which do.
    """
    rows, failed = np.arange(count), np.zeros(count, dtype=bool)
    while True:
        try:
            return solve(rows), failed
        except SolveError as error:
            failed[rows[list(error.cases)]] = True
            if not error.cases or failed.all():
                raise
            rows[failed] = np.argmin(failed)


class ModelInputs(NamedTuple):
    """Inputs of a whole model.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Q_in, mL/s.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    grid : Grid
        Grid of inputs and results.
    """

    inflow: Array
    area_undeformed: Array
    grid: Grid


class FitData(NamedTuple):
    """Data to which a stage is fitted.

    Attributes
    ----------
    inputs : tuple of arrays
        Inputs of the stage.
    target : array of shape (case, time, z)
        Reference values of its result.
    grid : Grid
        Grid of inputs and target.
    config : PCNDEConfig
        Settings.
    """

    inputs: StageInputs
    target: Array
    grid: Grid
    config: PCNDEConfig


@dataclass(frozen=True)
class Fit:
    """Result of one run of BFGS.

    Attributes
    ----------
    parameters : array of shape (size,)
        The last accepted iterate.
    losses : array of shape (iterations + 1,)
        Loss at the start and after each iteration.
    converged : bool
        Whether the run met a tolerance.
    message : str
        Reason why the run ended.
    """

    parameters: Array
    losses: Array
    converged: bool
    message: str


class Solution(NamedTuple):
    """Prediction of a whole model.

    Attributes
    ----------
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    pressure : array of shape (case, time, z) or None
        p, dyn/cm²; None if the parameters have no pressure stages.
    wall_shear_stress : array of shape (case, time, z) or None
        τ, dyn/cm²; None if the equations do not give it.
    """

    flow: Array
    area: Array
    pressure: Array | None = None
    wall_shear_stress: Array | None = None
