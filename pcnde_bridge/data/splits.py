"""Division of a data set into training and test cases, and into folds.

Holding out single cases can be too easy a test, because the other cases with the same
waveform or geometry are similar: whole waveforms and geometries can be held out, too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._utils.files import reading
from pcnde_bridge._utils.validation import counted, listed, whole
from pcnde_bridge.data.indices import VesselQuantities
from pcnde_bridge.data.selection import (
    Positions,
    case_keys,
    label_values,
    pair_positions,
    select_positions,
)
from pcnde_bridge.errors import DataNotFoundError, InputError

_WAYS = "'paper', a fraction, label values, a mapping or the path of a JSON file"


def split_positions(
    labels: pd.DataFrame, how: Any, by: str | None, seed: int, wanted: Mapping[str, Any]
) -> dict[str, Positions]:
    """Return the positions of the training and of the test cases.

    Parameters
    ----------
    labels : DataFrame
        Labels of the data set.
    how, by, seed
        See :meth:`pcnde_bridge.Cases.split`.
    wanted : mapping
        Label values of the test cases, in place of ``how``.

    Raises
    ------
    InputError
        If training or test would be empty, or the arguments are not usable.
    FileError
        If the file is missing or is not JSON.
    """
    is_fraction = isinstance(how, Real) and not isinstance(how, bool)
    if wanted and how is not None:
        raise InputError(f"give how={how!r} or label values of the test cases, but not both")
    if by is not None and not is_fraction:
        raise InputError(f"by={by!r} needs the fraction of the test cases, such as 0.2")
    if wanted:
        return _with_rest(labels, select_positions(labels, None, wanted))
    if is_fraction:
        return _with_rest(labels, _random_fraction(labels, float(how), by, seed))
    if how is None or (isinstance(how, str) and how == "paper"):
        return _paper_split(labels)
    if isinstance(how, Mapping):
        return _named_split(labels, how, "the split")
    if not isinstance(how, str | os.PathLike):
        raise InputError(f"how must be {_WAYS}, got {how!r}")
    path, name = Path(how), repr(str(how))
    if not path.exists():
        raise DataNotFoundError(f"there is no split file {name}; give {_WAYS}")
    with reading(path, "a readable JSON file"):
        mapping = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(mapping, dict):
        raise InputError(f'{name} must hold {{"train": [...], "test": [...]}}')
    return _named_split(labels, mapping, name)


def fold_positions(
    labels: pd.DataFrame, count: int, by: str | None, seed: int
) -> list[dict[str, Positions]]:
    """Return the training and test cases of every fold, see :meth:`pcnde_bridge.Cases.folds`."""
    codes, order = _shuffled(labels, by, seed)
    if not 2 <= whole("folds", count) <= len(order):
        raise InputError(f"folds is {count}; {_described(order, by)} allow 2 to {len(order)} folds")
    parts = np.array_split(order, count)
    return [_with_rest(labels, np.flatnonzero(np.isin(codes, part))) for part in parts]


def _random_fraction(labels: pd.DataFrame, share: float, by: str | None, seed: int) -> Positions:
    """Return the positions of a random fraction of the cases or label values, at least one."""
    codes, order = _shuffled(labels, by, seed)
    if not 0 < share < 1:
        raise InputError(f"the fraction of the test cases must be between 0 and 1, got {share:g}")
    count = min(max(round(share * len(order)), 1), len(order) - 1)
    return np.flatnonzero(np.isin(codes, order[:count]))


def _shuffled(labels: pd.DataFrame, by: str | None, seed: int) -> tuple[Positions, Positions]:
    """Return the group of every case, and the groups in random order.

    A group is one case, or all cases with the same value of the label ``by``.
    """
    values = np.arange(len(labels)) if by is None else label_values(labels, by)
    codes = np.asarray(pd.factorize(values, sort=True, use_na_sentinel=False)[0])
    order = np.random.default_rng(whole("seed", seed)).permutation(codes.max() + 1)
    if len(order) < 2:
        raise InputError(f"{_described(order, by)} cannot be divided: at least two are needed")
    return codes, order


def _described(groups: Positions, by: str | None) -> str:
    return counted(len(groups), f"{by} value" if by else "case")


def _with_rest(labels: pd.DataFrame, test: Positions) -> dict[str, Positions]:
    train = np.setdiff1d(np.arange(len(labels)), test)
    if not train.size:
        raise InputError("all cases would be test cases, so no case is left for training")
    return {"train": train, "test": test}


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
        parts[key] = pair_positions(labels, mapping[key], f"{key!r} of {name}")
    both = labels.iloc[np.intersect1d(parts["train"], parts["test"])]
    if len(both):
        pairs = f"(geometry, waveform) = {listed(case_keys(both))}"
        raise InputError(f"{name} has cases in both 'train' and 'test': {pairs}")
    return parts


def each_waveform_and_geometry(cases: VesselQuantities) -> dict[tuple[str, int], Positions]:
    """Return the cases of every waveform, then of every geometry, for cross-validation.

    Returns
    -------
    dict
        Positions of the cases by the name and value of their label.

    Raises
    ------
    InputError
        If there is neither a second waveform nor a second geometry.
    """
    found: dict[tuple[str, int], Positions] = {}
    for label in ("waveform", "geometry"):
        values = cases.labels[label].to_numpy()
        distinct = np.unique(values)
        if len(distinct) > 1:
            found |= {(label, int(value)): np.flatnonzero(values == value) for value in distinct}
    if not found:
        raise InputError("There is one waveform and one geometry: nothing can be held out.")
    return found


def neighboring_folds(cases: VesselQuantities, folds: int) -> list[Positions]:
    """Return the folds on which uncertainty is calibrated.

    The geometries in the order of their narrowest area, and the waveforms in the order
    of their oscillation, are each divided into ``folds`` groups of neighbors.  So the
    extreme ones are held out together: predictions are often requested beyond the
    training cases.  If there are at most ``folds`` geometries or waveforms, every
    ``folds``-th case is held out instead.
    """
    narrowness = cases.area_undeformed.min(axis=1) / cases.area_undeformed.max(axis=1)
    oscillation = np.std(cases.flow[:, :, 0], axis=1)
    found = []
    for label, order in (("geometry", narrowness), ("waveform", oscillation)):
        values = cases.labels[label].to_numpy()
        distinct = np.unique(values)
        if len(distinct) <= folds:
            continue
        mean = [float(order[values == v].mean()) for v in distinct]
        ranked = distinct[np.argsort(mean, kind="stable")]
        found += [np.flatnonzero(np.isin(values, part)) for part in np.array_split(ranked, folds)]
    count = len(oscillation)
    return found or [np.arange(k, count, folds) for k in range(folds) if count > folds]
