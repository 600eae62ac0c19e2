"""Sensitivity of indices such as FFR to the inputs of a model: Sobol indices by SALib."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.optional import require
from pcnde_bridge._utils.validation import all_of, check_memory, finite_vector, whole
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.errors import InputError, PCNDEWarning
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import Windkessel
from pcnde_bridge.hemodynamics.waveform import Waveform, coronary
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.predictor import Predictor

_STENOSIS, _INFLOW = ("blockage", "position", "length"), ("amplitude", "mean_flow")
_FACTORS = "outlet_resistance", "wall_stiffness"

INPUTS = *_STENOSIS, *_INFLOW, *_FACTORS
"""Inputs that can vary: those of :class:`~pcnde_bridge.hemodynamics.geometry.Stenosis`, the
factor of the waveform's oscillation, the mean inflow (mL/s), and factors of all resistances of the
outlet and of the wall's stiffness E·h."""

_LEVELS = 16  # values of the stiffness, each a model of its own; their variance is 0.4 % too small


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
    stenosis and of the waveform; factors are 1.  The stiffness of the wall has 16 equally
    likely values.

    Parameters
    ----------
    model : PCNDE or Ensemble
        Fitted model; a PCNDE of the preset ``physics`` for ranges of outlet and wall.
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

    Warns
    -----
    OutsideTrainingWarning, PCNDEWarning
        See :meth:`PCNDE.predict <pcnde_bridge.PCNDE.predict>`; with a range of the stiffness, for
        the samples of its lowest value.

    Raises
    ------
    MissingExtraError
        If SALib is not installed.
    InputError
        If the model, a range or an index is not usable, or the model cannot predict the length of
        the vessel or the period of the waveform.
    SolveError
        If the equations diverge for a sample.
    """
    if not callable(getattr(model, "predict_batches", None)):
        raise InputError(f"model must be a fitted model, got {type(model).__name__}.")
    if not isinstance(ranges, Mapping) or not ranges:
        raise InputError(f"ranges must name some of {list(INPUTS)}, got {ranges!r}.")
    for name, limits in ranges.items():
        pair = finite_vector(f"ranges[{name!r}]", limits)
        if name not in INPUTS or len(pair) != 2 or not pair[0] < pair[1]:
            raise InputError(f"{name}: {limits} is not a range of one of {list(INPUTS)}.")
        if name in _FACTORS and not (_has_closures(model) and pair[0] > 0):
            raise InputError(
                f"{name}: {limits} must be positive factors, for a model of the preset 'physics'."
            )
    if isinstance(indices, str) or not all_of(str, "indices", indices):
        raise InputError(f"indices must be a sequence of columns, got {indices!r}.")
    sampler = require("SALib.sample.sobol", "sensitivity")
    analysis = require("SALib.analyze.sobol", "sensitivity")
    problem = {"num_vars": len(ranges), "names": [*ranges], "bounds": [*ranges.values()]}
    options = {"calc_second_order": False, "seed": whole("seed", seed)}
    samples = whole("samples", samples, 2)
    if samples & (samples - 1):
        raise InputError(f"samples must be a power of 2, such as 1024, got {samples}.")
    size = len(ranges) + len(indices) + model.grid.time.size + model.grid.z.size
    numbers = 2 * samples * (len(ranges) + 2) * size
    check_memory(f"An analysis of {samples} samples", numbers, "request fewer samples")
    points = sampler.sample(problem, samples, **options)
    if "wall_stiffness" in ranges:
        column = [*ranges].index("wall_stiffness")
        low, high = ranges["wall_stiffness"]
        share = (points[:, column] - low) / (high - low)
        middle = (np.minimum(np.floor(_LEVELS * share), _LEVELS - 1) + 0.5) / _LEVELS
        points[:, column] = low + (high - low) * middle
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


def _has_closures(model: Predictor) -> bool:
    return isinstance(model, PCNDE) and isinstance(model.parameters, ClosureParameters)


def _evaluate(
    model: Any,
    names: Sequence[str],
    points: Array,
    indices: Sequence[str],
    vessel: Vessel,
    waveform: Waveform,
) -> Array:
    """Return the indices (point, index), predicted in batches."""
    (stenosis,) = vessel.stenoses
    fixed = {name: getattr(stenosis, name) for name in _STENOSIS} | {"mean_flow": waveform.mean}
    given = {name: np.full(len(points), fixed.get(name, 1.0)) for name in INPUTS}
    given |= dict(zip(names, points.T, strict=True))
    oscillation = waveform.samples(model.grid.time.size) - waveform.mean
    z, options = _points(model, vessel, waveform)
    inflow = given["mean_flow"][:, None] + given["amplitude"][:, None] * oscillation
    shapes = np.stack([given[name] for name in _STENOSIS], axis=1).tolist()
    vessels = (replace(vessel, stenoses=(Stenosis(*shape),)) for shape in shapes)
    areas = np.array([each.area_undeformed(z) for each in vessels])
    resistance, stiffness = (given[name] for name in _FACTORS)
    outlet = _outlet(model, resistance) if "outlet_resistance" in names else None
    found = np.empty((len(points), len(indices)))
    for number, level in enumerate(np.unique(stiffness)):
        rows = np.flatnonzero(stiffness == level)
        if outlet is not None:
            options = options | {"outlet": outlet.select(rows)}
        with warnings.catch_warnings():
            if number:  # random samples, as those of the first level
                warnings.simplefilter("ignore", PCNDEWarning)
            predictions = _stiffer(model, level).predict_batches(
                inflow[rows], areas[rows], **options
            )
            tables = [_numbers(prediction, indices) for prediction in predictions]
        found[rows] = np.concatenate(tables)
    return found


def _numbers(prediction: Prediction, indices: Sequence[str]) -> Array:
    """Return indices of a prediction, (case, index)."""
    table = prediction.indices()
    known = [*table.select_dtypes("number")]
    if unknown := [index for index in indices if index not in known]:
        raise InputError(f"There is no index {unknown[0]!r}; there are {known}.")
    return np.asarray(table[list(indices)].to_numpy(dtype=float))


def _points(model: Predictor, vessel: Vessel, waveform: Waveform) -> tuple[Array, dict[str, Any]]:
    """Return z, and options of predict if the length or the period is not that of the model."""
    z, period = model.grid.z - model.grid.z[0], model.grid.period
    same = math.isclose(vessel.length, z[-1], rel_tol=1e-6)
    if same and math.isclose(waveform.period, period, rel_tol=1e-6):
        return z, {}
    if not model.any_grid:
        raise InputError(
            f"The vessel is {vessel.length:g} cm long and the period of the waveform is "
            f"{waveform.period:g} s, but the model predicts {z[-1]:g} cm and {period:g} s only: "
            "give a vessel of this length and a waveform of this period."
        )
    z = np.linspace(0.0, vessel.length, z.size)
    return z, {"z": z, "period": waveform.period, "units": "cgs"}


def _outlet(model: Any, factors: Array) -> Any:
    """Return the model's outlet, with a factor of its resistances for each case."""
    outlet: Any = model.outlet or Windkessel(*model.parameters.outlet.tolist())
    names = [field.name for field in fields(outlet) if field.name.endswith("resistance")]
    if not (names and outlet.is_common):
        raise InputError(f"outlet_resistance: {outlet!r} has no resistance common to all cases.")
    return replace(outlet, **{name: getattr(outlet, name) * factors for name in names})


def _stiffer(model: Any, factor: float) -> Any:
    """Return the model with a wall that is stiffer by a factor."""
    if factor == 1:
        return model
    wall = model.parameters.wall * np.where(np.arange(model.parameters.wall.size) == 0, factor, 1)
    return replace(model, parameters=model.parameters.replace(wall=wall))
