"""What an engine supplies for the ``physics`` preset: values and Jacobians of the closures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.protocol import Solution

Problem = Callable[[Array], tuple[Array, Array]]
"""Takes a closure's parameters, returns a value and its Jacobian (one more axis)."""


class Closures(Protocol):
    """The equations of :mod:`pcnde_bridge.closures`; arrays are (case, time, z)."""

    def losses(
        self, flow: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """Pressure losses of a flow that is known everywhere.

        Parameters
        ----------
        flow : array of shape (case, time, z)
            Q, mL/s.
        area_undeformed : array of shape (case, z)
            S_u, cm².
        grid : Grid
            Instants (s), points (cm) and period (s).
        config : ClosureConfig
            Settings.

        Returns
        -------
        callable
            Of the parameters ``losses``: p − p(L), dyn/cm², (case, time, z).
        """
        ...

    def area(
        self, pressure: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """Area under a pressure that is known everywhere.

        Parameters
        ----------
        pressure : array of shape (case, time, z)
            p, dyn/cm².
        area_undeformed, grid, config
            As of :meth:`losses`.

        Returns
        -------
        callable
            Of the parameters ``wall``: S, cm², (case, time, z).
        """
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
        """Flow of all closures coupled.

        Parameters
        ----------
        others : ClosureParameters
            Its outlet, losses and wall are used.
        inflow : array of shape (case, time)
            Q_in, mL/s.
        area_undeformed, grid, config
            As of :meth:`losses`.
        points : array of int of shape (point,)
            Indices into z.

        Returns
        -------
        callable
            Of the parameters ``correction``: Q, mL/s, (case, time, point).
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
        """Predict flow, area and pressure.

        Parameters
        ----------
        parameters : ClosureParameters
            All closures'.
        shift : array of shape (case,)
            Moves the correction's logit: 0, or a draw of what differs from case to case.
        inflow : array of shape (case, time)
            Q_in, mL/s.
        area_undeformed, grid, config
            As of :meth:`losses`.

        Returns
        -------
        Solution
            (case, time, z): mL/s, cm², dyn/cm².

        Raises
        ------
        SolveError
            If the coupling passes of a case do not converge.
        """
        ...
