"""Checked inputs of a prediction, one row for each case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import AnyArray, Array, ComplexArray
from pcnde_bridge._utils.validation import (
    all_of,
    check_finite,
    check_increasing,
    check_values,
    positive,
    real_array,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid, check_resolution
from pcnde_bridge.data.plausibility import check_units, input_sizes
from pcnde_bridge.data.single_vessel import check_samples, equal_cycles
from pcnde_bridge.data.units import FACTORS, SHAPES, in_cgs, option_of, stated_units, text_of
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.geometry import Vessel
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.uncertainty.novelty import Novelty
from pcnde_bridge.uncertainty.sampling import RandomNumbers

# pandas takes longer to create this index than an engine to predict a case.
_CASE = pd.Index(["case"])
_LONGEST_CYCLE = 3.0  # s, 20 beats in a minute


@dataclass(frozen=True)
class Inputs:
    """All inputs of a prediction.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Flow rate at the inlet, mL/s.
    area_undeformed : array of shape (case, z)
        Undeformed area, cm².
    grid : Grid
        Time points (s), axial positions (cm) and period (s).
    labels : DataFrame
        One row for each case.
    novelty : array of shape (case,) or None
        Distance from the training data; 1 is their edge.
    random : RandomNumbers or None
        Random numbers of the samples; None for no samples.
    outlet : array of shape (case, 2, harmonic) or None
        Response of an outlet; None for the trained one.
    units : mapping of str to str
        Units that are stated, see :func:`~pcnde_bridge.data.units.stated_units`; empty for points
        and a period of the model.
    """

    inflow: Array
    area_undeformed: Array
    grid: Grid
    labels: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False)
    novelty: Array | None = None
    random: RandomNumbers | None = None
    outlet: ComplexArray | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_cases(cls, cases: Cases) -> Inputs:
        """Return the inputs of cases, without labels that describe the reference solution."""
        labels = cases.labels.drop(columns=list(SOLVER_LABELS), errors="ignore")
        return cls(cases.inflow, cases.area_undeformed, cases.grid, labels)

    def __len__(self) -> int:
        return len(self.inflow)

    def select(self, rows: slice) -> Inputs:
        """Return a range of cases."""
        return replace(
            self,
            inflow=self.inflow[rows],
            area_undeformed=self.area_undeformed[rows],
            labels=self.labels.iloc[rows].reset_index(drop=True),
            novelty=None if self.novelty is None else self.novelty[rows],
            random=None if self.random is None else self.random.select(rows),
            outlet=None if self.outlet is None else self.outlet[rows],
        )


def check_cases(name: str, cases: object) -> None:
    """Raise InputError unless an argument is a data set; ``name`` names it."""
    if not isinstance(cases, Cases):
        raise InputError(
            f"{name} must be Cases, got {type(cases).__name__}. Create them with load_cases(path) "
            "or Cases(flow=..., ...)."
        )


def inputs_from_arrays(
    trained: Grid,
    any_grid: bool,
    inflow: Any,
    area_undeformed: Any,
    z: npt.ArrayLike | None = None,
    period: float | None = None,
    units: str | Mapping[str, str] | None = None,
) -> Inputs:
    """Check the arrays of a user, and repeat a single waveform or geometry for all cases.

    Parameters
    ----------
    trained : Grid
        Grid of the training cases.
    any_grid : bool
        Whether the model predicts on other grids.
    inflow, area_undeformed, z, period, units
        Arguments of :meth:`pcnde_bridge.PCNDE.predict`.

    Raises
    ------
    InputError
        If a shape, a value or the grid is not usable.
    """
    if area_undeformed is None:
        raise InputError("predict needs area_undeformed beside the inflow.")
    known = {name: "" for name, value in (("z", z), ("time", period)) if value is None}
    stated = {**known, **stated_units(units)}
    given = stated, inflow, area_undeformed, z, period
    stated, inflow, area_undeformed, z, period = _from_objects(trained, any_grid, *given)
    inflow, area_undeformed = (
        real_array("inflow", inflow),
        real_array("area_undeformed", area_undeformed),
    )
    n_times = inflow.shape[-1] if inflow.ndim else 0
    if period is None and n_times > 1 and (any_grid or n_times == trained.time.size + 1):
        _check_cycle(inflow, trained.time.size)
    grid = trained
    if any_grid:
        grid = _grid(trained, n_times, z, period, stated)
    elif z is not None or period is not None:
        raise InputError(
            "This model predicts only at the points and the period of its training: leave out "
            "z and period. A model of the preset physics accepts others."
        )
    q = _rows("inflow", inflow, grid.time.size, "time points")
    s_u = _rows("area_undeformed", area_undeformed, grid.z.size, "points")
    check_values("area_undeformed", s_u, s_u <= 0, "areas must be positive (cm²)")
    count = max(len(q), len(s_u))
    if not {len(q), len(s_u)} <= {1, count}:
        raise InputError(
            f"inflow has {len(q)} cases and area_undeformed {len(s_u)}: give equal numbers of "
            "both, or one of either."
        )
    converted = in_cgs("flow", q, stated), in_cgs("area", s_u, stated)
    check_samples("inflow", converted[0].T, grid.time, "case")
    q, s_u = (np.repeat(array, count // len(array), axis=0) for array in converted)
    numbers = pd.DataFrame(np.arange(count)[:, None], columns=_CASE, copy=False)
    return Inputs(q, s_u, grid, numbers, units=stated)


def check_plausible(inputs: Inputs, chosen: AnyArray, novelty: Novelty | None) -> None:
    """Raise if inputs outside the training data are implausible in CGS units.

    Parameters
    ----------
    inputs : Inputs
        All inputs.
    chosen : array of bool, shape (case,)
        Cases outside the training data.
    novelty : Novelty or None
        Measure of the distance from the training data.  Readings as radii or diameters that
        are much farther from it than areas are ignored.

    Raises
    ------
    InputError
        If the mean inflow is negative, there are several cycles, the units are wrong or
        ambiguous, or radii or diameters are given as areas.
    """
    inflow, area, grid = inputs.inflow[chosen], inputs.area_undeformed[chosen], inputs.grid
    stated = inputs.units
    mean, largest = inflow.mean(axis=1), np.abs(inflow).max(axis=1)
    for wrong, what in (
        (mean < -1e-3 * largest, "is negative: flow into the vessel is positive; change the sign"),
        (largest == 0, "is zero: give the flow rate at the inlet (mL/s) over one cycle"),
    ):
        if wrong.any():
            case, value = int(np.flatnonzero(chosen)[wrong.argmax()]), mean[wrong.argmax()]
            raise InputError(f"The mean inflow of case {case}, {value:.4g} mL/s, {what}.")
    if "time" in stated and "flow" not in stated:
        _check_single(inflow, stated)
    sizes = input_sizes(inflow, area, float(np.ptp(grid.z)), grid.period)
    shapes = {*SHAPES}
    if novelty is not None and "shape" not in stated:
        shapes = _shapes(novelty, inflow, area, grid.z, stated)
    # Without pressures, nothing else tells areas from radii.
    check_units(sizes, stated, unique=True, shapes={"area"} if "area" in stated else shapes)
    if "time" not in stated and grid.period > _LONGEST_CYCLE:
        raise InputError(
            f"The period is {grid.period:g} s; a cycle usually has 0.25 to {_LONGEST_CYCLE:g} s. "
            "Give the length of one cycle, not the heart rate; if it is right, state time=s among "
            f"the units ({option_of(stated, 'time', 's')})."
        )


def _shapes(
    novelty: Novelty, inflow: Array, area: Array, z: Array, stated: Mapping[str, str]
) -> set[str]:
    """Return the readings of the areas that are about as near to the training data as the nearest.

    Raises
    ------
    InputError
        If radii or diameters are the nearest, and much nearer than areas.
    """
    z = z / np.ptp(z) * novelty.area.center[-1]  # the length, which may be in another unit
    raw = area / FACTORS["area"][stated.get("area", "cm^2")]
    scores = {
        (shape, unit): novelty.score_shapes(
            inflow, in_cgs("area", raw, {"shape": shape, "area": unit}), z
        )["shape of the vessel"].max()
        for shape in SHAPES
        for unit in FACTORS["area"]
        if unit == stated.get("area", unit)
    }
    shape, unit = min(scores, key=scores.__getitem__)
    nearest, found = scores[shape, unit], scores["area", stated.get("area", "cm^2")]
    if shape != "area" and nearest < found / 4 and found > 1:
        side = unit.removesuffix("^2")
        raise InputError(
            f"area_undeformed looks like a {shape}, which would be much nearer to the training "
            f"data: state {shape}={side}, or area=cm^2 ({option_of(stated, shape, side)})."
        )
    near = (shape for (shape, _), score in scores.items() if score <= 2 * max(nearest, 1))
    return {"area", *near}


def _grid(
    trained: Grid, n_times: int, z: Any, period: float | None, stated: Mapping[str, str]
) -> Grid:
    """Return the grid of a prediction that may differ from that of the training."""
    points: Array = trained.z
    if z is not None:
        points = in_cgs("z", _rows("z", real_array("z", z), np.size(z), "points")[0], stated)
        check_increasing("z", points, "cm")
    check_resolution(n_times, points.size)
    cycle = trained.period
    if period is not None:
        cycle = in_cgs("time", positive("period", period), stated)
    time = trained.time[0] + np.arange(float(n_times)) * (cycle / n_times)
    return Grid(time, points, cycle)


def _from_objects(
    trained: Grid, any_grid: bool, units: dict[str, str], *given: Any
) -> tuple[dict[str, str], Any, Any, Any, Any]:
    """Replace waveforms and vessels, in either order, by their arrays, which are CGS."""
    inflow, area, z, period = given
    if _are(Vessel, inflow) or _are(Waveform, area):
        inflow, area = area, inflow
    if _are(Waveform, inflow):
        waveforms = all_of(Waveform, "inflow", np.atleast_1d(inflow))
        units = {**units, "flow": "mL/s"}
        if units.pop("time", "") or not any_grid:
            units["time"] = "s"
        cycle = _common("period", [w.period for w in waveforms], trained.period, any_grid)
        period = cycle if any_grid else period
        inflow = [waveform.samples(trained.time.size) for waveform in waveforms]
    if _are(Vessel, area):
        vessels = all_of(Vessel, "area_undeformed", np.atleast_1d(area))
        units = {**units, "area": "cm^2", "shape": "area", "z": "cm"}
        length = _common("length", [v.length for v in vessels], np.ptp(trained.z), any_grid)
        if any_grid and z is None:
            z = np.linspace(0.0, length, trained.z.size)
        points = trained.z - trained.z[0] if z is None else z
        area = [vessel.area_undeformed(points) for vessel in vessels]
    return units, inflow, area, z, period


def _are(kind: type, value: object) -> bool:
    """Return whether a value is an object of one kind, or a sequence that begins with one."""
    return isinstance(value[0] if isinstance(value, list | tuple) and value else value, kind)


def _common(name: str, values: Sequence[float], trained: float, any_grid: bool) -> float:
    """Return the period or length of all objects, which a model of one grid prescribes."""
    expected = values[0] if any_grid else trained
    for value in values:
        if not math.isclose(value, expected, rel_tol=1e-6):
            raise InputError(
                f"The {name} is {value:g}, but must be {expected:g}: cases that are predicted "
                "together have one grid, and a model other than physics has that of its training."
            )
    return expected


def _check_cycle(inflow: Array, usual: int) -> None:
    """Raise if the last time point repeats the first, or a few seem to be missing or too many."""
    if np.ptp(inflow, axis=-1).all() and np.array_equal(inflow[..., 0], inflow[..., -1]):
        raise InputError(
            "The last time point of the inflow repeats the first: leave it out, inflow[..., :-1]. "
            "If it belongs to the cycle, pass period= (--period) to a model of the preset physics."
        )
    count = inflow.shape[-1]
    if 0 < abs(count - usual) <= usual / 10 and np.ptp(inflow, axis=-1).any():
        raise InputError(
            f"The inflow has {count} time points, the training data {usual}: give {usual}, or pass "
            "period= if these are a whole cycle."
        )


def _check_single(inflow: Array, stated: Mapping[str, str]) -> None:
    """Raise if inflows, (case, time), have several equal cycles."""
    if (count := equal_cycles(inflow.T)) > 1:
        steps = inflow.shape[1] // count
        raise InputError(
            f"The inflow repeats itself {count} times: give one cycle, inflow[..., :{steps}]. "
            "If it is one, pass period= (--period) to a model of the preset physics, or state "
            f"units (--units {text_of(stated, 'cgs')})."
        )


def _rows(name: str, array: Array, length: int, noun: str) -> Array:
    """Return (case, length) or (length,) values in the shape (case, length)."""
    given, array = array.shape, np.atleast_2d(array)
    if array.ndim != 2 or array.shape[1] != length or array.shape[0] == 0:
        hint = " It looks transposed." if array.ndim == 2 and array.shape[0] == length else ""
        raise InputError(
            f"{name} must have the shape (case, {length}), {length} {noun} as in the training "
            f"data, got {given}.{hint}"
        )
    check_finite(name, array)
    return array
