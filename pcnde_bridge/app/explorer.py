"""Curves on the page: predictions, intervals and the 1D solver's solution, cached."""

import threading
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import plain_text
from pcnde_bridge.app.inputs import Choices, Inputs
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import MMHG
from pcnde_bridge.errors import PCNDEError
from pcnde_bridge.hemodynamics.outlet import Outlet, Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.pressure_losses import pressure_drop
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.synthetic import OUTLET_RESISTANCE
from pcnde_bridge.hemodynamics.tube_laws import LinearWall
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots.style import QUANTITIES

Limits = Mapping[str, tuple[Array, Array]]
T = TypeVar("T")

_CACHE_SIZE = 32
INDICES = "mean_drop_mmHg", "ffr"


class Line(NamedTuple):
    """A curve: abscissa (s or cm), and ordinate in the units of the figures."""

    x: Array
    y: Array


Panel = dict[str, Line]
"""Curves of one variable: ``prediction``; ``given``, the inflow or the undeformed area;
``interval``, the outline of the 90 % interval, and ``solver``, the solution of the 1D solver,
if they have been computed."""


class ResultCache(Generic[T]):
    """Results for the latest inputs; an error of the package is a result, too.

    One result is computed at a time; a second request for it waits.
    """

    def __init__(self, compute: Callable[[Inputs], T]) -> None:
        self._compute = compute
        self._results: dict[Inputs, T | PCNDEError] = {}
        self._computing = threading.Lock()

    def cached(self, inputs: Inputs) -> T | PCNDEError | None:
        """Return the result immediately, None if it has not been computed."""
        return self._results.get(inputs)

    def __call__(self, inputs: Inputs) -> T:
        """Return the result, computed if necessary.

        Raises
        ------
        PCNDEError
            The error that the computation raised.
        """
        with self._computing:
            result = self._results.get(inputs)
            if result is None:
                try:
                    result = self._compute(inputs)
                except PCNDEError as error:
                    result = error
                self._results[inputs] = result
                if len(self._results) > _CACHE_SIZE:
                    del self._results[next(iter(self._results))]
        if isinstance(result, PCNDEError):
            raise result
        return result


