"""CSV tables of waveforms and areas, as the command line takes them."""

from __future__ import annotations

import csv
import gzip
import itertools
import math
import os
import re
import zlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.errors import FileError, InputError

if TYPE_CHECKING:
    from pcnde_bridge.data.grid import Grid

_SAME = 1e-6  # of a waveform's range
_LARGEST = np.iinfo(np.int64).max
# Before 3.1 pandas rounds one number in six to a neighbour unless it is asked not to; since then
# asking is deprecated.
_OLD_PANDAS = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
_EXACT: dict[str, Any] = {"float_precision": "round_trip"} if _OLD_PANDAS else {}
_DECIMAL = re.compile(r"-?(inf|(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d+)?)", re.ASCII)
"""Numbers as programs write them; what begins with further zeros is a name."""
_MISSING = ("", "NA", "N/A", "#N/A", "n/a", "<NA>", "NaN", "nan", "-nan", "NULL", "null", "None")
"""What stands for a number that is not known, as :func:`pandas.read_csv` takes it."""


def read_frame(path: str | os.PathLike[str], **options: Any) -> pd.DataFrame:
    """Read a CSV file with :func:`pandas.read_csv` and its options, numbers to the last bit.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    """
    try:
        # Blanks after the commas belong neither to names nor to values.
        frame: pd.DataFrame = pd.read_csv(path, skipinitialspace=True, **_EXACT, **options)
    except UnicodeDecodeError as error:
        raise FileError(
            f"Cannot read a table from {path}: it is not UTF-8 text ({error}). Save it as CSV in "
            "UTF-8."
        ) from error
    except (OSError, ValueError, EOFError, zlib.error, csv.Error) as error:
        raise FileError(f"Cannot read a table from {path}: {error}.{_advice(path)}") from error
    if frame.shape[1] == 1 and (advice := _separated(str(frame.columns[0]))):
        raise FileError(f"Cannot read a table from {path}.{advice}")
    return frame


def _advice(path: str | os.PathLike[str]) -> str:
    """Say what to do about a file that cannot be read, if its first line tells."""
    if not Path(path).is_file():
        return ""
    try:
        return _separated(",".join(pd.read_csv(path, nrows=0).columns))
    except (OSError, ValueError, EOFError, zlib.error, csv.Error):
        return ""


def _separated(header: str) -> str:
    """Say what to do about columns that something else than commas separates."""
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header and "," not in header:
            return (
                f" Its columns are separated by {name}: save it with commas between the columns "
                "and points in the numbers."
            )
    return ""


def line_of(path: str | os.PathLike[str], row: int) -> int:
    """Return the line of a CSV file that a row of its table stands in, for messages.

    Parameters
    ----------
    path : path-like
        The file, which may be ``.gz``.
    row : int
        0 is the first below the names of the columns.

    Returns
    -------
    int
        Blank lines count, although they make no rows.
    """
    name = Path(path)
    if not name.is_file():  # a pipe has been read by now
        return row + 2
    opened = gzip.open if name.suffix == ".gz" else open
    with opened(name, "rt", encoding="utf-8", errors="replace") as text:
        filled = (number for number, line in enumerate(text, start=1) if line.strip())
        return next(itertools.islice(filled, row + 1, None), row + 2)


def read_labelled(
    paths: Iterable[str | os.PathLike[str]], numeric: Collection[str], **options: Any
) -> list[pd.DataFrame]:
    """Read CSV files with columns of numbers and columns of labels, which stay as they are.

    Parameters
    ----------
    paths : iterable of path-like
        The files.
    numeric : collection of str
        Names of the columns that are numbers, read as :func:`pandas.read_csv` does.
    **options
        Of :func:`pandas.read_csv`.

    Returns
    -------
    list of DataFrame
        One for each file.  A label is a number, or a truth value, if all its values in all
        files are: ``12`` and ``0.50``, but not ``007``.  Only what is empty is missing
        (NaN): ``NA`` is a text.

    Raises
    ------
    FileError
        If a file cannot be read as a table.
    """
    frames: list[pd.DataFrame] = []
    texts: dict[str, set[str]] = {}
    for path in paths:
        header = [str(name) for name in read_frame(path, nrows=0, **options)]
        names = [name for name in header if name not in numeric]
        frame = read_frame(
            path,
            dtype=dict.fromkeys(names, str),
            keep_default_na=False,
            na_values={name: _MISSING for name in header if name in numeric},
            **options,
        )
        for name in names:
            texts.setdefault(name, set()).update(frame[name].unique())
        frames.append(frame)
    for name, found in texts.items():
        values = _values(found - {""})
        for frame in frames:
            if name in frame:
                frame[name] = frame[name].map(values).infer_objects()
    return frames


def _values(texts: Collection[str]) -> dict[str, Any]:
    """Return what each of a label's texts stands for: numbers for all, or the texts."""
    values = {text: _number(text) for text in texts}
    kinds = {type(value) for value in values.values()}
    # Texts that differ must differ as numbers: 1 and 1.0 do not.
    exact = kinds <= {bool} or (kinds <= {int, float} and len(set(values.values())) == len(texts))
    return values if exact else {text: text for text in texts}


def _number(text: str) -> bool | int | float | None:
    """Return the number or truth value that a text stands for, or None."""
    if text in ("True", "False"):
        return text == "True"
    if not _DECIMAL.fullmatch(text):
        return None
    if text.lstrip("-").isdecimal():
        return int(text) if abs(int(text)) <= _LARGEST else None
    return float(text)


