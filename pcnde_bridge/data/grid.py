"""Where the numbers of a data set, a model or a prediction live."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcnde_bridge.errors import InputError

_FEWEST_INSTANTS, _FEWEST_POINTS = 16, 5
_SAME = 1e-9  # of the largest coordinate


@dataclass(frozen=True)
class Grid:
    """Instants and points.

    Attributes
    ----------
    time : array of shape (n_t,)
        Instants of one cycle, s, uniform, the end point not repeated.
    z : array of shape (n_z,)
        Points along the vessel, cm, increasing.
    period : float
        Length of the cycle, s.

    The arrays are its own and read-only: predictions share them with their model.
    """

    time: npt.NDArray[np.float64]
    z: npt.NDArray[np.float64]
    period: float

    def __post_init__(self) -> None:
        for name in ("time", "z"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)


def check_resolution(n_times: int, n_points: int) -> None:
    """Raise where a cycle or a vessel is not resolved, for models that take any grid.

    Raises
    ------
    InputError
        If there are fewer than 16 instants or 5 points.
    """
    if n_times < _FEWEST_INSTANTS:
        raise InputError(
            f"inflow has {n_times} instants per cycle; at least {_FEWEST_INSTANTS} are needed."
        )
    if n_points < _FEWEST_POINTS:
        raise InputError(f"z has {n_points} points; at least {_FEWEST_POINTS} are needed.")


def check_grid(trained: Grid, other: Grid, where: str = "model.grid") -> None:
    """Raise unless cases are on the grid that a model was trained on.

    Parameters
    ----------
    trained : Grid
        Of the training cases.
    other : Grid
        Of the cases to be predicted.
    where : str
        What holds the model's grid, for the message.

    Raises
    ------
    InputError
        Naming the first difference.
    """
    for name, mine, theirs in (
        ("time", trained.time - trained.time[0], other.time - other.time[0]),
        ("z", trained.z, other.z),
    ):
        if mine.shape != theirs.shape:
            raise InputError(
                f"The cases have {theirs.size} values of {name}, but the model was trained on "
                f"{mine.size}: bring the cases to the model's grid ({where}.{name})."
            )
        if np.abs(mine - theirs).max() > _SAME * (1 + np.abs(mine).max()):
            index = int(np.abs(mine - theirs).argmax())
            raise InputError(
                f"{name}[{index}] is {theirs[index]:g} in the cases but {mine[index]:g} in the "
                f"model: bring the cases to the model's grid ({where}.{name})."
            )
    if not math.isclose(trained.period, other.period, rel_tol=1e-6):
        raise InputError(
            f"The cases' period is {other.period:g} s, the model's {trained.period:g} s."
        )
