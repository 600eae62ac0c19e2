"""Tidy CSV tables of results: one row for each case, time point and point."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from pcnde_bridge._utils.files import as_paths
from pcnde_bridge._utils.validation import counted, listed
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import FIELDS, VARIABLES
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, to_cases
from pcnde_bridge.io.tables import numbers, read_labeled
from pcnde_bridge.io.vessel_results import VesselResults

COLUMNS = ("time", "z", *VARIABLES, "area_undeformed")

_NUMBERS = ["time", "z", *FIELDS, "area_undeformed"]

_KEYS = ["geometry", "waveform"]
_FEWEST = 12  # rows of a case: four time points, three points


def read_csv(paths: Paths, **options: Unpack[CaseOptions]) -> Cases:
    """Read tidy tables, such as those of :meth:`pcnde_bridge.Prediction.to_frame`.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        CSV files (also ``.csv.gz``) with the columns ``time``, ``z``, ``flow``, ``area``,
        ``pressure`` and ``area_undeformed``, optionally ``wall_shear_stress``.  Columns
        whose names end in ``_deviation``, and those without a name, are ignored; all others
        are labels, and rows of equal labels are one case.  A label is a number if all its
        values are numbers; else it is text as written, such as ``007``.
    **options
        ``period``, ``units``, ``flip``, ``time_points``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.to_cases`.

    Returns
    -------
    Cases
        The cases in the order of the files, sorted by their labels within each file.

    Raises
    ------
    DataNotFoundError
        If a file does not exist.
    FileError
        If a file is not a table.
    InputError
        If columns or rows are missing, or units, flow or time steps are ambiguous.
    """
    keyed, vessels = options.get("labels") is None, []
    tables = read_labeled(as_paths(paths), (*_NUMBERS, *_KEYS, "blockage"), usecols=_is_used)
    for path, frame in tables:
        vessels += _vessels(path, frame, keyed)
    return to_cases(vessels, **options)


def _is_used(name: str) -> bool:
    return not name.endswith("_deviation") and not re.fullmatch(r"Unnamed: \d+", name)


def _vessels(path: Path, frame: pd.DataFrame, keyed: bool) -> list[VesselResults]:
    """Return the cases of a file; ``keyed`` if geometry and waveform identify a case."""
    if absent := [name for name in COLUMNS if name not in frame]:
        raise InputError(f"{path} lacks the columns {absent}; it has {list(frame.columns)}.")
    if frame.empty:
        raise InputError(f"{path} has no rows.")
    for name in frame.columns.intersection(_NUMBERS):
        frame[name] = numbers(path, frame[name])
    labels = [str(name) for name in frame.columns if name not in _NUMBERS]
    if not labels:
        return [_vessel(path, frame, {})]
    # Numbers may be unknown, such as a blockage, but not the labels that identify a case.
    known = [name for name in labels if name in _KEYS or not is_numeric_dtype(frame[name])]
    if lacking := [name for name in known if frame[name].isna().any()]:
        raise InputError(f"{path}: a label is missing in the columns {lacking}.")
    groups = frame.groupby(labels, sort=True, dropna=False)
    if fault := _fault_of_labels(frame, labels, groups.size(), keyed):
        advice = "Leave out such columns, or name them …_standard_deviation."
        raise InputError(f"{path}: {fault}. {advice}")
    return [_vessel(path, rows, dict(zip(labels, key, strict=True))) for key, rows in groups]


def _fault_of_labels(
    frame: pd.DataFrame, labels: list[str], sizes: pd.Series[int], keyed: bool
) -> str:
    """Describe columns that are not labels of a whole case, such as a velocity or row number."""
    if keyed and set(_KEYS) <= set(labels):
        counts = frame.groupby(_KEYS)[labels].nunique(dropna=False).max()
        if varying := [name for name in labels if counts[name] > 1]:
            verb = "changes" if len(varying) == 1 else "change"
            return f"{listed(varying)} {verb} within a case, rows of one geometry and waveform"
    if sizes.min() >= _FEWEST:
        return ""
    many = [name for name in labels if frame[name].nunique() * _FEWEST > len(frame)]
    return (
        f"the labels {listed(labels)} identify {counted(len(sizes), 'case')}, one with "
        f"{counted(int(sizes.min()), 'row')} only{'; too many values: ' * bool(many)}{listed(many)}"
    )


def _vessel(path: Path, rows: pd.DataFrame, labels: Mapping[str, Any]) -> VesselResults:
    """Return the results of one case from its rows, in any order."""
    named = ", ".join(f"{name} {value}" for name, value in labels.items())
    where = f"{path} ({named})" if named else str(path)
    table = rows.set_index(["time", "z"]).sort_index()
    time, z = np.unique(rows["time"]), np.unique(rows["z"])
    if len(rows) != time.size * z.size or not table.index.is_unique:
        raise InputError(
            f"{where} has {len(rows)} rows, but {time.size} time points and {z.size} points make "
            f"{time.size * z.size}: give each once, or add columns that identify several cases."
        )
    fields: dict[str, Any] = {
        name: table[name].to_numpy().reshape(time.size, z.size)
        for name in table.columns.intersection(_NUMBERS)
    }
    undeformed = fields.pop("area_undeformed")
    if np.ptp(undeformed, axis=0).max() > 1e-9 * np.abs(undeformed[0]).max():
        raise InputError(f"{where}: area_undeformed changes with time.")
    return VesselResults(
        where, **fields, area_undeformed=undeformed[0], time=time, z=z, labels=labels
    )
