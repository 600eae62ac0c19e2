"""Which cases are held out: whole waveforms and whole geometries, as single cases are too easy.

The other cases of a waveform or a geometry tell most of what there is to know of one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError

Positions = npt.NDArray[np.int64]

_FEWEST = 8  # cases, below which none is spared for validation


def each_waveform_and_geometry(cases: Cases) -> dict[tuple[str, int], Positions]:
    """List every waveform, then every geometry, as cross-validation holds them out in turns.

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
        raise InputError(
            "There is a single waveform and a single geometry: nothing can be held out."
        )
    return found


def neighbouring_parts(cases: Cases, folds: int) -> list[Positions]:
    """List the parts that uncertainty is calibrated on.

    The geometries in the order of their narrowest area, and the waveforms in the
    order of their oscillation, are each cut into ``folds`` neighbouring parts, so
    that the outermost are left out together: predictions are often asked for
    beyond the training cases.  Where there are fewer geometries or waveforms than
    parts and one, every ``folds``-th case is left out instead.
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


def training_and_validation(cases: Cases, share: float, seed: int) -> tuple[Positions, ...]:
    """Return the training part and, unless none is spared, the validation part.

    Whole waveforms and whole geometries, in turns and drawn at random, go into the
    validation part until it has its share of the cases.  Labels with a single value
    are not drawn from; where no label groups the cases, single cases are drawn.

    Parameters
    ----------
    cases : Cases
        All training cases.
    share : float
        Of the cases that are to validate.
    seed : int
        Of the draw.
    """
    rng, count = np.random.default_rng(seed), len(cases)
    everything = np.arange(count)
    wanted = round(share * count)
    if count < _FEWEST or wanted == 0:
        return (everything,)
    held = np.zeros(count, dtype=bool)
    groups = [cases.labels[name].to_numpy() for name in ("waveform", "geometry")]
    columns = [g for g in groups if 1 < len(np.unique(g)) < count]
    queues = [list(rng.permutation(np.unique(g))) for g in columns]
    while held.sum() < wanted and any(queues):
        for column, queue in zip(columns, queues, strict=True):
            # A group that would take half of the cases is too large to be spared.
            if queue and held.sum() < wanted:
                larger = held | (column == queue.pop())
                held = larger if larger.sum() <= count // 2 else held
    if not held.any():
        held[rng.permutation(count)[:wanted]] = True
    return everything[~held], everything[held]
