"""Positions of cases in a data set: by number, mask, label or named split."""

from __future__ import annotations

import json
import os
import reprlib
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import IntArray
from pcnde_bridge._utils.files import reading
from pcnde_bridge._utils.validation import counted, listed
from pcnde_bridge.errors import DataNotFoundError, InputError

Positions = IntArray
"""Positions of cases in a data set."""

Pairs = list[tuple[int, int]]
"""Cases by their labels (geometry, waveform)."""


def case_keys(labels: pd.DataFrame) -> Pairs:
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
    if len(positions) == 0:
        raise InputError("the selection is empty: no case matches")
    unique, counts = np.unique(positions, return_counts=True)
    if np.any(counts > 1):
        twice = int(unique[np.argmax(counts > 1)])
        raise InputError(f"case {twice} is selected more than once; ask for each case once")
    return positions


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
    return _of_pairs(labels, asked.tolist(), "select")


def _with_labels(labels: pd.DataFrame, wanted: Mapping[str, Any]) -> Positions:
    """Return the positions of the cases whose labels have the wanted values."""
    mask = np.ones(len(labels), dtype=bool)
    for column, value in wanted.items():
        if column not in labels:
            known = ", ".join(map(repr, labels.columns))
            raise InputError(f"there is no label {column!r}; the labels are {known}")
        values = [value] if isinstance(value, str) or np.ndim(value) == 0 else list(value)
        hits = [_matches(labels[column], each) for each in values]
        absent = [each for each, hit in zip(values, hits, strict=True) if not hit.any()]
        if absent:
            known = listed(pd.unique(labels[column]).tolist())
            raise InputError(f"no case has {column} = {listed(absent)}; the values are: {known}")
        mask &= np.any(hits, axis=0)
    return np.flatnonzero(mask)


def _matches(column: pd.Series[Any], value: Any) -> npt.NDArray[np.bool_]:
    """Mark equal labels; fractions within round-off, so that 0.55 finds 0.55."""
    if column.dtype.kind == "f" and isinstance(value, Real):
        return np.asarray(np.isclose(column, float(value), atol=1e-12, equal_nan=True))
    return np.asarray(column == value)


def _of_pairs(labels: pd.DataFrame, pairs: Any, where: str) -> Positions:
    """Return the positions of (geometry, waveform) pairs, each given once, in their order."""
    if isinstance(pairs, str | Mapping) or not hasattr(pairs, "__len__") or len(pairs) == 0:
        raise InputError(f"{where} must be a non-empty list of [geometry, waveform] pairs")
    keys: Pairs = []
    for i, pair in enumerate(pairs):
        if not (
            isinstance(pair, list | tuple | np.ndarray)
            and len(pair) == 2
            and all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in pair)
        ):
            what = "[geometry, waveform], two whole numbers"
            raise InputError(f"{where}, entry {i}, is {pair!r}; write {what}")
        key = (int(pair[0]), int(pair[1]))
        if key in keys:
            raise InputError(f"{where} names {key} twice, the second time as entry {i}")
        keys.append(key)
    known = {key: i for i, key in enumerate(case_keys(labels))}
    absent = [key for key in keys if key not in known]
    if absent:
        what = f"(geometry, waveform) = {listed(absent)}; see cases.labels"
        raise InputError(f"{where} asks for cases that are not in this data set: {what}")
    return np.array([known[key] for key in keys], dtype=np.intp)


def split_positions(labels: pd.DataFrame, how: Any) -> dict[str, Positions]:
    """Return the positions of the training and of the test cases.

    Parameters
    ----------
    labels : DataFrame
        Labels of the data set.
    how : "paper", mapping or path-like
        See :meth:`pcnde_bridge.Cases.split`.

    Raises
    ------
    InputError
        If training or test would be empty, or the mapping is not usable.
    FileError
        If the file is missing or is not JSON.
    """
    if isinstance(how, str) and how == "paper":
        return _paper_split(labels)
    if isinstance(how, Mapping):
        return _named_split(labels, how, "the split")
    if not isinstance(how, str | os.PathLike):
        raise InputError(f"how must be 'paper', a mapping or the path of a JSON file, got {how!r}")
    path, name = Path(how), repr(str(how))
    if not path.exists():
        what = "'paper', a mapping or the path of a JSON file"
        raise DataNotFoundError(f"there is no split file {name}; give {what}")
    with reading(path, "a readable JSON file"):
        mapping = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(mapping, dict):
        raise InputError(f'{name} must hold {{"train": [...], "test": [...]}}')
    return _named_split(labels, mapping, name)


def _paper_split(labels: pd.DataFrame) -> dict[str, Positions]:
    geometry, waveform = labels["geometry"].to_numpy(), labels["waveform"].to_numpy()
    order = np.lexsort((waveform, geometry))
    test = ((geometry == geometry.max()) | (waveform == waveform.max()))[order]
    if test.all():
        geometries = counted(len(set(geometry)), "geometry")
        raise InputError(
            "the paper's split tests on the largest geometry and waveform; this data set has "
            f"{geometries} and {counted(len(set(waveform)), 'waveform')}, so no case is left for "
            "training; name the cases with a mapping or a file, or do not split (--split none)"
        )
    return {"train": order[~test], "test": order[test]}


def _named_split(
    labels: pd.DataFrame, mapping: Mapping[str, Any], name: str
) -> dict[str, Positions]:
    for key in mapping:
        if key not in ("train", "test"):
            raise InputError(f"{name} has the unknown key {key!r}; the keys are 'train' and 'test'")
    parts = {}
    for key in ("train", "test"):
        if key not in mapping:
            raise InputError(f"{name} has no {key!r}; give it a list of [geometry, waveform] pairs")
        parts[key] = _of_pairs(labels, mapping[key], f"{key!r} of {name}")
    both = labels.iloc[np.intersect1d(parts["train"], parts["test"])]
    if len(both):
        pairs = f"(geometry, waveform) = {listed(case_keys(both))}"
        raise InputError(f"{name} has cases in both 'train' and 'test': {pairs}")
    return parts
