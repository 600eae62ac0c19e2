"""Which simulations to run: an ordered list of few cases, from inflows and areas alone.

The first two simulations are the two cases farthest apart.  Each further step finds the case
farthest from all chosen simulations and chooses the candidate nearest to it (after Kennard and
Stone 1969, Technometrics 11:137).  Distances are those of the quantities of
:data:`~pcnde_bridge.uncertainty.novelty.QUANTITIES` that differ between the cases, such as the
amplitude of the inflow and the logarithm of the narrowest area ratio, each over its range.  The
method was chosen by errors on left-out cases, see the page "How many simulations do I need?".
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import make_folder, write_csv
from pcnde_bridge._utils.validation import counted, whole
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.units import in_cgs, stated_units
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.inputs import Inputs, check_plausible
from pcnde_bridge.model.metrics import relative_error
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.predictor import Predictor
from pcnde_bridge.uncertainty.novelty import QUANTITIES, Novelty, describe

_TOLERANCE = 0.1
"""Relative difference between the inputs of a simulation and of its candidate."""


def all_pairs(
    inflow: Array,
    area_undeformed: Array,
    grid: Grid,
    units: str | Mapping[str, str] | None = None,
) -> tuple[ModelInputs, pd.DataFrame]:
    """Combine every vessel with every inflow, as candidates.

    Parameters
    ----------
    inflow : array of shape (waveform, time)
        Q_in, mL/s.
    area_undeformed : array of shape (geometry, z)
        S_u, cm².
    grid : Grid
        Their time points and points.
    units : str or mapping, optional
        Units of the inputs, see :meth:`pcnde_bridge.PCNDE.predict`; CGS by default.

    Returns
    -------
    candidates : ModelInputs
        The waveforms vary fastest; CGS units.
    labels : DataFrame
        Columns ``geometry`` and ``waveform``, numbers from 1, a row for each candidate.

    Raises
    ------
    InputError
        If a mean inflow is negative, or the units are wrong or ambiguous.
    """
    stated = stated_units(units)
    time, period = (in_cgs("time", values, stated) for values in (grid.time, grid.period))
    grid = Grid(time, in_cgs("z", grid.z, stated), period)
    inflow = in_cgs("flow", inflow, stated)
    area_undeformed = in_cgs("area", area_undeformed, stated)
    geometry, waveform = np.indices((len(area_undeformed), len(inflow))).reshape(2, -1)
    labels = pd.DataFrame({"geometry": geometry + 1, "waveform": waveform + 1})
    candidates = ModelInputs(inflow[waveform], area_undeformed[geometry], grid)
    inputs = Inputs(*candidates, units={"shape": "area", **stated})
    check_plausible(inputs, np.ones(len(labels), dtype=bool), None)
    return candidates, labels


def choose(
    candidates: ModelInputs,
    count: int,
    *,
    done: Sequence[int] = (),
    use: ModelInputs | None = None,
) -> pd.DataFrame:
    """Choose the simulations to run, in order.

    Parameters
    ----------
    candidates : ModelInputs
        Inflows and areas that can be simulated.
    count : int
        Number of simulations to choose.
    done : sequence of int
        Positions of the candidates that have been simulated.
    use : ModelInputs, optional
        Inflows and areas that the model will be used for; by default the candidates.

    Returns
    -------
    DataFrame
        A row for each simulation: ``case``, its position; its quantities (see
        :func:`~pcnde_bridge.uncertainty.novelty.describe`) that differ between candidates,
        with ``blockage`` and ``widening`` as fractions of the area;
        ``reason``; ``uncovered``, the largest distance from a case of ``use`` to its nearest
        simulation, each quantity scaled by its range; and ``farthest``, the position of that case.

    Raises
    ------
    InputError
        If there are fewer candidates than simulations, or ``done`` is not usable.
    """
    chosen, total = [int(case) for case in done], len(candidates.inflow)
    if len(set(chosen)) < len(chosen) or not all(0 <= case < total for case in chosen):
        raise InputError(f"done must be different positions of the {total} candidates.")
    if whole("count", count, 1) > total - len(chosen):
        left = f"{total - len(chosen)} of {counted(total, 'candidate')} are left"
        raise InputError(f"{counted(count, 'simulation')} cannot be chosen: {left}.")
    names, values, points, targets = _scaled(candidates, use or candidates)
    near = np.full(len(targets), np.inf)  # distance of each case to its nearest simulation
    for case in chosen:
        near = np.minimum(near, _distances(targets, points[case]))
    # The first one is at one end of the longest distance, the second one at the other.
    far = near if chosen else np.array([_distances(points, target).max() for target in targets])
    farthest = int(far.argmax())
    rows: list[dict[str, Any]] = []
    for _ in range(count):
        free = np.setdiff1d(np.arange(total), chosen)
        case = int(free[_distances(points[free], targets[farthest]).argmin()])
        reason = _reason(names, values, points, case, chosen)
        chosen.append(case)
        near = np.minimum(near, _distances(targets, points[case]))
        farthest = int(near.argmax())
        found = dict(zip(names, values[case], strict=True))
        rows.append({"case": case, **found, "reason": reason})
        rows[-1] |= {"uncovered": near.max(), "farthest": farthest}
    return pd.DataFrame(rows)


def confused(
    candidates: ModelInputs, done: Sequence[int], finished: ModelInputs
) -> list[tuple[int, int]]:
    """Find finished simulations whose inputs are those of another candidate.

    Differences are relative to each quantity: results on another grid, or with a few percent
    less flow at the inlet, still belong to their candidate.

    Parameters
    ----------
    candidates : ModelInputs
        The candidates.
    done : sequence of int
        Position of the candidate of each finished simulation.
    finished : ModelInputs
        Inputs of the finished simulations, on any grid.

    Returns
    -------
    list of pairs
        Position of a finished simulation that differs from its candidate by more than a tenth,
        and of another candidate, from which it differs less than half as much.
    """
    values, found = describe(*candidates), describe(*finished)
    size = np.abs(values)
    size[:, 4:6] = 1.0  # logarithms of ratios
    # The amplitude of a nearly steady flow, and a mean near zero, are compared with the other.
    size[:, :2] = np.maximum(size[:, :2], _TOLERANCE * size[:, 1::-1])
    wrong = []
    for case, own in enumerate(done):
        # What a case does not have, such as the frequency of a steady flow, does not differ.
        distances = np.linalg.norm(np.nan_to_num((values - found[case]) / size[own]), axis=1)
        nearest = int(distances.argmin())
        if distances[own] > max(_TOLERANCE, 2 * distances[nearest]):
            wrong.append((case, nearest))
    return wrong


def _distances(points: Array, point: Array) -> Array:
    return np.linalg.norm(points - point, axis=1)


def _scaled(candidates: ModelInputs, use: ModelInputs) -> tuple[list[str], Array, Array, Array]:
    """Return names and values of the quantities that differ, and both sets scaled by range.

    Among the values, blockage and widening are fractions of the area.  The ranges are those
    of the novelty, which are not narrower than a share of the quantity.
    """
    inflow = np.concatenate([candidates.inflow, use.inflow])
    area = np.concatenate([candidates.area_undeformed, use.area_undeformed])
    middle, half_width = Novelty.fit(inflow, area, candidates.grid).ranges
    described = [describe(*inputs) for inputs in (candidates, use)]
    # What a case does not have, such as the frequency of a steady flow, is in the middle.
    values, wanted = (np.where(np.isnan(found), middle, found) for found in described)
    differ = np.ptp(np.concatenate([values, wanted]), axis=0) > half_width
    names = [name for name, differs in zip(QUANTITIES, differ, strict=True) if differs]
    scale = 2 * half_width[differ]
    points, targets = values[:, differ] / scale, wanted[:, differ] / scale
    for column in map(QUANTITIES.index, ("blockage", "widening")):
        values[:, column] = np.abs(1 - np.exp(values[:, column]))
    return names, values[:, differ], points, targets


def _reason(
    names: Sequence[str], values: Array, points: Array, case: int, before: Sequence[int]
) -> str:
    """Return in which quantity a case differs most from the nearest one before."""
    if not before:
        return "one end of the longest distance"
    moved = points[before] - points[case]
    nearest = int(np.linalg.norm(moved, axis=1).argmin())
    if not moved[nearest].any():
        return "same quantities as a chosen case"
    most = int(np.abs(moved[nearest]).argmax())
    there = values[before[nearest], most]
    return f"{names[most]} {values[case, most]:.3g}; nearest chosen case: {there:.3g}"


def expected_errors(
    model: Predictor, use: ModelInputs, samples: int = 64, seed: int = 0
) -> pd.DataFrame:
    """Estimate the errors of a model for cases without results, as a stopping rule.

    The distances of a calibrated model's samples from their mean estimate its errors.

    Parameters
    ----------
    model : PCNDE or Ensemble
        Model with samples: of the preset ``physics``, or an ensemble.
    use : ModelInputs
        Inflows and areas that the model will be used for.
    samples, seed : int
        Number of samples, and their random seed.

    Returns
    -------
    DataFrame
        A row for each of ``flow``, ``area``, ``pressure`` and ``pressure_drop``; ``expected``,
        the median of the relative error over all cases, and ``upper``, its 90 % quantile.
    """
    inflow, area_undeformed, grid = use
    where: dict[str, Any] = {"z": grid.z, "period": grid.period} if model.any_grid else {}
    prediction = model.predict(inflow, area_undeformed, samples=samples, seed=seed, **where)

    def quantities(of: Prediction) -> dict[str, Array]:
        return {n: getattr(of, n) for n in VARIABLES} | {"pressure_drop": of.pressure_drop()}

    mean = quantities(prediction)
    errors = [
        {name: relative_error(values, mean[name]) for name, values in quantities(one).items()}
        for one in prediction.each_sample()
    ]
    quantiles = pd.DataFrame(errors).quantile([0.5, 0.9]).T
    return quantiles.set_axis(["expected", "upper"], axis="columns")


def write_inputs(
    folder: StrPath, candidates: ModelInputs, labels: pd.DataFrame, chosen: pd.DataFrame
) -> None:
    """Write the input of the chosen simulations.

    Parameters
    ----------
    folder : path-like
        Folder for ``design.csv``, the chosen simulations; ``labels.csv``, which names the
        result file of each one for ``pcnde convert --labels``; for each waveform
        ``inflow_W.flow``, time (s) and flow (mL/s), negative into the vessel, as SimVascular
        reads it; and for each geometry ``vessel_G.csv``, z (cm) and S_u (cm²).
    candidates : ModelInputs
        The candidates.
    labels : DataFrame
        Columns ``geometry`` and ``waveform``, a row for each candidate.
    chosen : DataFrame
        Result of :func:`choose`.

    Raises
    ------
    FileError
        If the folder cannot be written.
    """
    path, (inflow, area_undeformed, grid) = Path(folder), candidates
    make_folder(path)
    keys = labels.loc[chosen["case"], ["geometry", "waveform"]].reset_index(drop=True)
    files = [f"G{g}_W{w}.vtp" for g, w in keys.itertuples(index=False)]
    time = np.append(grid.time - grid.time[0], grid.period)
    pairs = zip(chosen["case"], keys.itertuples(index=False), strict=True)
    for case, (geometry, waveform) in pairs:
        cycle = pd.DataFrame({"time": time, "flow": -np.append(inflow[case], inflow[case, 0])})
        flow_file = path / f"inflow_{waveform}.flow"
        write_csv(flow_file, cycle, index=False, header=False, sep="\t")
        vessel = pd.DataFrame({"z": grid.z, "area": area_undeformed[case]})
        write_csv(path / f"vessel_{geometry}.csv", vessel, index=False)
    write_csv(path / "labels.csv", keys.assign(file=files), index=False)
    write_csv(path / "design.csv", pd.concat([keys, chosen], axis="columns"), index=False)
