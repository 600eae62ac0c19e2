"""Sensitivity of indices such as FFR to the inputs of a model: Sobol indices by SALib."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.optional import require
from pcnde_bridge._utils.validation import all_of, check_memory, finite_vector, whole
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.waveform import Waveform, coronary
from pcnde_bridge.model.predictor import Predictor

INPUTS = ("blockage", "position", "length", "amplitude", "mean_flow")
"""Inputs that can vary: those of :class:`~pcnde_bridge.hemodynamics.geometry.Stenosis`, the
factor of the waveform's oscillation, and the mean inflow (mL/s)."""

_BATCH = 4096


def sobol_indices(
    model: Predictor,
    ranges: Mapping[str, tuple[float, float]],
    indices: Sequence[str] = ("ffr", "mean_drop_mmHg"),
    *,
    samples: int = 1024,
    seed: int = 0,
    vessel: Vessel | None = None,
    waveform: Waveform | None = None,
) -> pd.DataFrame:
    """Compute Sobol indices of hemodynamic indices over ranges of the inputs.

    Inputs are independent and uniform in their ranges, sampled after Saltelli (2010, Computer
    Physics Communications 181:259).  Inputs without a range have the value of the vessel's
    stenosis and of the waveform.

    Parameters
    ----------
    model : PCNDE or Ensemble
        Fitted model.
    ranges : mapping of str to pair of float
        Lowest and highest value of some of :data:`INPUTS`.
    indices : sequence of str
        Columns of :meth:`pcnde_bridge.Prediction.indices`.
    samples : int
        Number of samples, a power of 2; with n ranges, ``samples``·(n + 2) cases are predicted.
    seed : int
        Random seed of the samples.
    vessel : Vessel, optional
        Vessel with one stenosis; by default the paper's, with a blockage of 60 %.
    waveform : Waveform, optional
        Inflow; by default the built-in coronary one.

    Returns
    -------
    DataFrame
        Indexed by ``index`` and ``input``; columns ``first`` and ``total``, the Sobol indices
        of first and of total order, and the half widths of their 95 % intervals,
        ``first_interval`` and ``total_interval``.

    Raises
    ------
    MissingExtraError
        If SALib is not installed.
    InputError
        If the model, a range or an index is not usable, or the model cannot predict the length of
        the vessel or the period of the waveform.
    """
    if not callable(getattr(model, "predict", None)):
        raise InputError(f"model must be a fitted model, got {type(model).__name__}.")
    if not isinstance(ranges, Mapping) or not ranges:
        raise InputError(f"ranges must name some of {list(INPUTS)}, got {ranges!r}.")
    for name, limits in ranges.items():
        pair = finite_vector(f"ranges[{name!r}]", limits)
        if name not in INPUTS or len(pair) != 2 or not pair[0] < pair[1]:
            raise InputError(f"{name}: {limits} is not a range of one of {list(INPUTS)}.")
    if isinstance(indices, str) or not all_of(str, "indices", indices):
        raise InputError(f"indices must be a sequence of columns, got {indices!r}.")
    sampler = require("SALib.sample.sobol", "sensitivity")
    analysis = require("SALib.analyze.sobol", "sensitivity")
    problem = {"num_vars": len(ranges), "names": [*ranges], "bounds": [*ranges.values()]}
    options = {"calc_second_order": False, "seed": whole("seed", seed)}
    samples = whole("samples", samples, 2)
    numbers = 2 * samples * (len(ranges) + 2) * (len(ranges) + len(indices))
    check_memory(f"An analysis of {samples} samples", numbers, "request fewer samples")
    points = sampler.sample(problem, samples, **options)
    [vessel] = all_of(Vessel, "vessel", [vessel or Vessel((Stenosis(0.6),))])
    [waveform] = all_of(Waveform, "waveform", [coronary() if waveform is None else waveform])
    if len(vessel.stenoses) != 1:
        raise InputError(f"vessel must have one stenosis, got {vessel!r}.")
    found = _evaluate(model, [*ranges], points, indices, vessel, waveform)
    tables = {}
    for number, index in enumerate(indices):
        # SALib takes a seed of 0 for none.
        result = analysis.analyze(problem, found[:, number], **options | {"seed": seed + 1})
        columns = {"first": "S1", "total": "ST", "first_interval": "S1_conf"}
        columns["total_interval"] = "ST_conf"
        values = {column: result[key] for column, key in columns.items()}
        tables[index] = pd.DataFrame(values, index=[*ranges])
    return pd.concat(tables, names=["index", "input"])


def _evaluate(
    model: Predictor,
    names: Sequence[str],
    points: Array,
    indices: Sequence[str],
    vessel: Vessel,
    waveform: Waveform,
) -> Array:
    """Return the indices (point, index), predicted in batches."""
    (stenosis,) = vessel.stenoses
    given = (stenosis.blockage, stenosis.position, stenosis.length, 1.0, waveform.mean)
    values = np.tile(given, (len(points), 1))
    values[:, [INPUTS.index(name) for name in names]] = points
    oscillation = waveform.samples(model.grid.time.size) - waveform.mean
    z, options = _points(model, vessel, waveform)
    found = []
    for start in range(0, len(points), _BATCH):
        rows = values[start : start + _BATCH]
        inflow = rows[:, 4:] + rows[:, 3:4] * oscillation
        vessels = (replace(vessel, stenoses=(Stenosis(*row),)) for row in rows[:, :3].tolist())
        areas = np.array([each.area_undeformed(z) for each in vessels])
        table = model.predict(inflow, areas, **options).indices()
        known = [*table.select_dtypes("number")]
        if unknown := [index for index in indices if index not in known]:
            raise InputError(f"There is no index {unknown[0]!r}; there are {known}.")
        found.append(table[list(indices)].to_numpy(dtype=float))
    return np.concatenate(found)


def _points(model: Predictor, vessel: Vessel, waveform: Waveform) -> tuple[Array, dict[str, Any]]:
    """Return the points of the vessel, and options of predict if they or the period are others."""
    z, period = model.grid.z - model.grid.z[0], model.grid.period
    same = math.isclose(vessel.length, z[-1], rel_tol=1e-6)
    if same and math.isclose(waveform.period, period, rel_tol=1e-6):
        return z, {}
    if not model.any_grid:
        raise InputError(
            f"vessel has {vessel.length:g} cm and waveform {waveform.period:g} s, but the model "
            f"predicts {z[-1]:g} cm and {period:g} s only: give a vessel and a waveform of these."
        )
    z = np.linspace(0.0, vessel.length, z.size)
    return z, {"z": z, "period": waveform.period, "units": "cgs"}
