"""What an engine supplies for the ``physics`` preset: values and Jacobians of the closures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pcnde_bridge.closures.parameters import ClosureParameters
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.engines.base import Solution
from pcnde_bridge.grid import Grid

Array = npt.NDArray[np.float64]


Problem = Callable[[Array], tuple[Array, Array]]
"""Takes a closure's parameters, returns a value and its Jacobian (one more axis)."""


class Closures(Protocol):
    """The equations of :mod:`pcnde_bridge.closures`; arrays are (case, time, z)."""

    def losses(
        self, flow: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """Return p − p(L), dyn/cm², of a flow that is known everywhere, as a function."""
        ...

    def area(
        self, pressure: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """Return S, cm², under a pressure that is known everywhere, as a function."""
        ...

    def flow(
        self,
        others: ClosureParameters,
        inflow: Array,
        area_undeformed: Array,
        points: npt.NDArray[np.int64],
        grid: Grid,
        config: ClosureConfig,
    ) -> Problem:
        """Return Q, mL/s, (case, time, point) of all coupled, as a function of the correction.

        ``others`` holds the other closures' parameters, ``points`` indices into z.
        """
        ...

    def predict(
        self,
        parameters: ClosureParameters,
        shift: Array,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> Solution:
        """Return flow, area and pressure; ``shift`` (case,) moves the correction's logit.

        Raises
        ------
        SolveError
            If the coupling passes of a case do not converge.
        """
        ...
