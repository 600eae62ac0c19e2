"""Where the numbers of a data set, a model or a prediction live."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcnde_bridge.errors import InputError

_FEWEST_INSTANTS, _FEWEST_POINTS = 16, 5


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
