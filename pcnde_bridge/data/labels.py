"""Labels of the cases of a data set: geometry, waveform, blockage and others."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import AnyArray, Array
from pcnde_bridge._utils.validation import check_values, counted
from pcnde_bridge.data.variables import UNITS
from pcnde_bridge.errors import InputError

LABELS = "labels/"
"""Prefix of the labels' names among the arrays of a data set."""

_RESERVED = frozenset((*UNITS, "novelty"))  # columns of a prediction's table
_SURROGATE = re.compile("[\ud800-\udfff]")  # half of a pair, which is no text


def default_labels(n_cases: int) -> dict[str, Any]:
    """Return labels of cases with a geometry each, from 1, as in the published data."""
    return {"geometry": np.arange(1, n_cases + 1), "waveform": 0}


def check_labels(
    labels: pd.DataFrame | Mapping[str, Any] | None, area_undeformed: Array
) -> pd.DataFrame:
    """Return the labels as a table with the columns geometry, waveform, blockage and others.

    Raises
    ------
    InputError
        If a column is missing or unusable, or two cases have the same labels.
    """
    n_cases = len(area_undeformed)
    if labels is None:
        labels = default_labels(n_cases)
    try:
        given = pd.DataFrame(labels)
    except (ValueError, TypeError) as error:
        raise InputError(f"labels cannot be converted to a DataFrame: {error}") from error
    _check_table(given, n_cases)
    if "blockage" not in given:
        given = given.assign(blockage=1.0 - area_undeformed.min(axis=1) / area_undeformed[:, 0])
    table = pd.DataFrame(
        {
            name: _COLUMNS.get(name, _label_values)(name, given[name])
            for name in dict.fromkeys((*_COLUMNS, *given.columns))
        }
    )
    pairs = pd.MultiIndex.from_frame(table[["geometry", "waveform"]])
    if not pairs.is_unique:
        again = int(np.argmax(pairs.duplicated()))
        (geometry, waveform), first = pairs[again], pairs.tolist().index(pairs[again])
        found = f"geometry {geometry}, waveform {waveform} twice, in rows {first} and {again}"
        raise InputError(f"labels has {found}; give each case its own pair")
    return table


def label_arrays(labels: pd.DataFrame) -> dict[str, AnyArray]:
    """Return labels as arrays of numbers or text, named ``labels/<column>``."""
    found = {}
    for name, column in labels.items():
        values = column.to_numpy()
        if values.dtype.kind not in "biuf":
            values = np.array(values.tolist(), dtype=np.str_)
        found[f"{LABELS}{name}"] = values
    return found


def _check_table(given: pd.DataFrame, n_cases: int) -> None:
    """Raise if columns are missing, named wrongly or repeated, or the number of rows is wrong."""
    for name in ("geometry", "waveform"):
        if name not in given:
            raise InputError(f"labels lacks the column {name!r}; add it, as whole numbers")
    for name in given.columns:
        if not (isinstance(name, str) and name.isidentifier()):
            raise InputError(f"labels has a column named {name!r}; use Python names")
        if name in _RESERVED:
            what = "which is the name of a column of predictions"
            raise InputError(f"labels has a column named {name!r}, {what}; rename it")
    if len(again := given.columns[given.columns.duplicated()]):
        raise InputError(f"labels has two columns named {again[0]!r}")
    if len(given) != n_cases:
        rows, cases = counted(len(given), "row"), counted(n_cases, "case")
        raise InputError(f"labels has {rows} but there are {cases}")


def _whole_numbers(name: str, column: pd.Series[Any]) -> AnyArray:
    values = column.to_numpy()
    for row, value in enumerate(values):
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and float(value).is_integer()):
            raise InputError(f"labels[{name!r}][{row}] is {value!r}; {name} must be a whole number")
    return values.astype(np.int64)


def _blockages(name: str, column: pd.Series[Any]) -> AnyArray:
    try:
        values = column.to_numpy(dtype=np.float64, na_value=np.nan)
    except (ValueError, TypeError) as error:
        raise InputError(f"labels[{name!r}] must hold numbers: {error}") from error
    wrong = (values < 0) | (values >= 1)
    rule = "blockage is a fraction of the area, at least 0 and below 1, or NaN where unknown"
    check_values(f"labels[{name!r}]", values, wrong, rule)
    return _one_nan(values)


def _one_nan(values: AnyArray) -> AnyArray:
    """Replace every NaN by the same bits, so that equal tables have equal checksums."""
    return np.where(np.isnan(values), np.nan, values).astype(np.float64)


def _label_values(name: str, column: pd.Series[Any]) -> AnyArray | list[str]:
    values = column.to_numpy()
    if values.dtype.kind in "biu":
        return values.astype(np.bool_ if values.dtype.kind == "b" else np.int64)
    if values.dtype.kind == "f":
        return _one_nan(values)
    for row, value in enumerate(values):
        # A file can store neither a NUL character nor half a surrogate pair.
        if not isinstance(value, str) or "\0" in value or _SURROGATE.search(value):
            what = "a column of labels must hold numbers throughout or plain text throughout"
            raise InputError(f"labels[{name!r}][{row}] is {value!r}; {what}")
    return [str(value) for value in values]


_COLUMNS: dict[str, Callable[[str, pd.Series[Any]], AnyArray]] = {
    "geometry": _whole_numbers,
    "waveform": _whole_numbers,
    "blockage": _blockages,
}