def _read(path: str | os.PathLike[str], axis: str) -> tuple[Array, pd.DataFrame]:
    """Return an axis, and a column for each case."""
    frame = read_frame(path)
    if frame.shape[1] < 2 or frame.columns[0] != axis:
        raise InputError(
            f"{path} must have the columns {axis}, then one for each case; it has "
            f"{list(frame.columns)}."
        )
    for column in frame.columns:
        if not pd.api.types.is_numeric_dtype(frame[column]) or frame[column].isna().any():
            bad = pd.to_numeric(frame[column], errors="coerce").isna()
            line = line_of(path, int(np.flatnonzero(bad)[0]) if bad.any() else 0)
            raise InputError(f"{path}, line {line}, column {column}: not a number.")
    return frame[axis].to_numpy(dtype=np.float64), frame.iloc[:, 1:]


def _rows(columns: pd.DataFrame) -> Array:
    return np.ascontiguousarray(columns.to_numpy(dtype=np.float64).T)


def read_cycle(
    path: str | os.PathLike[str], start: float, usual_period: float
) -> tuple[float, pd.DataFrame]:
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
    float, DataFrame
        The period (s) that the instants make, and a column for each case, a row for each
        instant.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric, or the instants are not equally spaced, begin
        at another time or repeat the first.
    """
    time, columns = _read(path, "time")
    if time.size < 2:
        raise InputError(f"{path} has {time.size} instants; a cycle needs more.")
    steps = np.diff(time)
    step = (time[-1] - time[0]) / (time.size - 1)
    if step <= 0 or np.abs(steps - step).max() > 1e-6 * abs(step) * time.size:
        line = line_of(path, int(np.abs(steps - step).argmax()) + 1)
        raise InputError(
            f"{path}, line {line}: the instants are not equally spaced. Interpolate the cycle to "
            "equal steps, without its end point."
        )
    if abs(time[0] - start) > 1e-6 * step * time.size:
        raise InputError(
            f"{path}, line {line_of(path, 0)}: the first instant is {time[0]:g} s, the model's "
            f"{start:g} s, from which predictions count. Let the cycle begin there."
        )
    spans = math.isclose(step * (time.size - 1), usual_period, rel_tol=1e-6)
    if spans and _closed(_rows(columns)):
        raise InputError(
            f"{path}, line {line_of(path, time.size - 1)}: the cycle's end repeats its start. "
            "Leave the last line out."
        )
    return step * time.size, columns


def _closed(waveforms: Array) -> bool:
    """Whether all end as they begin, but for the round-off of whoever computed them."""
    gap = np.abs(waveforms[:, -1] - waveforms[:, 0])
    return bool((gap <= _SAME * np.ptp(waveforms, axis=1)).all())


def read_columns(
    path: str | os.PathLike[str], axis: str, expected: Array, unit: str
) -> pd.DataFrame:
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
    DataFrame
        The other columns, one for each case.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    InputError
        If a column is missing or not numeric, or the axis is another.
    """
    found, columns = _read(path, axis)
    if len(found) != len(expected):
        raise InputError(
            f"{path} has {len(found)} rows, but the model works on {len(expected)} values of "
            f"{axis} from {expected[0]:g} to {expected[-1]:g} {unit}: interpolate to these."
        )
    worst = int(np.abs(found - expected).argmax())
    if abs(found[worst] - expected[worst]) > 1e-6 * (1 + np.abs(expected).max()):
        raise InputError(
            f"{path}, line {line_of(path, worst)}: {axis} is {found[worst]:g} {unit}, but the "
            f"model works at {expected[worst]:g} {unit}: interpolate to its grid."
        )
    return columns


@dataclass(frozen=True)
class CaseInputs:
    """What two tables say of the cases to be predicted.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Q at the inlet, mL/s.
    area_undeformed : array of shape (case, z)
        S_u, cm²; of one case where all have the same, and so may be the inflow.
    names : list of str
        One for each case.
    where : dict of str to object
        ``z`` and ``period``, of a model that takes any; else empty.
    """

    inflow: Array
    area_undeformed: Array
    names: list[str]
    where: dict[str, Any]

    def name_labels(self, labels: pd.DataFrame) -> pd.DataFrame:
        """Return labels of predicted cases with the additional column ``name``."""
        return labels.assign(name=[self.names[case] for case in labels["case"]])


def read_inputs(
    inflow: str | os.PathLike[str], area: str | os.PathLike[str], grid: Grid, *, any_grid: bool
) -> CaseInputs:
    """Read inflows and undeformed areas, and pair them.

    Columns are paired by their names if both tables have the same ones, and by their
    place if they have none in common, or one table has a single column for all cases.

    Parameters
    ----------
    inflow : path-like
        CSV file: ``time`` (s), then a column of Q (mL/s) for each case.
    area : path-like
        CSV file: ``z`` (cm), then a column of S_u (cm²) for each case.
    grid : Grid
        Of the model.
    any_grid : bool
        Whether the model takes other instants of a cycle, and other points.

    Returns
    -------
    CaseInputs
        In the order of the inflow's columns.

    Raises
    ------
    FileError
        If a file cannot be read as a table.
    InputError
        As :func:`read_cycle` and :func:`read_columns`, or if some of the columns have the
        same name in both files and others have not.
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
                f"{inflow} and {area} name some cases alike, but {listed(alone)} only one of "
                "them: give both files the same names, or none in common to pair their columns "
                "by place."
            )
    names = by_inflow if len(by_inflow) >= len(by_area) else by_area
    return CaseInputs(_rows(q), _rows(s_u), names, where)
