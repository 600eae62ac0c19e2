"""Cases held out of training: whole waveforms and whole geometries.

Holding out single cases would be too easy a test, because the other cases with the same
waveform or geometry are similar.
"""

from __future__ import annotations

import numpy as np

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions as Positions
from pcnde_bridge.errors import InputError


def each_waveform_and_geometry(cases: Cases) -> dict[tuple[str, int], Positions]:
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


def neighboring_folds(cases: Cases, folds: int) -> list[Positions]:
    """Return the folds on which uncertainty is calibrated.

    The geometries in the order of their narrowest area, and the waveforms in the order
    of their oscillation, are each divided into ``folds`` groups of neighbors.  So the
    extreme ones are held out together: predictions are often requested beyond the
    training cases.  If there are at most ``folds`` geometries or waveforms, every
    ``folds``-th case is held out instead.
    """
    narrowness = cases.area_undeformed.min(axis=1) / cases.area_undeformed.max(axis=1)
    oscillation = np.std(cases.inflow, axis=1)
    found = []
    for label, order in (("geometry", narrowness), ("waveform", oscillation)):
        values = cases.labels[label].to_numpy()
        distinct = np.unique(values)
        if len(distinct) <= folds:
            continue
        mean = [float(order[values == v].mean()) for v in distinct]
        ranked = distinct[np.argsort(mean, kind="stable")]
        found += [np.flatnonzero(np.isin(values, part)) for part in np.array_split(ranked, folds)]
    if found:
        return found
    return [np.arange(k, len(cases), folds) for k in range(folds) if len(cases) > folds]