class Explorer:
    """Predictions of a model, one case at a time.

    Parameters
    ----------
    model : PCNDE
        Model on the JAX engine, which any thread may call.
    samples : int
        Number of samples for the interval.

    Attributes
    ----------
    choices : Choices
        Choices that the controls offer.
    prediction : ResultCache of Prediction
        Prediction of one case, without samples.
    interval : ResultCache of dict
        Limits of 90 % intervals of the variables and, if there is a pressure, of drop and FFR,
        see :meth:`~pcnde_bridge.Prediction.interval`.
    solution : ResultCache of Cases
        Solution of the 1D solver, see :meth:`solver_setup`.
    comparisons : dict of ResultCache
        ``interval`` and ``solver``: the results that the prediction can be compared with.
    """

    def __init__(self, model: PCNDE, samples: int = 64) -> None:
        self.model = model
        self.samples = samples if model.uncertainty is not None else 0
        self.choices = Choices(model)
        self.prediction: ResultCache[Prediction] = ResultCache(self._predict)
        self.interval: ResultCache[Limits] = ResultCache(self._interval)
        self.solution: ResultCache[Cases] = ResultCache(self._solve)
        self.comparisons: dict[str, ResultCache[Any]] = {"solver": self.solution}
        if self.samples:
            self.comparisons = {"interval": self.interval, **self.comparisons}

    @cached_property
    def variables(self) -> list[str]:
        """Names of the variables that the model predicts."""
        return list(self.prediction(self.choices.initial).variables())

    def _predict(self, inputs: Inputs, samples: int = 0) -> Prediction:
        grid, any_grid = self.model.grid, self.model.any_grid
        return self.model.predict(
            inputs.waveform.samples(grid.time.size),
            inputs.vessel.area_undeformed(grid.z - grid.z[0]),
            z=grid.z if any_grid else None,
            period=inputs.waveform.period if any_grid else None,
            samples=samples,
            units="cgs",
        )

    def _interval(self, inputs: Inputs) -> Limits:
        found = self._predict(inputs, self.samples)
        indices = {name: column.to_numpy() for name, column in found.indices().items()}
        limits = {i: (indices[f"{i}_low"], indices[f"{i}_high"]) for i in INDICES}
        return {**found.interval(0.9), **limits}

    def indices(self, inputs: Inputs) -> dict[str, float]:
        """Return drop (mmHg) and FFR, and as ``empirical`` the drop of Seeley and Young.

        It is empty if the model predicts no pressure.
        """
        found, vessel = self.prediction(inputs), inputs.vessel
        if found.pressure is None:
            return {}
        numbers = {name: float(found.indices()[name].iloc[0]) for name in INDICES}
        narrowest = vessel.healthy_area * (1 - vessel.blockage)
        length = max((stenosis.length for stenosis in vessel.stenoses), default=0.0)
        shape = vessel.healthy_area, narrowest, length
        drop = pressure_drop(found.flow[0, :, 0], *shape)
        return numbers | {"empirical": float(np.mean(drop)) / MMHG}

    def solver_setup(self, inputs: Inputs) -> tuple[Tube1D, Outlet]:
        """Return the 1D solver and an outlet with the wall and outlet that the model has learned.

        The wall is linear, undeformed at the model's reference pressure, and as stiff as
        the model's in the healthy vessel.  A model of another preset than ``physics`` has
        no wall and outlet: the wall is then the paper's, and the resistance follows from
        the predicted flow and pressure at the outlet.

        Parameters
        ----------
        inputs : Inputs
            Inputs of the prediction.
        """
        learned = dict(self.model.parameters)
        if "wall" in learned:
            wall, radius = learned["wall"], inputs.vessel.diameter / 2
            membrane = len(wall) == 5
            stiffness = float(wall[0]) / (radius if membrane else 1.0)
            # The linear law depends on E, h and r₀ through 4/3·E·h/r₀ only.
            law = LinearWall(0.75 * stiffness, radius, radius, float(wall[-1]))
            fitted = Windkessel(*map(float, learned["outlet"]))
            return Tube1D(wall=law), self.model.outlet or fitted
        if self.model.has_pressure:
            return Tube1D(), Windkessel(outlet_resistance(self.prediction(inputs).to_cases()))
        return Tube1D(), Windkessel(OUTLET_RESISTANCE)

    def _solve(self, inputs: Inputs) -> Cases:
        tube, outlet = self.solver_setup(inputs)
        return tube.solve([inputs.vessel], [inputs.waveform], outlet)

    def novelty(self, inputs: Inputs) -> dict[str, float]:
        """Return the scores of :meth:`~pcnde_bridge.PCNDE.novelty_scores` by name."""
        found = self.prediction(inputs)
        grid = Grid(found.time, found.z, found.period)
        scores = self.model.novelty_scores(found.flow[:, :, 0], found.area_undeformed, grid)
        return {name: float(score[0]) for name, score in scores.items()}

    def csv(self, inputs: Inputs) -> str:
        """Return the prediction as ``pcnde predict --samples`` writes it, in CGS units."""
        return plain_text(self._predict(inputs, self.samples).to_frame()).to_csv(index=False)

    def curves(self, inputs: Inputs, column: str, index: int) -> dict[str, Panel]:
        """Return the curves of one column of the page.

        Parameters
        ----------
        inputs : Inputs
            Inputs of the prediction.
        column : {'along', 'over'}
            Along the vessel at a time point, or over the cycle at a grid point.
        index : int
            Time point or grid point of the model.
        """
        found = self.prediction(inputs)
        cut: tuple[Any, ...]
        if column == "along":
            x, cut, given = found.z, np.s_[0, index, :], {"area": found.area_undeformed[0]}
        else:
            x, cut, given = found.time, np.s_[0, :, index], {"flow": found.flow[0, :, 0]}
        limits, cases = self.interval.cached(inputs), self.solution.cached(inputs)
        panels = {}
        for name in self.variables:
            factor = QUANTITIES[name].factor
            panel = {"prediction": Line(x, factor * getattr(found, name)[cut])}
            if isinstance(limits, Mapping) and name in limits:
                low, high = (factor * limit[cut] for limit in limits[name])
                there_and_back = (x, x[::-1]), (low, high[::-1])
                panel["interval"] = Line(*map(np.concatenate, there_and_back))
            if isinstance(cases, Cases) and name in cases.variables():
                panel["solver"] = _solved(cases, factor * getattr(cases, name)[0], found, cut)
            if name in given:
                panel["given"] = Line(x, factor * given[name])
            panels[name] = panel
        return panels


def _solved(cases: Cases, values: Array, found: Prediction, cut: tuple[Any, ...]) -> Line:
    """Interpolate values (time, z) of the 1D solver to the time or grid point of a prediction."""
    _, time, z = cut
    if isinstance(z, slice):  # along the vessel
        at = found.time[time]
        y = [np.interp(at, cases.time, at_z, period=cases.period) for at_z in values.T]
        return Line(cases.z + found.z[0], np.array(y))
    at = found.z[z] - found.z[0]
    return Line(cases.time, np.array([np.interp(at, cases.z, row) for row in values]))
