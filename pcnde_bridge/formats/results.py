"""Results of one vessel as another program wrote them, and their way into a data set.

Every reader of this folder parses files into :class:`VesselResults`, and
:func:`to_cases` does the rest for all of them: units, direction of the flow, one whole
cycle, one grid.  What is doubtful is refused with the option that settles it; nothing
is flipped, cut or interpolated unasked.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.tables import read_frame
from pcnde_bridge.validation import whole
from pcnde_bridge.variables import VARIABLES

Array = npt.NDArray[np.float64]
Flip = Literal["flow", "z"]

UNITS: Mapping[str, Mapping[str, float]] = {
    "flow": {
        "mL/s": 1.0,
        "cm^3/s": 1.0,
        "mm^3/s": 1e-3,
        "m^3/s": 1e6,
        "mL/min": 1 / 60,
        "L/min": 1e3 / 60,
    },
    "area": {"cm^2": 1.0, "mm^2": 1e-2, "m^2": 1e4},
    "pressure": {"dyn/cm^2": 1.0, "Pa": 10.0, "kPa": 1e4, "mmHg": 1333.22},
    "z": {"cm": 1.0, "mm": 0.1, "m": 100.0},
    "time": {"s": 1.0, "ms": 1e-3},
}
"""Units that results may have, and their factors into CGS."""

SYSTEMS: Mapping[str, Mapping[str, str]] = {
    "cgs": {"flow": "mL/s", "area": "cm^2", "pressure": "dyn/cm^2", "z": "cm", "time": "s"},
    "mm-g-s": {"flow": "mm^3/s", "area": "mm^2", "pressure": "Pa", "z": "mm", "time": "s"},
    "si": {"flow": "m^3/s", "area": "m^2", "pressure": "Pa", "z": "m", "time": "s"},
}
"""Systems of units by name."""

# What arteries have: median pressure 20 … 300 mmHg, median flow of a small branch … of the
# aorta, median area of a diameter of 0.25 mm … 7 cm, length, and length of the recording.
_USUAL = {
    "pressure": (2.67e4, 4e5),
    "flow": (1e-3, 300.0),
    "area": (5e-4, 40.0),
    "z": (0.1, 150.0),
    "time": (0.1, 60.0),
}
_USUAL_SPEED = (1.0, 300.0)  # cm/s
_USUAL_SLENDERNESS = (0.3, 90.0)  # length over diameter
_UNIFORM = 1e-4  # of a step, as in Cases
_SAME = 1e-6
_SAME_LENGTH = 1e-3
_CLOSED = 0.05
_JUMP = 3.0


class CaseOptions(TypedDict, total=False):
    """The options of :func:`to_cases` that every reader passes on."""

    period: float | None
    units: str | Mapping[str, str] | None
    flip: Flip | None
    instants: int | None
    points: int | npt.ArrayLike | None
    labels: pd.DataFrame | Mapping[str, Any] | None


@dataclass(frozen=True)
class VesselResults:
    """What a file says of one vessel, in its own units, at its own instants and points.

    Attributes
    ----------
    name : str
        The file, for messages.
    flow, area, pressure : array of shape (time, z)
        Averages over the cross-sections.
    area_undeformed : array of shape (z,)
        S_u.
    time, z : array
        Instants; distances along the vessel from its inlet.
    labels : mapping
        Labels that the file holds.
    units : mapping of str to str
        Units that the file states, by ``flow``, ``area``, ``pressure``, ``z``, ``time``.
    period : float or None
        Of the cycle, if the file says.
    """

    name: str
    flow: Array
    area: Array
    pressure: Array
    area_undeformed: Array
    time: Array
    z: Array
    labels: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    period: float | None = None


def to_cases(
    results: Sequence[VesselResults],
    *,
    period: float | None = None,
    units: str | Mapping[str, str] | None = None,
    flip: Flip | None = None,
    instants: int | None = None,
    points: int | npt.ArrayLike | None = None,
    labels: pd.DataFrame | Mapping[str, Any] | None = None,
) -> Cases:
    """Check the results of some vessels and make a data set of them.

    Parameters
    ----------
    results : sequence of VesselResults
        One for each case.
    period : float, optional
        Length of the cycle (s).  Of a longer recording its last whole cycle is taken,
        and an end point that repeats the start is left out; the cycles begin at
        multiples of the period.  By default the recording is one cycle, without its
        end point.
    units : str or mapping, optional
        ``"cgs"``, ``"mm-g-s"`` or ``"si"``, or the units that differ from CGS, such as
        ``{"pressure": "mmHg"}``.  Units that neither you nor the file state are taken
        to be CGS, if the numbers are usual ones of arteries; else they are refused.
    flip : {'flow', 'z'}, optional
        Change the sign of the flow, or let z begin at the other end, where the flow of
        the file runs against its z.
    instants : int, optional
        Resample the cycle to so many equal steps: Fourier series; first, between
        instants of unequal steps, a periodic cubic spline.
    points : int or array of shape (z,), optional
        Resample to so many equally spaced points, or to these (cm): monotone cubic
        interpolation, which overshoots neither at a stenosis nor below zero.
    labels : DataFrame or mapping, optional
        One row for each case, as :class:`Cases` takes them.  By default those of the
        files; else ``geometry`` counts the cases.

    Returns
    -------
    Cases
        In CGS units.

    Raises
    ------
    InputError
        Naming the file, what is doubtful in it, and the option that settles it.
    """
    if not results:
        raise InputError("There are no results to make a data set of: name at least one file.")
    if flip not in (None, "flow", "z"):
        raise InputError(f"flip must be 'flow' or 'z', got {flip!r}.")
    if instants is not None:
        instants = whole("instants", instants, 4)
    stated = _stated(units)
    known = set(SYSTEMS["cgs"]) if isinstance(units, str) else set(stated)
    vessels = []
    for given in results:
        _check(given)
        vessel = _flipped(_in_cgs(given, stated), flip)
        _check_units(vessel, known | set(given.units))
        _check_direction(vessel)
        vessels.append(_on_points(_on_instants(_one_cycle(vessel, period), instants), points))
    first = vessels[0]
    if points is not None and np.ndim(points) == 0:
        vessels = [_of_length(vessel, first) for vessel in vessels]
    for vessel in vessels[1:]:
        _check_grid(first, vessel)
    if labels is None:
        for vessel in vessels[1:]:
            _check_columns(first, vessel)
        labels = _with_keys(pd.DataFrame([dict(v.labels) for v in vessels]))
    stacked = {name: np.stack([getattr(v, name) for v in vessels]) for name in VARIABLES}
    return Cases(
        **stacked,
        area_undeformed=np.stack([vessel.area_undeformed for vessel in vessels]),
        time=first.time,
        z=first.z,
        period=first.period,
        labels=labels,
    )


def _check_columns(first: VesselResults, other: VesselResults) -> None:
    """Refuse labels of which a part would be lost."""
    one, another = sorted(first.labels), sorted(other.labels)
    if one != another:
        raise InputError(
            f"{first.name} has the labels {one}, but {other.name} {another}: give all files the "
            "same, or say what they are, labels= (--labels)."
        )


def read_labels(
    path: str | os.PathLike[str], files: Sequence[str | os.PathLike[str]]
) -> pd.DataFrame:
    """Read the labels of files from a CSV table, in the order of the files.

    Parameters
    ----------
    path : path-like
        Table with the columns ``file``, ``geometry``, ``waveform`` and any others; one
        row for each file, named as in ``files`` or without its folder.
    files : sequence of path-like
        The files.

    Returns
    -------
    DataFrame
        The labels, without the column ``file``.

    Raises
    ------
    FileError
        If the table cannot be read.
    InputError
        If a file has no row, or two.
    """
    table = read_frame(path, dtype={"file": str})
    if "file" not in table:
        raise InputError(f"{path} lacks the column 'file'; it has {list(table.columns)}.")
    rows = []
    for file in files:
        found = np.flatnonzero(table["file"].isin([str(file), Path(file).name]))
        if found.size != 1:
            raise InputError(f"{path} has {found.size} rows for {file}; it needs one.")
        rows.append(int(found[0]))
    return table.iloc[rows].drop(columns="file").reset_index(drop=True)


def _with_keys(labels: pd.DataFrame) -> pd.DataFrame:
    """Add the columns that name a case, where the files have none."""
    for name, values in (("geometry", np.arange(len(labels))), ("waveform", 0)):
        if name not in labels:
            labels[name] = values
    return labels


# ---- what the arrays hold ------------------------------------------------


def _check(vessel: VesselResults) -> None:
    n_times, n_points = vessel.time.size, vessel.z.size
    if n_times < 4 or n_points < 3:
        raise InputError(
            f"{vessel.name} has {n_times} instants and {n_points} points; at least 4 and 3 are "
            "needed."
        )
    expected: dict[str, tuple[int, ...]] = dict.fromkeys(VARIABLES, (n_times, n_points))
    expected["area_undeformed"] = (n_points,)
    for name, shape in expected.items():
        array = getattr(vessel, name)
        if array.shape != shape:
            swapped = "; it looks transposed" if array.shape == shape[::-1] else ""
            raise InputError(
                f"{vessel.name}: {name} has the shape {array.shape}, but time and z make "
                f"{shape}{swapped}."
            )
    for name in (*VARIABLES, "area_undeformed", "time", "z"):
        array = getattr(vessel, name)
        bad = ~np.isfinite(array)
        rule = "is not finite"
        if "area" in name and not bad.any():
            bad, rule = array <= 0, "is not positive"
        if bad.any():
            at = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(
                f"{vessel.name}: {name}{list(at)} is {array[at]:g}, which {rule} "
                f"({np.count_nonzero(bad)} such values)."
            )
    for name in ("time", "z"):
        axis = getattr(vessel, name)
        if (np.diff(axis) <= 0).any():
            index = int(np.argmax(np.diff(axis) <= 0)) + 1
            raise InputError(
                f"{vessel.name}: {name}[{index}] = {axis[index]:g} is not larger than "
                "the one before it; sort the results, and leave out what is there twice."
            )


def _check_grid(first: VesselResults, other: VesselResults) -> None:
    for name, option in (("time", "instants"), ("z", "points")):
        mine, theirs = getattr(first, name), getattr(other, name)
        if mine.shape != theirs.shape or not np.allclose(mine, theirs, 0, _SAME * np.ptp(mine)):
            raise InputError(
                f"{first.name} has {mine.size} values of {name} from {mine[0]:g} to {mine[-1]:g}, "
                f"{other.name} {theirs.size} from {theirs[0]:g} to {theirs[-1]:g}: a data set has "
                f"one grid. Resample with {option}= (--{option}) where they differ in number; "
                "vessels of other lengths or periods need data sets of their own."
            )
    assert first.period is not None
    assert other.period is not None
    if not math.isclose(first.period, other.period, rel_tol=_SAME):
        raise InputError(
            f"The cycle of {first.name} takes {first.period:g} s, that of {other.name} "
            f"{other.period:g} s; a data set has one period."
        )


# ---- units and direction ---------------------------------------------------


def _stated(units: str | Mapping[str, str] | None) -> dict[str, str]:
    """Return the units that the caller states."""
    if units is None:
        return {}
    if isinstance(units, str):
        if units not in SYSTEMS:
            raise InputError(
                f"Unknown units {units!r}; give one of {sorted(SYSTEMS)}, or a mapping such as "
                "{'pressure': 'mmHg'}."
            )
        return dict(SYSTEMS[units])
    if not isinstance(units, Mapping):
        raise InputError(f"units must be a name or a mapping, got {units!r}.")
    for name, unit in units.items():
        if name not in UNITS:
            raise InputError(f"units names {name!r}; it can name {sorted(UNITS)}.")
        if unit not in UNITS[name]:
            raise InputError(f"Unknown unit {unit!r} of {name}; known are {list(UNITS[name])}.")
    return dict(units)


def _in_cgs(vessel: VesselResults, stated: Mapping[str, str]) -> VesselResults:
    unit = {**SYSTEMS["cgs"], **vessel.units, **stated}
    factor = {name: UNITS[name][unit[name]] for name in UNITS}
    factor["area_undeformed"] = factor["area"]
    period = None if vessel.period is None else vessel.period * factor["time"]
    arrays = {name: f * getattr(vessel, name) for name, f in factor.items()}
    return _changed(vessel, arrays, period=period)


def _flipped(vessel: VesselResults, flip: Flip | None) -> VesselResults:
    if flip == "flow":
        return dataclasses.replace(vessel, flow=-vessel.flow)
    if flip == "z":
        # The flow's sign is that of the file's own direction, which turns too.
        arrays = {name: getattr(vessel, name)[:, ::-1] for name in VARIABLES}
        arrays |= {"flow": -arrays["flow"], "area_undeformed": vessel.area_undeformed[::-1]}
        return _changed(vessel, arrays, z=vessel.z[0] + vessel.z[-1] - vessel.z[::-1])
    return vessel


def _changed(vessel: VesselResults, arrays: Mapping[str, Array], **other: Any) -> VesselResults:
    return dataclasses.replace(vessel, **arrays, **other)  # type: ignore[arg-type]


def _check_units(vessel: VesselResults, stated: set[str]) -> None:
    """Refuse numbers that arteries do not have in CGS units, where nobody stated these."""
    diameter = math.sqrt(4 / math.pi * float(np.median(vessel.area_undeformed)))
    area = float(np.median(vessel.area_undeformed))
    flow = float(np.median(np.abs(vessel.flow)))
    length = float(np.ptp(vessel.z))
    sizes = {
        "pressure": float(np.median(np.abs(vessel.pressure))),
        "flow": flow,
        "area": area,
        "z": length,
        "time": float(np.ptp(vessel.time)),
    }
    said = {
        "pressure": "the median pressure",
        "flow": "the median flow",
        "area": "the median undeformed area",
        "z": "the length of the vessel",
        "time": "the length of the recording",
    }
    doubts = [
        _doubt(name, said[name], size, *_USUAL[name])
        for name, size in sizes.items()
        if name not in stated and size > 0
    ]
    if not any(doubts):
        # Each may be usual alone, and yet not go with the others.
        if not {"flow", "area"} <= stated and flow > 0:
            doubts.append(_doubt("flow", "flow over area", flow, *_USUAL_SPEED, over=area))
        if not {"z", "area"} <= stated:
            what = "the length over the diameter"
            doubts.append(_doubt("z", what, length, *_USUAL_SLENDERNESS, over=diameter))
        if "area" not in stated and not 0.2 <= (ratio := np.median(vessel.area) / area) <= 5:
            doubts.append(f"the median area is {ratio:.3g} times the undeformed one")
    if found := [doubt for doubt in doubts if doubt]:
        raise InputError(
            f"{vessel.name} does not look like CGS units (cm, s, mL/s, cm², dyn/cm²): "
            + "; ".join(found)
            + ". State the units, or units='cgs' (--units cgs) if they are."
        )


def _doubt(name: str, what: str, size: float, low: float, high: float, over: float = 1.0) -> str:
    """Say what is unusual, and in which units it would not be."""
    if low <= size / over <= high:
        return ""
    usual = [unit for unit, f in UNITS[name].items() if low <= f * size / over <= high]
    hint = f"in {usual[0]} it would be usual: units={{'{name}': '{usual[0]}'}}" if usual else ""
    hint += f" (--units {name}={usual[0]})" if usual else "it is usual in no unit known here"
    return f"{what} is {size / over:.4g}; {hint}"


def _check_direction(vessel: VesselResults) -> None:
    mean = vessel.flow.mean(axis=0)
    scale = np.abs(vessel.flow).max()
    inlet, outlet = mean[0], mean[-1]
    if inlet < -1e-3 * scale:
        raise InputError(
            f"{vessel.name}: the flow runs against z, its mean is {inlet:.4g} mL/s at the first "
            "point. If flow out of the vessel counts as positive there, pass flip='flow' "
            "(--flip flow); if the points run from the outlet to the inlet, flip='z' (--flip z)."
        )
    if inlet > 1e-3 * scale and outlet < -1e-3 * scale:
        raise InputError(
            f"{vessel.name}: the mean flow is {inlet:.4g} mL/s at the first point and {outlet:.4g} "
            "at the last: the sign changes on the way. Give flow along z the same sign at all "
            "points."
        )


# ---- one cycle, one grid ----------------------------------------------------


def _one_cycle(vessel: VesselResults, period: float | None) -> VesselResults:
    """Take the last whole cycle, at phases from 0 on if the period is known."""
    cycle = vessel.period if period is None else period
    time = vessel.time
    span, step = float(np.ptp(time)), float(np.diff(time).max())
    if cycle is None:
        if not _uniform(time):
            raise InputError(
                f"{vessel.name}: the time steps are not equal, from {np.diff(time).min():g} to "
                f"{np.diff(time).max():g} s: pass the period, and instants= (--period, "
                "--instants) to resample."
            )
        if _meets(vessel, 0, -1, 1e-6) and np.ptp(vessel.flow[:, 0]) > 0:
            raise InputError(
                f"{vessel.name}: the last instant repeats the first, one period later. Pass "
                f"period={span:g} (--period {span:g}), which leaves it out."
            )
        inflow = vessel.flow[:, 0]
        if abs(inflow[0] - inflow[-1]) > _JUMP * np.abs(np.diff(inflow)).max():
            raise InputError(
                f"{vessel.name} is not one cycle: the flow at its inlet ends at {inflow[-1]:.4g} "
                f"mL/s and begins at {inflow[0]:.4g}, which is no step of a smooth wave. Pass the "
                "period (--period)."
            )
        return dataclasses.replace(vessel, period=span * time.size / (time.size - 1))
    if not (isinstance(cycle, int | float | np.number) and math.isfinite(cycle) and cycle > 0):
        raise InputError(f"period must be a positive number of seconds, got {cycle!r}.")
    tolerance = 1e-3 * float(np.diff(time).min())
    if span + step < cycle - tolerance:
        raise InputError(f"{vessel.name} covers {span:g} s, less than the period of {cycle:g} s.")
    taken = np.flatnonzero(time > time[-1] - cycle + tolerance)
    before = taken[0] - 1
    compared = before >= 0 and abs(time[-1] - cycle - time[before]) <= tolerance
    if compared and not _meets(vessel, before, -1, _CLOSED):
        raise InputError(
            f"{vessel.name} is not periodic: one period of {cycle:g} s before its end it differs "
            f"from the end by more than {_CLOSED:.0%} of the cycle's range. Give the right period, "
            "or simulate more cycles."
        )
    phase = np.mod(time[taken], cycle)
    phase[cycle - phase <= tolerance] = 0.0
    order = np.argsort(phase)
    arrays = {name: getattr(vessel, name)[taken[order]] for name in VARIABLES}
    return _changed(vessel, arrays, time=phase[order], period=float(cycle))


def _meets(vessel: VesselResults, one: int, other: int, tolerance: float) -> bool:
    """Whether two instants are alike, up to a part of each field's range."""
    return all(
        np.abs(field[one] - field[other]).max() <= tolerance * np.ptp(field)
        for field in (getattr(vessel, name) for name in VARIABLES)
    )


