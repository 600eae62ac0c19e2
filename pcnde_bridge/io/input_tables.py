"""Tables of inflow waveforms and undeformed areas, the inputs of ``pcnde predict``."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.validation import listed, naming
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.single_vessel import check_samples
from pcnde_bridge.data.units import (
    FACTORS,
    SHAPES,
    SYSTEMS,
    in_cgs,
    option_of,
    stated_units,
    usual_spelling,
)
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.io.tables import first_line, line_of, numbers, read_frame

_Units: TypeAlias = str | Mapping[str, str] | None
_SAME = 1e-6  # of a step, a range or an axis
_AXES = {"time": ("time", "t"), "z": ("z", "x", "s", "distance", "position", "path")}
_NAMES = {"flow", "area", "radius", "diameter", "pressure", "velocity", "speed"}
_SPEEDS = "cm/s", "mm/s", "m/s"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def _read(path: StrPath, axis: str, units: _Units) -> tuple[Array, pd.DataFrame]:
    """Return the axis in the first column, and the columns of the cases; nothing is converted.

    Columns are separated by commas, by semicolons (with decimal commas or points) or by tabs.
    Files without names of columns have two columns of numbers, as the waveforms of openBF
    (``.dat``) and SimVascular (``.flow``), where flow into the vessel is negative.
    """
    first = first_line(path)
    words = re.split(r"[\s,;]+", first.strip())
    unnamed = len(words) == 2 and all(map(_NUMBER.fullmatch, words))
    marks, other = (",;", r"\s+") if unnamed else (",;\t", ",")
    separator = next((mark for mark in marks if mark in first), other)
    options: dict[str, Any] = {"decimal": "," if separator == ";" else "."}
    if unnamed:
        options = {"header": None, "names": [axis, Path(path).stem], "comment": "#"}
    frame = read_frame(path, sep=separator, **options)
    name, _, unit = str(frame.columns[0]).strip(" )]").replace("[", "(").partition("(")
    if frame.shape[1] < 2 or name.strip().lower() not in _AXES[axis]:
        raise InputError(f"{path} must have the columns {axis}, then one per case, not {[*frame]}.")
    stated = stated_units(units)
    if unit and (unit := usual_spelling(unit)) != stated.get(axis, SYSTEMS["cgs"][axis]):
        known = f"known are {[*FACTORS[axis]]}"
        advice = f"pass {option_of(stated, axis, unit)}" if unit in FACTORS[axis] else known
        raise InputError(f"{path} gives {axis} in {unit}: {advice}.")
    for column in frame.columns[1:]:
        _check_unit(path, str(column), "flow" if axis == "time" else "area", stated)
    found = pd.DataFrame({name: numbers(path, frame[name]) for name in frame})
    values = found.iloc[:, 0].to_numpy()
    inwards = not (unnamed and Path(path).suffix.lower() == ".flow")
    cases = (1 if inwards else -1) * found.iloc[:, 1:]
    return values, cases.rename(columns=lambda name: str(name).strip())


def _check_unit(path: StrPath, column: str, quantity: str, units: Mapping[str, str]) -> None:
    """Raise if a column has the name of another quantity, or ends with a unit, as Q (L/min)."""
    word, shape = re.split(r"[^a-z]", column.strip().lower())[0], units.get("shape", "area")
    if word in _NAMES - {quantity, shape if quantity == "area" else ""}:
        lengths = quantity == "area" and word in SHAPES
        advice = f" State its unit, such as {option_of(units, word, 'mm')}." if lengths else ""
        raise InputError(f"{path}, column {column}: {quantity} is expected, not {word}.{advice}")
    found = re.search(r"[(\[]([^()\[\]]+)[)\]]$", column.strip())
    unit = usual_spelling(found[1]) if found else ""
    known = {*_SPEEDS, *(name for units in FACTORS.values() for name in units)}
    expected, possible = units.get(quantity, SYSTEMS["cgs"][quantity]), FACTORS[quantity]
    if quantity == "area" and units.get("shape", "area") != "area":
        expected, possible = expected.removesuffix("^2"), FACTORS["z"]
    if unit not in known or possible.get(unit) == possible[expected]:
        return
    can_be = {*FACTORS[quantity], *(FACTORS["z"] if quantity == "area" else ())}
    option = option_of(units, quantity, unit) if unit in can_be else ""
    advice = f" If it is in {unit}, pass {option}." if option else ""
    raise InputError(f"{path}, column {column}: {quantity} in {expected} is expected.{advice}")


def _rows(columns: pd.DataFrame) -> Array:
    return np.ascontiguousarray(columns.to_numpy(dtype=np.float64).T)


def read_cycle(
    path: StrPath,
    start: float,
    usual_period: float,
    *,
    period: float | None = None,
    time_points: int | None = None,
    any_period: bool = True,
    units: _Units = None,
) -> tuple[float, pd.DataFrame]:
    """Read waveforms of one cycle, without its end point.

    Parameters
    ----------
    path : path-like
        Table whose first column is named ``time``, or two columns without names.
    start : float
        First time point of the model's cycle, s.
    usual_period : float
        Period of the model's training data, s, or NaN; another one must be given.
    period : float, optional
        Length of the cycle, s; a time point at its end, which repeats the first, is left
        out.  By default the number of time points times their distance, if that is the usual one.
    time_points : int, optional
        Interpolate to this number of equal steps, by :meth:`Waveform.from_samples`.
    any_period : bool
        Whether the model accepts other periods, for messages.
    units : str or mapping, optional
        Stated units, which names of columns must not contradict; only the time is converted.

    Returns
    -------
    period : float
        Length of the cycle, s.
    columns : DataFrame
        One column for each case, one row for each time point.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric; or if the time points begin at another time,
        include the end point while no period is given, do not cover the period, or are not
        equally spaced while they are not to be interpolated.
    """
    time, columns = _read(path, "time", units)
    time = in_cgs("time", time, stated_units(units))
    if time.size < 2:
        raise InputError(f"{path} has {time.size} time points; a cycle needs more.")
    _check_sorted(path, "time", time)
    span, steps = float(time[-1] - time[0]), np.diff(time)
    if abs(time[0] - start) > _SAME * max(span, abs(start)) and time_points is None:
        raise InputError(
            f"{path}, line {line_of(path, 0)}: time starts at {time[0]:g} s, but it must start at "
            f"{start:g} s, as the model's cycle does; shift the cycle, or pass --interpolate."
        )
    closed = _is_closed(_rows(columns), math.isclose(span, usual_period, rel_tol=1e-6))
    if period is None:
        if closed and Path(path).suffix.lower() not in (".flow", ".dat"):
            raise InputError(
                f"{path}, line {line_of(path, time.size - 1)}: the cycle's end repeats its start. "
                f"Leave the last line out, or pass the period (--period {span:g}); if the cycle "
                "goes on after it, pass the period of the whole cycle."
            )
        period = span if closed else _period_of(path, time, usual_period, any_period, units)
    elif abs(span - period) > _SAME * period and not span < period <= span + 1.01 * steps.max():
        raise InputError(
            f"{path} covers {span:g} s, not one cycle of {period:g} s: correct --period."
            f"{_other_unit('time', span, period, units)}"
        )
    if abs(span - period) <= 1e-3 * steps.min():
        time, columns, steps = time[:-1], columns.iloc[:-1], steps[:-1]
    if time_points is not None:
        with naming(path):
            check_samples("the flow", columns.to_numpy(), time, "case")
        at = start + np.arange(time_points) * (period / time_points)
        terms = min(60, (time_points - 1) // 2)  # harmonics that these time points can hold
        return period, columns.apply(
            lambda flow: pd.Series(Waveform.from_samples(flow, time, period, terms).flow(at))
        )
    step = period / time.size
    off = np.abs(steps - step)
    if off.max() > _SAME * step * time.size:
        raise InputError(
            f"{path}, line {line_of(path, int(off.argmax()) + 1)}: the time points are not equally "
            f"spaced over the period of {period:g} s, without its end point. Pass --interpolate, "
            "or in Python a Waveform.from_samples(flow, time, period)."
        )
    return period, columns


def _check_sorted(path: StrPath, axis: str, values: Array) -> None:
    if (wrong := ~(np.diff(values) > 0)).any():
        line = line_of(path, int(wrong.argmax()) + 1)
        raise InputError(f"{path}, line {line}: {axis} must increase: sort the rows by {axis}.")


def _only_period(period: float) -> str:
    """Return the advice for models of the presets paper and fast."""
    return (
        f"this model predicts cycles of {period:g} s only, as in its training; for another period "
        "use a model of the preset physics"
    )


def _period_of(path: StrPath, time: Array, usual: float, any_period: bool, units: _Units) -> float:
    """Return the length of a cycle without its end point, which must be the usual one."""
    span, steps = float(time[-1] - time[0]), np.diff(time)
    period = span * time.size / (time.size - 1)
    if abs(period - usual) > 1e-3 * usual:
        advice = "Add what is missing, or"
        if abs(span - usual) < 1e-3 * steps.min():
            advice = f"If it includes the cycle's end, pass --period {span:g}; or"
        advice += f" pass --period {period:g} if it is the whole cycle."
        found = f"{time.size} time points in steps of {steps[0]:g} s are a cycle of {period:g} s"
        contrast = f"that of the training data has {usual:g} s. {advice}"
        if not any_period and abs(span - usual) >= 1e-3 * steps.min():
            contrast = f"{_only_period(usual)}. If rows are missing, add them."
        hint = _other_unit("time", period, usual, units)
        raise InputError(f"{path}: {found}, but {contrast}{hint}")
    # The mean of unequal steps says little about the last one.
    unequal = np.ptp(steps) > 1e-3 * steps.min()
    return usual if unequal and not math.isnan(usual) else period


def read_candidates(
    inflow: StrPath, area: StrPath, period: float | None = None, units: _Units = None
) -> tuple[Array, Array, Grid]:
    """Read inflows and undeformed areas that are not paired.

    Parameters
    ----------
    inflow, area, period, units
        As in :func:`read_inputs`; the time points must be equally spaced and start at 0.

    Returns
    -------
    inflow : array of shape (waveform, time)
        Q, mL/s.
    area_undeformed : array of shape (geometry, z)
        S_u, cm².
    grid : Grid
        Time points and points, in the units of the tables.

    Raises
    ------
    FileError
        If a file cannot be read as a table.
    InputError
        If a table is not usable.
    """
    cycle, waveforms = read_cycle(inflow, 0.0, math.nan, period=period, units=units)
    cycle /= in_cgs("time", 1.0, stated_units(units))
    z, vessels = _read(area, "z", units)
    _check_sorted(area, "z", z)
    if not (vessels > 0).all(axis=None):
        raise InputError(f"{area} must hold positive areas, in cm².")
    time: Array = np.arange(len(waveforms), dtype=np.float64) * (cycle / len(waveforms))
    return _rows(waveforms), _rows(vessels), Grid(time, z, cycle)


def _is_closed(waveforms: Array, usual_length: bool) -> bool:
    """Return whether the last time point repeats the first, up to round-off.

    Constant waveforms do only if the recording has the usual length of a cycle.
    """
    if not np.isfinite(waveforms).all():
        return False
    size = np.ptp(waveforms, axis=1)
    repeats = np.abs(waveforms[:, -1] - waveforms[:, 0]) <= _SAME * size
    return bool(repeats.all() and (size.any() or usual_length))


def read_columns(
    path: StrPath, axis: str, expected: Array, units: _Units = None, *, interpolate: bool = False
) -> pd.DataFrame:
    """Read one column for each case on the grid of a model.

    Parameters
    ----------
    path : path-like
        CSV file whose first column is named ``axis``.
    axis : str
        ``"time"`` or ``"z"``.
    expected : array of shape (n,)
        Values that the axis must have.
    units : str or mapping, optional
        Units of the file; only the axis is converted.
    interpolate : bool
        Bring columns that cover the same range to the grid, by monotone cubic interpolation.

    Returns
    -------
    DataFrame
        The other columns, one for each case.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric, or the axis has other values.
    """
    found, columns = _read(path, axis, units)
    found, unit = in_cgs(axis, found, stated_units(units)), SYSTEMS["cgs"][axis]
    covered = f"from {expected[0]:g} to {expected[-1]:g} {unit}"
    if found.size and (hint := _other_unit(axis, np.ptp(found), np.ptp(expected), units)):
        raise InputError(f"{path} has {axis} up to {found[-1]:g}; the model works {covered}.{hint}")
    if interpolate:
        from scipy.interpolate import PchipInterpolator

        _check_sorted(path, axis, found)
        if abs(found[[0, -1]] - expected[[0, -1]]).max() > 1e-3 * np.ptp(expected):
            given = f"from {found[0]:g} to {found[-1]:g}"
            raise InputError(f"{path} has {axis} {given}; the model works {covered}.")
        at = np.clip(expected, found[0], found[-1])
        return pd.DataFrame(PchipInterpolator(found, columns)(at), columns=columns.columns)
    if len(found) == len(expected) + 1 and _is_closed(_rows(columns), axis == "time"):
        line = line_of(path, len(expected))
        raise InputError(f"{path}, line {line}: the cycle's end repeats its start: leave it out.")
    increases = (np.diff(found) > 0).all()
    advice = "pass --interpolate" if increases else f"sort the rows by {axis}"
    if axis == "time" and increases and found.size > 1:
        step, steps = np.ptp(expected) / (expected.size - 1), found.size - 1
        cycle, span = step * expected.size, np.ptp(found)
        if min(abs(span - cycle), abs(span * found.size / steps - cycle)) > 1e-3 * cycle:
            advice = _only_period(cycle)
    if len(found) != len(expected):
        raise InputError(
            f"{path} has {len(found)} rows, but the model works on {len(expected)} values of "
            f"{axis} {covered}: {advice}."
        )
    worst = int(np.abs(found - expected).argmax())
    if abs(found[worst] - expected[worst]) > _SAME * (1 + np.abs(expected).max()):
        raise InputError(
            f"{path}, line {line_of(path, worst)}: {axis} is {found[worst]:g} {unit}, but the "
            f"model works at {expected[worst]:g} {unit}: {advice}."
        )
    return columns


def _other_unit(axis: str, span: float, expected: float, units: _Units) -> str:
    """Return a hint if an axis has the expected span in another unit, and its unit is open."""
    stated = stated_units(units)
    for unit, factor in FACTORS[axis].items() if axis not in stated else ():
        if factor != 1 and abs(factor * span - expected) <= 0.3 * expected:
            return f" This looks like {unit}: pass {option_of(stated, axis, unit)}."
    return ""


class CaseInputs(NamedTuple):
    """Inputs of the cases to predict.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Flow rate Q at the inlet, mL/s.
    area_undeformed : array of shape (case, z)
        Undeformed area S_u, cm².  Either array may have one row, which then holds for
        all cases.
    names : list of str
        Names of the cases.
    where : dict of str to object
        ``z`` and ``period`` for a model that accepts any grid; else empty.
    """

    inflow: Array
    area_undeformed: Array
    names: list[str]
    where: dict[str, Any]

    def name_labels(self, labels: pd.DataFrame) -> pd.DataFrame:
        """Return labels of predicted cases with the additional column ``name``."""
        return labels.assign(name=[self.names[case] for case in labels["case"]])


def read_inputs(
    inflow: StrPath,
    area: StrPath,
    grid: Grid,
    *,
    any_grid: bool,
    units: str | Mapping[str, str] | None = None,
    period: float | None = None,
    interpolate: bool = False,
) -> CaseInputs:
    """Read inflows and undeformed areas, and pair their columns.

    Columns are paired by name if both tables have the same names, and by position if no
    name is common or one table has a single column for all cases.

    Parameters
    ----------
    inflow : path-like
        CSV file: ``time`` (s), then a column of Q (mL/s) for each case.
    area : path-like
        CSV file: ``z`` (cm), then a column of S_u (cm²) for each case.
    grid : Grid
        Grid of the model.
    any_grid : bool
        Whether the model accepts other time points and points.
    units : str or mapping, optional
        Units of the tables as for :meth:`pcnde_bridge.PCNDE.predict`, which converts all
        results of this function.
    period : float, optional
        Length of the cycle, s.
    interpolate : bool
        Bring waveforms, and areas where the model needs it, to the model's grid.

    Returns
    -------
    CaseInputs
        The cases in the order of the inflow's columns.

    Raises
    ------
    FileError
        If a file cannot be read as a table.
    InputError
        As :func:`read_cycle` and :func:`read_columns`, or if some but not all of the
        columns have the same name in both files.
    """
    where: dict[str, Any] = {}
    if any_grid or interpolate or period is not None:
        count = grid.time.size if interpolate else None
        if not (any_grid or period is None or math.isclose(period, grid.period, rel_tol=1e-6)):
            raise InputError(f"--period is {period:g} s, but {_only_period(grid.period)}.")
        options: dict[str, Any] = {"time_points": count, "any_period": any_grid, "units": units}
        options["period"] = period
        found, q = read_cycle(inflow, grid.time[0], grid.period, **options)
        if any_grid:
            where["period"] = found / in_cgs("time", 1.0, stated_units(units))
        elif not math.isclose(found, grid.period, rel_tol=1e-6):
            raise InputError(f"{inflow} covers {found:g} s, but {_only_period(grid.period)}.")
        elif len(q) != grid.time.size:
            raise InputError(
                f"{inflow} has {len(q)} time points over the cycle, but the model works at "
                f"{grid.time.size}: pass --interpolate."
            )
    else:
        q = read_columns(inflow, "time", grid.time, units)
    if any_grid:
        where["z"], s_u = _read(area, "z", units)
        _check_sorted(area, "z", where["z"])
    else:
        s_u = read_columns(area, "z", grid.z, units, interpolate=interpolate)
    by_inflow, by_area = ([str(name) for name in table.columns] for table in (q, s_u))
    if min(len(by_inflow), len(by_area)) > 1:
        folded = {name.casefold(): name for name in by_inflow}
        s_u.columns = pd.Index([folded.get(name.casefold(), name) for name in by_area])
        alone = sorted(set(by_inflow) ^ set(s_u.columns))
        if not alone:
            s_u = s_u[q.columns]
        elif set(by_inflow) & set(s_u.columns):
            raise InputError(
                f"{inflow} and {area} have some names of cases in common, but {listed(alone)} only "
                "one of them: use the same names, or none in common to pair columns by position."
            )
    names = by_inflow if len(by_inflow) >= len(by_area) else by_area
    return CaseInputs(_rows(q), _rows(s_u), names, where)
