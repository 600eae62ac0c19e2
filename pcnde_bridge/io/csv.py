"""Tidy CSV tables of results: one row for each case, instant and point."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from pcnde_bridge._utils.files import as_paths, check_file
from pcnde_bridge._utils.validation import counted, listed
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.tables import line_of, read_labelled
from pcnde_bridge.io.vessel_results import (
    CaseOptions,
    VesselResults,
    to_cases,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

COLUMNS = ("time", "z", *VARIABLES, "area_undeformed")

_KEYS = "geometry", "waveform"
_FEWEST = 12  # rows of a case: four instants, three points


def read_csv(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    **options: Unpack[CaseOptions],
) -> Cases:
    """Read tidy tables, such as ``Prediction.to_frame()`` makes.

    Parameters
    ----------
    paths : path-like or sequence of them
        CSV files (also ``.csv.gz``) with the columns ``time``, ``z``, ``flow``,
        ``area``, ``pressure`` and ``area_undeformed``.  Columns whose names end in
        ``_deviation``, and those without a name, are left alone; all others are labels,
        and rows of equal labels are a case.  A label is a number if all its values are,
        and else stays as it is written, such as ``007``.
    **options
        ``period``, ``units``, ``flip``, ``instants``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.vessel_results.to_cases`.

    Returns
    -------
    Cases
        In the order of the files, and in each by its labels.

    Raises
    ------
    DataNotFoundError
        If a file is not there.
    FileError
        If a file is no table.
    InputError
        If columns or rows are missing, or units, flow or time steps are doubtful.
    """
    chosen = as_paths(paths)
    for path in chosen:
        check_file(path, "a table")
    frames = read_labelled(chosen, (*COLUMNS, *_KEYS, "blockage"), usecols=_is_used)
    apart = options.get("labels") is None
    found = [_read(path, frame, apart) for path, frame in zip(chosen, frames, strict=True)]
    return to_cases([vessel for vessels in found for vessel in vessels], **options)


def _is_used(name: str) -> bool:
    return not name.endswith("_deviation") and not re.fullmatch(r"Unnamed: \d+", name)


def _read(path: Path, frame: pd.DataFrame, apart: bool) -> list[VesselResults]:
    """Return the cases of a file; ``apart`` if its geometries and waveforms tell them apart."""
    absent = [name for name in COLUMNS if name not in frame]
    if absent:
        raise InputError(
            f"{path} lacks the columns {absent}; it needs {list(COLUMNS)}, in CGS units or with "
            f"units= (--units), and has {list(frame.columns)}."
        )
    for name in COLUMNS:
        numbers = pd.to_numeric(frame[name], errors="coerce")
        if numbers.isna().any():
            line = line_of(path, int(np.flatnonzero(numbers.isna())[0]))
            raise InputError(f"{path}, line {line}, column {name}: not a number.")
        frame[name] = numbers
    labels = [str(name) for name in frame.columns if name not in COLUMNS]
    if frame.empty:
        raise InputError(f"{path} has no rows.")
    if not labels:
        return [_vessel(path, frame, {})]
    # A data set may leave numbers unknown, such as the blockage, but not what names its cases.
    known = [n for n in labels if n in _KEYS or not is_numeric_dtype(frame[n])]
    lacking = [name for name in known if frame[name].isna().any()]
    if lacking:
        raise InputError(f"{path}: a label is missing in the columns {lacking}.")
    groups = frame.groupby(labels, sort=True, dropna=False)
    _check_labels(path, frame, labels, groups.size(), apart)
    return [_vessel(path, rows, dict(zip(labels, key, strict=True))) for key, rows in groups]


def _check_labels(
    path: Path, frame: pd.DataFrame, labels: list[str], sizes: pd.Series[int], apart: bool
) -> None:
    """Refuse columns that are no labels, such as a velocity or the number of the row."""
    advice = "Columns that are no label of a whole case have to be left out, or named …_deviation."
    if apart and set(_KEYS) <= set(labels):
        values = frame.groupby(list(_KEYS))[labels].nunique(dropna=False)
        if varying := [name for name in labels if (values[name] > 1).any()]:
            raise InputError(
                f"{path}: {listed(varying)} {'changes' if len(varying) == 1 else 'change'} within "
                f"a case, rows of the same geometry and waveform. {advice}"
            )
    if sizes.min() < _FEWEST:
        many = [name for name in labels if frame[name].nunique() * _FEWEST > len(frame)]
        which = f" These have too many values: {listed(many)}." if many else ""
        raise InputError(
            f"{path}: the columns {listed(labels)} tell {counted(len(sizes), 'case')} apart, one "
            f"with {counted(int(sizes.min()), 'row')} only. {advice}{which}"
        )


def _vessel(path: Path, rows: pd.DataFrame, labels: dict[str, Any]) -> VesselResults:
    where = f"{path}" + (f" ({', '.join(f'{k} {v}' for k, v in labels.items())})" * bool(labels))
    time, z = np.unique(rows["time"]), np.unique(rows["z"])
    if len(rows) != time.size * z.size or rows.duplicated(["time", "z"]).any():
        raise InputError(
            f"{where} has {len(rows)} rows, but {time.size} instants and {z.size} points make "
            f"{time.size * z.size}: give each instant and point once. If there are several cases, "
            "add columns that tell them apart, such as geometry and waveform."
        )
    ordered = rows.sort_values(["time", "z"])
    shape = time.size, z.size
    fields = {name: ordered[name].to_numpy(np.float64).reshape(shape) for name in COLUMNS}
    undeformed = fields["area_undeformed"]
    if np.abs(undeformed - undeformed[0]).max() > 1e-9 * np.abs(undeformed[0]).max():
        raise InputError(f"{where}: area_undeformed changes with time.")
    return VesselResults(
        where,
        fields["flow"],
        fields["area"],
        fields["pressure"],
        undeformed[0],
        time,
        z,
        labels=labels,
    )
