"""Positions of cases in a data set: by number, mask, pair or label."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import IntArray
from pcnde_bridge._utils.validation import counted, listed
from pcnde_bridge.errors import InputError

Positions = IntArray
"""Positions of cases in a data set."""

_WHOLE = int | np.integer


def case_keys(labels: pd.DataFrame) -> list[tuple[int, int]]:
    """Return the (geometry, waveform) of every case."""
    return list(zip(labels["geometry"].tolist(), labels["waveform"].tolist(), strict=True))


def select_positions(labels: pd.DataFrame, index: Any, wanted: Mapping[str, Any]) -> Positions:
    """Return the positions of cases, given by an index or by values of labels.

    Parameters
    ----------
    labels : DataFrame
        Labels of the data set.
    index : int, slice, sequence of int, boolean mask, list of pairs, or None
        Positions, a mask or pairs; None if label values are given.
    wanted : mapping
        Values wanted of label columns.

    Raises
    ------
    InputError
        If neither or both are given, something does not exist or is requested twice, or
        no case matches.
    """
    if (index is None) == (not wanted):
        given = "both were given" if wanted else "neither was given"
        raise InputError(f"select needs positions or label values such as geometry=10; {given}")
    positions = _with_labels(labels, wanted) if wanted else _from_index(labels, index)
    return _each_once(positions, "select")


def some_of(positions: Positions, most: int) -> Positions:
    """Return the positions, or so many of them, chosen at random, the same ones every time."""
    if len(positions) <= most:
        return positions
    return np.sort(np.random.default_rng(0).choice(positions, most, replace=False))


def batches_of(count: int, most: int = 64) -> list[slice]:
    """Divide a number of cases into as few ranges of nearly equal size as their size allows."""
    ends = np.linspace(0, count, -(-count // most) + 1).astype(int)
    return [slice(int(start), int(end)) for start, end in pairwise(ends)]


def _from_index(labels: pd.DataFrame, index: Any) -> Positions:
    """Return the positions for an integer, a slice, a list, a mask or pairs."""
    if isinstance(index, tuple) and all(np.ndim(i) == 0 for i in index):
        what = f"[{index!r}] for a (geometry, waveform) pair, or {list(index)!r} for positions"
        raise InputError(f"select({index!r}) is ambiguous: write {what}")
    everything: Positions = np.arange(len(labels))
    try:
        if isinstance(index, slice):
            return np.asarray(everything[index])
        asked = np.asarray(index)
        if not asked.size:
            return everything[:0]
        if asked.dtype.kind == "u" and asked.max() >= len(labels):
            raise IndexError(f"there is no case {asked.max()}")  # numpy would count from the end
        if asked.ndim < 2:
            return np.asarray(everything[np.atleast_1d(asked)])
    except (IndexError, TypeError, ValueError) as error:
        raise InputError(
            f"select cannot use {reprlib.repr(index)} in {counted(len(labels), 'case')}: {error}; "
            "give an int, a slice, a list of ints, a mask or a list of (geometry, waveform) pairs"
        ) from error
    return pair_positions(labels, asked.tolist(), "select")


def _with_labels(labels: pd.DataFrame, wanted: Mapping[str, Any]) -> Positions:
    """Return the positions of the cases whose labels have the wanted values."""
    mask = np.ones(len(labels), dtype=bool)
    for column, value in wanted.items():
        given = label_values(labels, column)
        many = isinstance(value, Sequence | np.ndarray | pd.Series) and not isinstance(value, str)
        values = list(value) if many else [value]
        hits = [_matches(given, each) for each in values]
        absent = [each for each, hit in zip(values, hits, strict=True) if not hit.any()]
        if absent:
            known = listed(pd.unique(given).tolist())
            raise InputError(f"no case has {column} = {listed(absent)}; the values are: {known}")
        mask &= np.any(hits, axis=0)
    return np.flatnonzero(mask)


def label_values(labels: pd.DataFrame, column: str) -> pd.Series[Any]:
    """Return a column of the labels, or raise if there is none of this name."""
    if column not in list(labels.columns):
        known = ", ".join(map(repr, labels.columns))
        raise InputError(f"there is no label {column!r}; the labels are {known}")
    return labels[column]


def _matches(column: pd.Series[Any], value: Any) -> npt.NDArray[np.bool_]:
    """Mark equal labels; fractions within round-off, so that 0.55 finds 0.55."""
    if column.dtype.kind == "f" and isinstance(value, Real):
        return np.asarray(np.isclose(column, float(value), atol=1e-12, equal_nan=True))
    if not np.isscalar(value):
        return np.zeros(len(column), dtype=bool)
    return np.asarray(column == value)


def pair_positions(labels: pd.DataFrame, pairs: Any, where: str) -> Positions:
    """Return the positions of (geometry, waveform) pairs, each given once, in their order."""
    if isinstance(pairs, str | Mapping) or not hasattr(pairs, "__len__") or len(pairs) == 0:
        raise InputError(f"{where} must be a non-empty list of [geometry, waveform] pairs")
    for i, pair in enumerate(pairs):
        kinds = [*map(type, pair)] if isinstance(pair, list | tuple | np.ndarray) else []
        if len(kinds) != 2 or bool in kinds or not all(issubclass(k, _WHOLE) for k in kinds):
            what = "[geometry, waveform], two whole numbers"
            raise InputError(f"{where}, entry {i}, is {pair!r}; write {what}")
    known, keys = case_keys(labels), [(int(one), int(other)) for one, other in pairs]
    if absent := [key for key in keys if key not in known]:
        what = (
            f"(geometry, waveform) = {listed(absent)}; see cases.labels, or labels.csv of a design"
        )
        raise InputError(f"{where} asks for cases that are not in this data set: {what}")
    return _each_once(np.array([known.index(key) for key in keys]), where)


def _each_once(positions: Positions, where: str) -> Positions:
    """Return positions, or raise if there is none or one is repeated."""
    if len(positions) == 0:
        raise InputError("the selection is empty: no case matches")
    unique, counts = np.unique(positions, return_counts=True)
    if (counts > 1).any():
        twice = f"case {unique[counts > 1][0]} of the data set more than once"
        raise InputError(f"{where} asks for {twice}; ask for each case once")
    return positions
