"""Whether arrays and labels can be a data set: what is wrong with them, where, what to do."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from itertools import permutations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from pcnde_bridge._utils.validation import (
    check_finite,
    check_increasing,
    check_values,
    counted,
    real_array,
)
from pcnde_bridge.data.variables import UNITS, VARIABLES
from pcnde_bridge.errors import InputError, PCNDEWarning

FloatArray = NDArray[np.float64]

_AXES = ("case", "time", "z")
_TAKEN = frozenset((*UNITS, "novelty"))  # by a prediction's own columns


class UnitsWarning(PCNDEWarning):
    """The size of the numbers suggests that they are not in CGS units."""


def check_arrays(given: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    """Return copies of the arrays of a data set, by their names.

    Raises
    ------
    InputError
        If one has the wrong kind of number, shape, or values that it cannot have.
    """
    arrays = {name: real_array(name, value) for name, value in given.items()}
    _check_shapes(arrays)
    for name, array in arrays.items():
        check_finite(name, array)
    for name in ("area", "area_undeformed"):
        check_values(name, arrays[name], arrays[name] <= 0, "areas must be positive (cm²)")
    check_increasing("z", arrays["z"], "cm")
    return arrays


def _check_shapes(arrays: Mapping[str, FloatArray]) -> None:
    """Compare every shape with the lengths of time, z and the cases."""
    for name in ("time", "z"):
        if arrays[name].ndim != 1:
            raise InputError(f"{name} must have one axis, but its shape is {arrays[name].shape}")
    n_times, n_points = len(arrays["time"]), len(arrays["z"])
    if n_times < 4:
        raise InputError(f"time has {counted(n_times, 'instant')}; at least 4 are needed")
    if n_points < 3:
        raise InputError(f"z has {counted(n_points, 'point')}; at least 3 are needed")
    undeformed = arrays["area_undeformed"].shape
    if undeformed != (*undeformed[:1], n_points):
        raise InputError(
            f"area_undeformed must have the shape (case, z) = (n_cases, {n_points}), but its shape "
            f"is {undeformed}" + (_one_case_hint("area_undeformed") if len(undeformed) == 1 else "")
        )
    n_cases = undeformed[0]
    if n_cases < 1:
        raise InputError("there is no case: area_undeformed has length 0 along its first axis")
    expected = (n_cases, n_times, n_points)
    for name in VARIABLES:
        shape = arrays[name].shape
        if shape != expected:
            raise InputError(
                f"{name} must have the shape (case, time, z) = {expected}, as area_undeformed, "
                f"time and z say, but its shape is {shape}{_axes_hint(name, shape, expected)}"
            )


def _axes_hint(name: str, shape: tuple[int, ...], expected: tuple[int, int, int]) -> str:
    """Name a swapped axis order when the shape gives it away."""
    if len(shape) == 2:
        return _one_case_hint(name)
    for order in permutations(range(3)):
        if tuple(expected[axis] for axis in order) == shape:
            found = ", ".join(_AXES[axis] for axis in order)
            back = tuple(order.index(axis) for axis in range(3))
            return f"; that looks like ({found}): pass np.transpose({name}, {back})"
    return ""


def _one_case_hint(name: str) -> str:
    return f"; for a single case pass {name}[np.newaxis]"


def check_time(arrays: Mapping[str, FloatArray], period: float | None) -> float:
    """Check that the instants divide the period evenly; return the period."""
    time = arrays["time"]
    n_times = len(time)
    step = float(time[-1] - time[0]) / (n_times - 1)
    if step <= 0:
        raise InputError("time must increase (s); it ends before it starts")
    # A ten-thousandth of a step leaves room for times stored in single precision.
    off = np.abs(time - (time[0] + step * np.arange(n_times))) > 1e-4 * step
    check_values("time", time, off, f"time must have uniform steps (here {step:g} s)")
    cycle = n_times * step
    end_repeated = (
        "the last instant repeats the first, one period later; leave it out (time[:-1], "
        "flow[:, :-1], area[:, :-1], pressure[:, :-1])"
    )
    if period is None:
        fields = [arrays[name] for name in VARIABLES]
        closed = all(np.array_equal(field[:, 0], field[:, -1]) for field in fields)
        steady = all(np.array_equal(field[:, 0], field[:, 1]) for field in fields)
        if closed and not steady:
            raise InputError(f"{end_repeated}, or pass period= if it does not")
        return cycle
    if isinstance(period, bool) or not isinstance(period, (int, float, np.integer, np.floating)):
        raise InputError(f"period must be a number of seconds; {period!r} is not")
    if abs(cycle - period) <= 1e-6 * abs(period):
        return float(period)
    if abs(cycle - step - period) <= 1e-3 * step:
        why = end_repeated
    elif abs(cycle + step - period) <= 1e-3 * step:
        why = "the last instant of the cycle is missing"
    else:
        why = "time must cover one period, without its end point"
    raise InputError(
        f"period is {period:g} s, but {n_times} instants in steps of {step:g} s make "
        f"{cycle:g} s: {why}"
    )


def check_labels(
    labels: pd.DataFrame | Mapping[str, Any] | None, area_undeformed: FloatArray
) -> pd.DataFrame:
    """Return the labels as a clean table: geometry, waveform, blockage, the rest."""
    n_cases = len(area_undeformed)
    if labels is None:
        labels = {"geometry": np.arange(n_cases), "waveform": np.zeros(n_cases, dtype=int)}
    try:
        given = pd.DataFrame(labels)
    except (ValueError, TypeError) as error:
        raise InputError(f"labels cannot be made into a DataFrame: {error}") from error
    absent = [name for name in ("geometry", "waveform") if name not in given]
    if absent:
        raise InputError(f"labels lacks the column {absent[0]!r}; add it, as whole numbers")
    for name in given.columns:
        if not (isinstance(name, str) and name.isidentifier()):
            raise InputError(
                f"labels has a column named {name!r}; use Python names, such as 'patient_1'"
            )
        if name in _TAKEN:
            raise InputError(
                f"labels has a column named {name!r}, as predictions name a column of theirs; "
                "give it another name"
            )
    if not given.columns.is_unique:
        raise InputError(f"labels has two columns named {given.columns[_second(given.columns)]!r}")
    if len(given) != n_cases:
        raise InputError(
            f"labels has {counted(len(given), 'row')} but there are {counted(n_cases, 'case')}; "
            "give one row per case"
        )
    columns: dict[str, NDArray[Any] | list[str]] = {
        name: _whole_numbers(name, given[name]) for name in ("geometry", "waveform")
    }
    columns["blockage"] = (
        _blockages(given["blockage"])
        if "blockage" in given
        else 1.0 - area_undeformed.min(axis=1) / area_undeformed[:, 0]
    )
    rest = [name for name in given.columns if name not in columns]
    columns.update({name: _label_values(name, given[name]) for name in rest})
    table = pd.DataFrame(columns)
    pairs = pd.MultiIndex.from_frame(table[["geometry", "waveform"]])
    if not pairs.is_unique:
        again = _second(pairs)
        raise InputError(
            f"labels names two cases alike: geometry {table['geometry'][again]}, waveform "
            f"{table['waveform'][again]} stands in rows {pairs.tolist().index(pairs[again])} and "
            f"{again}; give each case its own pair"
        )
    return table


def _second(index: pd.Index[Any]) -> int:
    """Return the position of the first entry that was there before."""
    return int(np.argmax(index.duplicated()))


def _whole_numbers(name: str, column: pd.Series[Any]) -> NDArray[Any]:
    values = column.to_numpy()
    for row, value in enumerate(values):
        if not _is_whole(value):
            raise InputError(f"labels[{name!r}][{row}] is {value!r}; {name} must be a whole number")
    return values.astype(np.int64)


def _is_whole(value: Any) -> bool:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return number and float(value).is_integer()


def _blockages(column: pd.Series[Any]) -> NDArray[Any]:
    try:
        values = column.to_numpy(dtype=np.float64, na_value=np.nan)
    except (ValueError, TypeError) as error:
        raise InputError(f"labels['blockage'] must hold numbers: {error}") from error
    unknown = np.isnan(values)
    check_values(
        "labels['blockage']",
        values,
        ~unknown & ~((values >= 0) & (values < 1)),
        "blockage is a fraction of the area, at least 0 and below 1, or NaN where unknown",
    )
    # One NaN for all, whatever its bits were, so that equal tables have equal checksums.
    return np.where(unknown, np.nan, values)


def _label_values(name: str, column: pd.Series[Any]) -> NDArray[Any] | list[str]:
    values = column.to_numpy()
    if values.dtype.kind == "b":
        return values.astype(np.bool_)
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    if values.dtype.kind == "f":
        return np.where(np.isnan(values), np.nan, values).astype(np.float64)
    for row, value in enumerate(values):
        # A file can hold neither a NUL character nor half a surrogate pair.
        if not isinstance(value, str) or "\0" in value or not _encodable(value):
            raise InputError(
                f"labels[{name!r}][{row}] is {value!r}; a column of labels must hold numbers "
                "throughout or plain text throughout"
            )
    return [str(value) for value in values]


def _encodable(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def warn_of_units(arrays: Mapping[str, FloatArray]) -> None:
    """Warn of magnitudes that no vessel has in CGS units."""
    undeformed = arrays["area_undeformed"]
    area = float(np.median(undeformed))
    ratio = float(np.median(arrays["area"] / undeformed[:, None, :]))
    speed = float(np.median(np.abs(arrays["flow"]) / arrays["area"]))
    pressure = float(np.max(np.abs(arrays["pressure"])))
    doubts = []
    if not 1e-4 <= area <= 100:
        doubts.append(f"the median undeformed area is {area:.3g}, expected cm²")
    if not 0.2 <= ratio <= 5:
        doubts.append(f"area is {ratio:.3g} times area_undeformed; both are expected in cm²")
    if speed != 0 and not 0.5 <= speed <= 500:
        doubts.append(f"the median of flow / area is {speed:.3g}, expected cm/s (mL/s over cm²)")
    if not 1e3 <= pressure <= 1e7:
        doubts.append(
            f"the largest pressure is {pressure:.3g}, expected dyn/cm² (1 mmHg = 1333.22 dyn/cm²)"
        )
    if doubts:
        warnings.warn("check the units: " + "; ".join(doubts), UnitsWarning, stacklevel=3)