def _uniform(time: Array, period: float | None = None) -> bool:
    step = np.ptp(time) / (time.size - 1)
    equal = np.abs(time - time[0] - step * np.arange(time.size)).max() <= _UNIFORM * step
    return bool(equal and (period is None or abs(step * time.size - period) <= _SAME * period))


def _on_instants(vessel: VesselResults, instants: int | None) -> VesselResults:
    time, period = vessel.time, vessel.period
    assert period is not None
    if _uniform(time, period) and instants in (None, time.size):
        return vessel
    if instants is None:
        raise InputError(
            f"{vessel.name}: its {time.size} instants are not equal steps of the period of "
            f"{period:g} s: pass instants= (--instants), such as 100, to resample."
        )
    arrays = {name: _periodic(time, getattr(vessel, name), period, instants) for name in VARIABLES}
    return _changed(vessel, arrays, time=time[0] + period / instants * np.arange(instants))


def _periodic(time: Array, values: Array, period: float, instants: int) -> Array:
    """Resample (time, z) to equal steps of a period from the first instant."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample

    if not _uniform(time, period):
        closed = np.concatenate([values, values[:1]])
        spline = CubicSpline(np.append(time, time[0] + period), closed, bc_type="periodic")
        shortest = np.diff(np.append(time, time[0] + period)).min()
        fine = min(max(instants, math.ceil(period / shortest)), 10_000)
        values = spline(time[0] + period / fine * np.arange(fine))
    resampled: Array = resample(values, instants, axis=0)
    return resampled


def _on_points(vessel: VesselResults, points: int | npt.ArrayLike | None) -> VesselResults:
    if points is None:
        return vessel
    if np.ndim(points) == 0:
        count = whole("points", points, 3)
        z = np.linspace(vessel.z[0], vessel.z[-1], count)
    else:
        z = np.asarray(points, dtype=np.float64)
        slack = _SAME_LENGTH * np.ptp(vessel.z)
        if z.ndim != 1 or z.min() < vessel.z[0] - slack or z.max() > vessel.z[-1] + slack:
            raise InputError(
                f"{vessel.name} reaches from z = {vessel.z[0]:g} to {vessel.z[-1]:g} cm; the "
                "points asked for must be a row of numbers inside."
            )
    along = _interpolator(vessel.z, np.clip(z, vessel.z[0], vessel.z[-1]))
    changed = {name: along(getattr(vessel, name)) for name in (*VARIABLES, "area_undeformed")}
    return _changed(vessel, changed, z=z)


def _interpolator(old: Array, new: Array) -> Callable[[Array], Array]:
    from scipy.interpolate import PchipInterpolator

    return lambda values: np.asarray(PchipInterpolator(old, values, axis=-1)(new))


def _of_length(vessel: VesselResults, first: VesselResults) -> VesselResults:
    """Give equally spaced points of a length that differs by rounding that of the first."""
    if abs(np.ptp(vessel.z) - np.ptp(first.z)) <= _SAME_LENGTH * np.ptp(first.z):
        return dataclasses.replace(vessel, z=first.z)
    return vessel
