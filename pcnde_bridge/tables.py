"""CSV tables of waveforms and areas, as the command line takes them."""

from __future__ import annotations

import csv
import math
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge.errors import FileError, InputError

Array = npt.NDArray[np.float64]


def read_frame(path: str | os.PathLike[str], **options: Any) -> pd.DataFrame:
    """Read a CSV file with :func:`pandas.read_csv` and its options.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    """
    try:
        frame: pd.DataFrame = pd.read_csv(path, **options)
    except (OSError, ValueError, EOFError, zlib.error, csv.Error) as error:
        raise FileError(f"Cannot read a table from {path}: {error}.") from error
    return frame


def read_table(path: str | os.PathLike[str], axis: str) -> tuple[Array, Array]:
    """Read an axis and one column for each case.

    Parameters
    ----------
    path : path-like
        CSV file whose first column is named ``axis``.
    axis : str
        ``"time"`` or ``"z"``.

    Returns
    -------
    array of shape (n,), array of shape (case, n)
        The first column, and the others.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric.
    """
    name = Path(path)
    frame = read_frame(name)
    if frame.shape[1] < 2 or frame.columns[0] != axis:
        raise InputError(
            f"{name} must have the columns {axis}, then one for each case; it has "
            f"{list(frame.columns)}."
        )
    for column in frame.columns:
        if not pd.api.types.is_numeric_dtype(frame[column]) or frame[column].isna().any():
            bad = pd.to_numeric(frame[column], errors="coerce").isna()
            line = int(np.flatnonzero(bad)[0]) + 2 if bad.any() else 2
            raise InputError(f"{name}, line {line}, column {column}: not a number.")
    columns = np.ascontiguousarray(frame.iloc[:, 1:].to_numpy(dtype=np.float64).T)
    return frame[axis].to_numpy(dtype=np.float64), columns


def read_cycle(
    path: str | os.PathLike[str], start: float, usual_period: float
) -> tuple[float, Array]:
    """Read one cycle of waveforms at equally spaced instants, without its end point.

    Parameters
    ----------
    path : path-like
        CSV file whose first column is named ``time``.
    start : float
        First instant of the model's cycle, s, from which predictions count.
    usual_period : float
        Of the model's training, s: instants that span it and end as they begin have an
        end point too many.

    Returns
    -------
    float, array of shape (case, time)
        The period (s) that the instants make, and the columns.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric, or the instants are not equally spaced, begin
        at another time or repeat the first.
    """
    time, columns = read_table(path, "time")
    if time.size < 2:
        raise InputError(f"{path} has {time.size} instants; a cycle needs more.")
    steps = np.diff(time)
    step = (time[-1] - time[0]) / (time.size - 1)
    if step <= 0 or np.abs(steps - step).max() > 1e-6 * abs(step) * time.size:
        line = int(np.abs(steps - step).argmax()) + 3
        raise InputError(
            f"{path}, line {line}: the instants are not equally spaced. Interpolate the cycle to "
            "equal steps, without its end point."
        )
    if abs(time[0] - start) > 1e-6 * step * time.size:
        raise InputError(
            f"{path}, line 2: the first instant is {time[0]:g} s, the model's {start:g} s, from "
            "which predictions count. Let the cycle begin there."
        )
    spans = math.isclose(step * (time.size - 1), usual_period, rel_tol=1e-6)
    if spans and np.array_equal(columns[:, 0], columns[:, -1]):
        raise InputError(
            f"{path}, line {time.size + 1}: the cycle's end repeats its start. Leave the last "
            "line out."
        )
    return step * time.size, columns


def read_columns(path: str | os.PathLike[str], axis: str, expected: Array, unit: str) -> Array:
    """Read one column for each case, given at an axis that must be the model's.

    Parameters
    ----------
    path : path-like
        CSV file whose first column is named ``axis``.
    axis : str
        ``"time"`` or ``"z"``.
    expected : array of shape (n,)
        Values that the axis must have.
    unit : str
        Of the axis, for messages.

    Returns
    -------
    array of shape (case, n)
        The other columns.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric, or the axis is another.
    """
    name = Path(path)
    found, columns = read_table(name, axis)
    if len(found) != len(expected):
        raise InputError(
            f"{name} has {len(found)} rows, but the model works on {len(expected)} values of "
            f"{axis} from {expected[0]:g} to {expected[-1]:g} {unit}: interpolate to these."
        )
    worst = int(np.abs(found - expected).argmax())
    if abs(found[worst] - expected[worst]) > 1e-6 * (1 + np.abs(expected).max()):
        raise InputError(
            f"{name}, line {worst + 2}: {axis} is {found[worst]:g} {unit}, but the model works at "
            f"{expected[worst]:g} {unit}: interpolate to its grid."
        )
    return columns
