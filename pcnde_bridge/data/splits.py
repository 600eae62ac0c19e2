"""Division of a data set into training and test cases, and into folds.

Holding out single cases can be too easy a test, because the other cases with the same
waveform or geometry are similar: whole waveforms and geometries can be held out, too.
"""

import os
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._utils.files import read_json
from pcnde_bridge._utils.validation import counted, listed, whole
from pcnde_bridge.data import selection
from pcnde_bridge.data.indices import VesselQuantities
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.errors import DataNotFoundError, InputError

_WAYS = "'paper', a fraction, label values, a mapping or the path of a JSON file"


def split_positions(
    labels: pd.DataFrame, how: Any, by: str | None, seed: int, wanted: Mapping[str, Any]
) -> tuple[Positions, Positions]:
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
    if wanted and how is not None:
        raise InputError(f"give how={how!r} or label values of the test cases, but not both")
    if isinstance(how, Real) and not isinstance(how, bool):
        return _random_split(labels, float(how), by, seed)
    if by is not None:
        raise InputError(f"by={by!r} needs the fraction of the test cases, such as 0.2")
    if wanted:
        return _with_rest(labels, selection.select_positions(labels, None, wanted))
    if how is None or (isinstance(how, str) and how == "paper"):
        return _paper_split(labels)
    if isinstance(how, Mapping):
        return _named_split(labels, how, "the split")
    if not isinstance(how, str | os.PathLike):
        raise InputError(f"how must be {_WAYS}, got {how!r}")
    try:
        mapping = read_json(how, 'pairs, {"train": [...], "test": [...]}')
    except DataNotFoundError as error:
        raise DataNotFoundError(f"there is no split file {str(how)!r}; give {_WAYS}") from error
    return _named_split(labels, mapping, repr(str(how)))


def fold_positions(
    labels: pd.DataFrame, count: int, by: str | None, seed: int
) -> list[tuple[Positions, Positions]]:
    """Return the training and test cases of every fold, see :meth:`pcnde_bridge.Cases.folds`."""
    codes, order = _shuffled(labels, by, seed)
    if not 2 <= whole("folds", count) <= len(order):
        groups = counted(len(order), f"{by} value" if by else "case")
        raise InputError(f"folds is {count}; {groups} allow 2 to {len(order)} folds")
    parts = np.array_split(order, count)
    return [_with_rest(labels, np.flatnonzero(np.isin(codes, part))) for part in parts]


def _random_split(
    labels: pd.DataFrame, share: float, by: str | None, seed: int
) -> tuple[Positions, Positions]:
    """Divide the cases, or the values of a label, at random."""
    codes, order = _shuffled(labels, by, seed)
    if not 0 < share < 1:
        raise InputError(f"the fraction of the test cases must be between 0 and 1, got {share:g}")
    count = min(max(round(share * len(order)), 1), len(order) - 1)
    return _with_rest(labels, np.flatnonzero(np.isin(codes, order[:count])))


def _shuffled(labels: pd.DataFrame, by: str | None, seed: int) -> tuple[Positions, Positions]:
    """Return the group of every case, and the groups in random order.

    A group is one case, or all cases with the same value of the label ``by``.
    """
    values = np.arange(len(labels)) if by is None else selection.label_values(labels, by)
    codes = np.asarray(pd.factorize(values, sort=True, use_na_sentinel=False)[0])
    return codes, np.random.default_rng(whole("seed", seed)).permutation(codes.max() + 1)


def _with_rest(labels: pd.DataFrame, test: Positions) -> tuple[Positions, Positions]:
    train = np.setdiff1d(np.arange(len(labels)), test)
    if not (train.size and test.size):
        left = "training" if test.size else "testing"
        raise InputError(f"this split puts all cases into one set: no case is left for {left}")
    return train, test


def _paper_split(labels: pd.DataFrame) -> tuple[Positions, Positions]:
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
    return order[~test], order[test]


def _named_split(
    labels: pd.DataFrame, mapping: Mapping[str, Any], name: str
) -> tuple[Positions, Positions]:
    if unknown := [key for key in mapping if key not in ("train", "test")]:
        raise InputError(f"{name} has the unknown key {unknown[0]!r}; give 'train' and 'test'")
    if lacking := [key for key in ("train", "test") if key not in mapping]:
        what = "a list of [geometry, waveform] pairs"
        raise InputError(f"{name} has no {lacking[0]!r}; give it {what}")
    train, test = (
        selection.pair_positions(labels, mapping[key], f"{key!r} of {name}")
        for key in ("train", "test")
    )
    if len(both := labels.iloc[np.intersect1d(train, test)]):
        pairs = f"(geometry, waveform) = {listed(selection.case_keys(both))}"
        raise InputError(f"{name} has cases in both 'train' and 'test': {pairs}")
    return train, test


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
    of their oscillation, are each divided into ``folds`` groups of neighbors, or into as many
    as there are.  So the extreme ones are held out together: predictions are often requested
    beyond the training cases.  If all cases have one geometry and one waveform, every
    ``folds``-th case is held out instead.  The list is empty if there are at most ``folds`` cases.
    """
    count = len(cases.area_undeformed)
    if count <= folds:
        return []
    narrowness = cases.area_undeformed.min(axis=1) / cases.area_undeformed.max(axis=1)
    oscillation = np.std(cases.flow[:, :, 0], axis=1)
    found = []
    for label, order in (("geometry", narrowness), ("waveform", oscillation)):
        values = cases.labels[label].to_numpy()
        distinct = np.unique(values)
        if len(distinct) == 1:
            continue
        mean = [float(order[values == v].mean()) for v in distinct]
        ranked = distinct[np.argsort(mean, kind="stable")]
        groups = np.array_split(ranked, min(folds, len(distinct)))
        found += [np.flatnonzero(np.isin(values, group)) for group in groups]
    return found or [np.arange(k, count, folds) for k in range(folds)]
