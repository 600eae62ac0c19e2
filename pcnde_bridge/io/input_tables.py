"""Tables of inflow waveforms and undeformed areas, the inputs of ``pcnde predict``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.tables import line_of, numbers, read_frame

_SAME = 1e-6  # of a step, a range or an axis


def _read(path: StrPath, axis: str) -> tuple[Array, pd.DataFrame]:
    """Return the axis in the first column, and the columns of the cases."""
    frame = read_frame(path)
    if frame.shape[1] < 2 or frame.columns[0] != axis:
        raise InputError(
            f"{path} must have the columns {axis}, then one for each case; it has "
            f"{list(frame.columns)}."
        )
    found = pd.DataFrame({name: numbers(path, frame[name]) for name in frame})
    return found[axis].to_numpy(), found.iloc[:, 1:]


def _rows(columns: pd.DataFrame) -> Array:
    return np.ascontiguousarray(columns.to_numpy(dtype=np.float64).T)


def read_cycle(path: StrPath, start: float, usual_period: float) -> tuple[float, pd.DataFrame]:
    """Read waveforms of one cycle at equally spaced time points, without its end point.

    Parameters
    ----------
    path : path-like
        CSV file whose first column is named ``time``.
    start : float
        First time point of the model's cycle, s.
    usual_period : float
        Period of the model's training data, s.  Time points that span it and end as they
        begin include the end point of the cycle.

    Returns
    -------
    period : float
        Number of time points times their distance, s.
    columns : DataFrame
        One column for each case, one row for each time point.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric, or the time points are not equally spaced,
        begin at another time or include the end point.
    """
    time, columns = _read(path, "time")
    if time.size < 2:
        raise InputError(f"{path} has {time.size} time points; a cycle needs more.")
    step = (time[-1] - time[0]) / (time.size - 1)
    off = np.abs(np.diff(time) - step)
    if step <= 0 or off.max() > _SAME * abs(step) * time.size:
        raise InputError(
            f"{path}, line {line_of(path, int(off.argmax()) + 1)}: the time points are not equally "
            "spaced. Interpolate the cycle to equal steps, without its end point."
        )
    if abs(time[0] - start) > _SAME * step * time.size:
        raise InputError(
            f"{path}, line {line_of(path, 0)}: time starts at {time[0]:g} s, but it must start at "
            f"{start:g} s, as the model's cycle does; shift the cycle."
        )
    waveforms = _rows(columns)
    gap = np.abs(waveforms[:, -1] - waveforms[:, 0])
    closed = (gap <= _SAME * np.ptp(waveforms, axis=1)).all()  # up to round-off
    if closed and math.isclose(step * (time.size - 1), usual_period, rel_tol=1e-6):
        raise InputError(
            f"{path}, line {line_of(path, time.size - 1)}: the cycle's end repeats its start. "
            "Leave the last line out."
        )
    return step * time.size, columns


def read_columns(path: StrPath, axis: str, expected: Array, unit: str) -> pd.DataFrame:
    """Read one column for each case on the grid of a model.

    Parameters
    ----------
    path : path-like
        CSV file whose first column is named ``axis``.
    axis : str
        ``"time"`` or ``"z"``.
    expected : array of shape (n,)
        Values that the axis must have.
    unit : str
        Unit of the axis, for messages.

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
    found, columns = _read(path, axis)
    if len(found) != len(expected):
        raise InputError(
            f"{path} has {len(found)} rows, but the model works on {len(expected)} values of "
            f"{axis} from {expected[0]:g} to {expected[-1]:g} {unit}: interpolate to these."
        )
    worst = int(np.abs(found - expected).argmax())
    if abs(found[worst] - expected[worst]) > _SAME * (1 + np.abs(expected).max()):
        raise InputError(
            f"{path}, line {line_of(path, worst)}: {axis} is {found[worst]:g} {unit}, but the "
            f"model works at {expected[worst]:g} {unit}: interpolate to its grid."
        )
    return columns


@dataclass(frozen=True)
class CaseInputs:
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


def read_inputs(inflow: StrPath, area: StrPath, grid: Grid, *, any_grid: bool) -> CaseInputs:
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
    if any_grid:
        where["period"], q = read_cycle(inflow, float(grid.time[0]), grid.period)
        where["z"], s_u = _read(area, "z")
    else:
        q = read_columns(inflow, "time", grid.time, "s")
        s_u = read_columns(area, "z", grid.z, "cm")
    by_inflow, by_area = ([str(name) for name in table.columns] for table in (q, s_u))
    if min(len(by_inflow), len(by_area)) > 1:
        alone = sorted(set(by_inflow) ^ set(by_area))
        if not alone:
            s_u = s_u[q.columns]
        elif set(by_inflow) & set(by_area):
            raise InputError(
                f"{inflow} and {area} have some names of cases in common, but {listed(alone)} only "
                "one of them: give both files the same names, or none in common to pair their "
                "columns by position."
            )
    names = by_inflow if len(by_inflow) >= len(by_area) else by_area
    return CaseInputs(_rows(q), _rows(s_u), names, where)
