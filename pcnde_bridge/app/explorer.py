"""What the page shows: predictions, intervals and the 1D solver's solution, kept for reuse."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.app.inputs import Choices, Inputs
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.errors import PCNDEError
from pcnde_bridge.hemodynamics.outlet import Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.synthetic import OUTLET_RESISTANCE
from pcnde_bridge.hemodynamics.tube_laws import LinearWall
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots.style import QUANTITIES

Limits = Mapping[str, tuple[Array, Array]]
T = TypeVar("T")

_KEPT = 32


class Line(NamedTuple):
    """A curve: abscissa (s or cm), ordinate in the units of the figures."""

    x: Array
    y: Array


class Scores(NamedTuple):
    """How far waveform, vessel and period lie from the training data; 1 is its edge."""

    waveform: float
    vessel: float
    period: float


@dataclass(frozen=True)
class Panel:
    """Curves of one variable.

    Attributes
    ----------
    predicted : Line
        By the model.
    low, high : Line or None
        90 % interval, where it has been computed.
    tube : Line or None
        By the 1D solver, where it has been computed.
    given : Line or None
        Inflow or undeformed area, which the prediction starts from.
    """

    predicted: Line
    low: Line | None = None
    high: Line | None = None
    tube: Line | None = None
    given: Line | None = None


class Kept(Generic[T]):
    """Results for the last inputs; an error of the package is a result, too.

    One is computed at a time; who asks for a result that is being computed waits for it.
    """

    def __init__(self, compute: Callable[[Inputs], T]) -> None:
        self._compute = compute
        self._results: OrderedDict[Inputs, T | PCNDEError] = OrderedDict()
        self._computing = threading.Lock()

    def look(self, inputs: Inputs) -> T | PCNDEError | None:
        """Return the result if it is there, at once."""
        return self._results.get(inputs)

    def __call__(self, inputs: Inputs) -> T:
        """Return the result, computed if need be.

        Raises
        ------
        PCNDEError
            What the computation raised.
        """
        with self._computing:
            result = self._results.get(inputs)
            if result is None:
                try:
                    result = self._compute(inputs)
                except PCNDEError as error:
                    result = error
                self._results[inputs] = result
                if len(self._results) > _KEPT:
                    self._results.popitem(last=False)
        if isinstance(result, PCNDEError):
            raise result
        return result


class Explorer:
    """A model, asked for one case at a time.

    Parameters
    ----------
    model : PCNDE
        Computed by the JAX engine, which any thread may call.
    samples : int
        Draws that the interval is made of.

    Attributes
    ----------
    choices : Choices
        What the controls offer.
    prediction : Kept of Prediction
        Without samples; one case.
    interval : Kept of dict
        Limits of 90 % intervals, see :meth:`~pcnde_bridge.Prediction.interval`.
    tube : Kept of Cases
        The 1D solver's solution, see :meth:`solver`.
    """

    def __init__(self, model: PCNDE, samples: int = 64) -> None:
        self.model = model
        self.samples = samples if model.uncertainty is not None else 0
        self.choices = Choices.of(model)
        self.prediction: Kept[Prediction] = Kept(lambda inputs: self._predict(inputs, 0))
        self.interval: Kept[Limits] = Kept(
            lambda inputs: self._predict(inputs, self.samples).interval(0.9)
        )
        self.tube: Kept[Cases] = Kept(self._solve)

    @property
    def variables(self) -> list[str]:
        """Names of what the model predicts."""
        return [name for name in QUANTITIES if name != "pressure" or self.model.has_pressure]

    def _predict(self, inputs: Inputs, samples: int) -> Prediction:
        grid = self.model.grid
        inflow = inputs.waveform.samples(grid.time.size)
        area = inputs.vessel.area_undeformed(grid.z - grid.z[0])
        if self.model.any_grid:
            period = inputs.waveform.period
            return self.model.predict(inflow, area, z=grid.z, period=period, samples=samples)
        return self.model.predict(inflow, area, samples=samples)

    def solver(self, inputs: Inputs) -> tuple[Tube1D, Windkessel]:
        """1D solver with what the model has learnt of wall and outlet.

        A linear wall, undeformed where the model's is, as stiff as the model's in the
        healthy vessel, and the model's outlet.  A model that is not of the preset
        ``physics`` has neither: then the paper's artery, with the resistance that the
        predicted outlet flow and pressure make.

        Parameters
        ----------
        inputs : Inputs
            Of the prediction.
        """
        known = self.model.parameters
        if not isinstance(known, ClosureParameters):
            if not self.model.has_pressure:
                return Tube1D(), Windkessel(OUTLET_RESISTANCE)
            return Tube1D(), Windkessel(outlet_resistance(self.prediction(inputs).to_cases()))
        membrane = len(known.wall) == 5
        radius = inputs.vessel.diameter / 2
        stiffness = float(known.wall[0]) / (radius if membrane else 1.0)
        # Of E, h and r₀ the linear law takes 4/3·E·h/r₀ alone.
        wall = LinearWall(0.75 * stiffness, radius, radius, float(known.wall[-1]))
        proximal, distal, capacitance, pressure = (float(value) for value in known.outlet)
        return Tube1D(wall=wall), Windkessel(proximal, distal, capacitance, pressure)

    def _solve(self, inputs: Inputs) -> Cases:
        tube, outlet = self.solver(inputs)
        return tube.simulate([inputs.vessel], [inputs.waveform], outlet)

    def novelty(self, inputs: Inputs) -> Scores | None:
        """Scores of the inputs, as the prediction has them; None if the model has none."""
        found = self.prediction(inputs)
        scores = self.model.novelty_scores(
            found.flow[:, :, 0],
            found.area_undeformed,
            Grid(found.time, found.z, found.period),
        )
        if not scores:
            return None
        named = scores["inflow"], scores["undeformed area"], scores["period"]
        return Scores(*(float(score[0]) for score in named))

    def csv(self, inputs: Inputs) -> str:
        """Return the prediction as ``pcnde predict --samples`` writes it, in CGS units."""
        return self._predict(inputs, self.samples).to_frame().to_csv(index=False)

    def along(self, inputs: Inputs, instant: int) -> dict[str, Panel]:
        """Curves along the vessel at an instant of the model's grid; what is ready is shown."""
        found = self.prediction(inputs)
        z = found.z

        def tube(cases: Cases, name: str) -> Line:
            time = found.time[instant]
            values = _periodic(time, cases.time, getattr(cases, name)[0], cases.period)
            return Line(cases.z + z[0], values)

        panels = self._panels(inputs, z, np.s_[0, instant, :], tube)
        s_u = QUANTITIES["area"].convert(found.area_undeformed[0])
        return _given(panels, "area", Line(z, s_u))

    def over(self, inputs: Inputs, point: int) -> dict[str, Panel]:
        """Curves over one cycle at a point of the model's grid; what is ready is shown."""
        found = self.prediction(inputs)
        time = found.time

        def tube(cases: Cases, name: str) -> Line:
            place = found.z[point] - found.z[0]
            values = [np.interp(place, cases.z, row) for row in getattr(cases, name)[0]]
            return Line(cases.time, np.array(values))

        panels = self._panels(inputs, time, np.s_[0, :, point], tube)
        return _given(panels, "flow", Line(time, QUANTITIES["flow"].convert(found.flow[0, :, 0])))

    def _panels(
        self,
        inputs: Inputs,
        x: Array,
        where: tuple[int | slice, ...],
        tube: Callable[[Cases, str], Line],
    ) -> dict[str, Panel]:
        values = self.prediction(inputs).variables()
        limits, cases = self.interval.look(inputs), self.tube.look(inputs)
        panels = {}
        for name in self.variables:
            factor = QUANTITIES[name][2]
            low = high = solved = None
            if isinstance(limits, Mapping):
                low, high = (Line(x, limit[where] * factor) for limit in limits[name])
            if isinstance(cases, Cases):
                line = tube(cases, name)
                solved = Line(line.x, line.y * factor)
            panels[name] = Panel(Line(x, values[name][where] * factor), low, high, solved)
        return panels


def _given(panels: dict[str, Panel], name: str, line: Line) -> dict[str, Panel]:
    panel = panels[name]
    known = Panel(panel.predicted, panel.low, panel.high, panel.tube, line)
    return {**panels, name: known}


def _periodic(at: float, time: Array, values: Array, period: float) -> Array:
    """Row of (time, z) at an instant, linear between the rows; the first follows the last."""
    step = period / len(time)
    place = (at - time[0]) / step
    before = int(np.floor(place))
    part = place - before
    n = len(time)
    row: Array = (1 - part) * values[before % n] + part * values[(before + 1) % n]
    return row
