"""Time points and positions at which a data set, a model or a prediction is given."""

from dataclasses import dataclass

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.errors import InputError

_FEWEST_TIMES, _FEWEST_POINTS = 16, 5


@dataclass(frozen=True, repr=False)
class Grid(Displayed):
    """Time points of one cycle and points along the vessel.

    The arrays are read-only copies, so that predictions can share them with their model.

    Attributes
    ----------
    time : array of shape (n_t,)
        Time points of one cycle, s, uniform; the end point is not repeated.
    z : array of shape (n_z,)
        Points along the vessel, cm, increasing.
    period : float
        Length of the cycle, s.
    """

    time: Array
    z: Array
    period: float

    def __post_init__(self) -> None:
        for name in ("time", "z"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def _facts(self) -> list[str]:
        return [
            f"{self.time.size} time points over {self.period:g} s",
            f"{self.z.size} points, z from {self.z[0]:g} to {self.z[-1]:g} cm",
        ]


def check_resolution(n_times: int, n_points: int) -> None:
    """Raise if the cycle or the vessel is not resolved, for models that accept any grid.

    Raises
    ------
    InputError
        If there are fewer than 16 time points or 5 points.
    """
    if n_times < _FEWEST_TIMES:
        found = f"{n_times} time points per cycle"
        raise InputError(f"inflow has {found}; at least {_FEWEST_TIMES} are needed.")
    if n_points < _FEWEST_POINTS:
        raise InputError(f"z has {n_points} points; at least {_FEWEST_POINTS} are needed.")


def check_grid(trained: Grid, other: Grid, where: str = "model.grid") -> None:
    """Raise unless cases are on the grid that a model was trained on.

    Parameters
    ----------
    trained : Grid
        Grid of the training cases.
    other : Grid
        Grid of the cases to be predicted.
    where : str
        Name of the model's grid, for the message.

    Raises
    ------
    InputError
        If the grids differ; the message names the first difference.
    """
    remedy = "bring the cases to the model's grid"
    for name, mine, theirs, tolerance in (
        ("time", trained.time - trained.time[0], other.time - other.time[0], 1e-9),
        ("z", trained.z, other.z, 1e-9),
        ("period", np.array([trained.period]), np.array([other.period]), 1e-6),
    ):
        if mine.shape != theirs.shape:
            sizes = f"{theirs.size} values of {name}, but the model was trained on {mine.size}"
            raise InputError(f"The cases have {sizes}: {remedy} ({where}.{name}).")
        difference = np.abs(mine - theirs)
        if difference.max() > tolerance * (1 + np.abs(mine).max()):
            i = int(difference.argmax())
            values = f"{theirs[i]:g} in the cases but {mine[i]:g} in the model"
            raise InputError(f"{name}[{i}] is {values}: {remedy} ({where}.{name}).")
