"""Interface of a compute engine: stages of the paper's method, and the closures.

Engines know arrays only: every argument and result is a float64 array in (case, time, z)
order or a flat parameter vector (see :mod:`pcnde_bridge.engines.parameters` and
:mod:`pcnde_bridge.engines.closure_parameters`).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, ComplexArray
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.config import ClosureConfig, PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.internal_points import internal_points
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.types import (
    Fit,
    FitData,
    ModelInputs,
    Objective,
    OnIteration,
    Problem,
    Solution,
    StageInputs,
    ignore,
)


class Stage(Protocol):
    """One stage of the method."""

    def solve(self, vector: Array, inputs: StageInputs, grid: Grid, config: PCNDEConfig) -> Array:
        """Evaluate the stage, independently for every case.

        Parameters
        ----------
        vector : array of shape (size,)
            Parameters of the stage.
        inputs, grid, config
            Inputs of the stage, their grid (s, cm) and the settings.

        Returns
        -------
        array of shape (case, time, z)
            Flow, area, or pressure over p_ref; the intermediate area has
            ``cycles`` times as many time points.

        Raises
        ------
        SolveError
            If the equation cannot be integrated to the end.
        """

    def losses(self, vectors: Array, data: FitData) -> Array:
        """Compute the loss of :meth:`objective`, with equal weights, for many parameter vectors.

        Parameters
        ----------
        vectors : array of shape (vector, size)
            One parameter vector per row.

        Returns
        -------
        array of shape (vector,)
            Infinite where the equation cannot be integrated.
        """

    def objective(self, data: FitData, weight: Array) -> Objective:
        """Prepare the squared error against the target, and its gradient.

        The flow stage controls its step by the error of all cases together.

        Parameters
        ----------
        weight : array of shape (case,)
            Weight of each case's squared error; cases of weight 0 are ignored.

        Returns
        -------
        callable
            Maps parameters to the loss, infinite where the equation cannot be integrated, and its
            gradient.
        """

    def fit(
        self, start: Array, data: FitData, iterations: int, on_iteration: OnIteration = ignore
    ) -> Fit:
        """Minimize :meth:`objective`, with equal weights, by BFGS.

        Parameters
        ----------
        start : array of shape (size,)
            First iterate.
        iterations : int
            Maximum number of iterations.
        on_iteration : callable
            Called with the number and loss of each iteration; it may raise to stop.

        Raises
        ------
        SolveError
            If the loss is not finite at the start.
        """


class Closures(ABC):
    """Equations of the ``physics`` preset.

    Arrays are Q (mL/s) or p (dyn/cm²) of shape (case, time, z), S_u (cm²) of shape
    (case, z) and Q_in (mL/s) of shape (case, time).  The equations are solved at internal points
    (:mod:`pcnde_bridge.engines.internal_points`); all results are at the points of the grid.
    """

    def losses(
        self,
        flow: Array,
        flow_rate: Array,
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> Problem:
        """Prepare the pressure losses of a given flow.

        Parameters
        ----------
        flow, flow_rate : arrays of shape (case, time, z)
            Q, mL/s, and ∂Q/∂t, mL/s², at any time points.

        Returns
        -------
        callable
            Maps the parameters ``losses`` to p − p(L), dyn/cm², (case, time, z).
        """
        fields = flow, flow_rate
        return self._at_internal_points("losses", (), fields, area_undeformed, grid, config)

    def area(
        self, pressure: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """Prepare the area under a given pressure.

        Returns
        -------
        callable
            Maps the parameters ``wall`` to S, cm², (case, time, z).
        """
        return self._at_internal_points("area", (), (pressure,), area_undeformed, grid, config)

    @abstractmethod
    def flow(
        self,
        others: ClosureParameters,
        inputs: ModelInputs,
        points: npt.NDArray[np.int64],
        config: ClosureConfig,
        outlet: ComplexArray | None = None,
    ) -> Problem:
        """Prepare the flow of all coupled closures.

        Parameters
        ----------
        others : ClosureParameters
            Parameters of outlet, losses and wall; its correction is ignored.
        points : array of int of shape (point,)
            Indices into z.
        outlet : array of shape (case, 2, harmonic), optional
            Result of :meth:`~pcnde_bridge.hemodynamics.outlet.Outlet.response`; by default that
            of the parameters.

        Returns
        -------
        callable
            Maps the parameters ``correction`` to Q, mL/s, (case, time, point).
        """

    def wall_shear_stress(
        self,
        others: ClosureParameters,
        flow: Array,
        flow_rate: Array,
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> Problem:
        """Prepare the wall shear stress of a given flow.

        Parameters
        ----------
        others : ClosureParameters
            Parameters of losses and wall; the others are ignored.
        flow, flow_rate : arrays of shape (case, time, z)
            Q, mL/s, and ∂Q/∂t, mL/s², at any time points.

        Returns
        -------
        callable
            Maps the parameters ``wall_shear_stress`` to the wall shear stress in the direction
            of z, dyn/cm², (case, time, z): a linear function.
        """
        fields = flow, flow_rate
        return self._at_internal_points(
            "wall_shear_stress", (others,), fields, area_undeformed, grid, config
        )

    @abstractmethod
    def predict(
        self,
        parameters: ClosureParameters,
        shift: Array,
        inputs: ModelInputs,
        config: ClosureConfig,
        outlet: ComplexArray | None = None,
    ) -> Solution:
        """Predict flow, area, pressure and the magnitude of the wall shear stress.

        Parameters
        ----------
        shift : array of shape (case,)
            Added to the correction's logit: 0, or a sample of the case-to-case variation.
        outlet : array of shape (case, 2, harmonic), optional
            See :meth:`flow`.

        Raises
        ------
        SolveError
            If the coupling passes of a case do not converge.
        """

    @abstractmethod
    def _problem(
        self, name: str, data: tuple[Any, ...], grid: Grid, config: ClosureConfig
    ) -> Problem:
        """Prepare a closure whose data are at the points of ``grid``."""

    def _at_internal_points(
        self,
        name: str,
        others: tuple[Any, ...],
        fields: tuple[Array, ...],
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> Problem:
        """Prepare a closure at the internal points; its value and Jacobian are at those of z."""
        points = internal_points(grid.z, config.losses.spacing)
        inside = (field @ points.inward for field in fields)
        data = *others, *inside, points.area(area_undeformed)
        problem = self._problem(name, data, replace(grid, z=points.z), config)

        def evaluate(parameters: Array) -> tuple[Array, Array]:
            value, jacobian = problem(parameters)
            slopes = points.at_given(np.swapaxes(jacobian, -1, -2))
            return points.at_given(value), np.swapaxes(slopes, -1, -2)

        return evaluate


class Engine(Displayed, ABC):
    """Compute engine.

    Engines can be pickled: another process starts its own.

    Attributes
    ----------
    name : str
        ``"julia"``, ``"julia-reference"`` or ``"jax"``.
    versions : mapping of str to str
        Versions of the packages that compute.
    flow : Stage
        Momentum equation.  Inputs: Q_in (case, time), and S (case, time, z), linear in z between
        the points.
    intermediate_area : Stage
        Continuity equation.  Inputs: Q (case, time, z), periodic and linear in time between the
        time points, and S_u (case, z), the initial condition.
    fourier_area : Stage
        Periodic area.  Inputs: Q (case, time, z), and Ŝ(t=0) (case, z) from the intermediate area.
    temporal_pressure : Stage
        First pressure stage.  Inputs: Q and S (case, time, z), and S_u (case, z).
    spatial_pressure : Stage
        Second pressure stage.  Inputs: p̂* (case, time, z), the first one's result, Q (case, time,
        z), and S_u (case, z).
    temporal_flow : Stage
        Momentum equation in time, an alternative to ``flow``.  Inputs: Q_in (case, time), linear in
        time between the time points, and Q at the first time point (case, z).
    closures : Closures
        The equations of the ``physics`` preset.
    """

    name: str
    versions: Mapping[str, str]
    flow: Stage
    intermediate_area: Stage
    fourier_area: Stage
    temporal_pressure: Stage
    spatial_pressure: Stage
    temporal_flow: Stage
    closures: Closures

    def _facts(self) -> list[str]:
        return [" ".join(package) for package in self.versions.items()]

    @abstractmethod
    def predict(self, parameters: Parameters, inputs: ModelInputs, config: PCNDEConfig) -> Solution:
        """Run all coupling passes and the pressure stages, independently for every case.

        The result is that of :func:`pcnde_bridge.engines.staged.predict_by_stages`.

        Parameters
        ----------
        parameters : Parameters
            Parameters of a trained model.

        Raises
        ------
        SolveError
            If the momentum equation cannot be integrated to the end.
        """
