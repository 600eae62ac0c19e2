"""Where the numbers of a data set, a model or a prediction live."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


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
    """

    time: npt.NDArray[np.float64]
    z: npt.NDArray[np.float64]
    period: float
