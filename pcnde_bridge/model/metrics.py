"""Relative errors as the paper's table defines them."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import check_shape
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.indices import one_minus_ffr, pressure_drop
from pcnde_bridge.data.selection import case_keys
from pcnde_bridge.data.stenosis import measuring_positions
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError

AREA_MARGIN = 5
"""Number of points left out at either end of the area, where walls are clamped (section 3.3)."""

POOLED = "pooled"
"""Label of the row over all cases in :func:`error_table`."""

_DERIVED = {"pressure_drop": pressure_drop, "one_minus_ffr": one_minus_ffr}

ERRORS = (*VARIABLES, *_DERIVED, "wall_shear_stress", "time_averaged_wall_shear_stress")
"""Names of all errors, in their order in tables."""


def relative_error(predicted: Array, reference: Array) -> float:
    """Return ‖Y − Y_GT‖ / ‖Y_GT‖ over all values of an array (section 3.3 of the paper).

    Raises
    ------
    InputError
        If the shapes differ or the reference is zero.
    """
    check_shape("The prediction", predicted, reference.shape)
    # Sums, because BLAS, which computes a norm, starts threads for every case.
    size = np.square(reference, dtype=float).sum()
    if size == 0:
        raise InputError("The relative error is undefined: the reference is zero everywhere.")
    error = np.subtract(predicted, reference, dtype=float)
    error *= error  # a second array may be large
    return float(np.sqrt(error.sum() / size))


def reference_of(variable: str, values: Array, cases: Cases) -> Array:
    """Return the reference of a predicted variable, if the prediction has its shape.

    Raises
    ------
    InputError
        If the cases do not have the variable, or the shapes differ.
    """
    reference = cases.variables().get(variable)
    if reference is None:
        raise InputError(f"The cases have no {variable}: leave it out of the prediction.")
    check_shape(f"The predicted {variable}", values, reference.shape, "case, time, z")
    return reference


def compared(variable: str, values: Array) -> Array:
    """Return the values (..., z) that the error of a variable includes: areas without the ends."""
    if variable == "area" and values.shape[-1] > 2 * AREA_MARGIN:
        return values[..., AREA_MARGIN:-AREA_MARGIN]
    return values


def pooled_errors(predicted: Mapping[str, Array], cases: Cases) -> dict[str, float]:
    """Return the relative error of each variable over all cases, time points and positions.

    With a pressure, there are two more errors, of quantities between the default positions of
    :meth:`pcnde_bridge.Cases.pressure_drop`: ``pressure_drop`` over all cases and time points,
    and ``one_minus_ffr``, that of 1 − FFR, over all cases.  They are NaN where the reference
    is zero.  With a wall shear stress, in the prediction and in the reference, there is also the
    error of its ``time_averaged_wall_shear_stress`` over all cases and points.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Predicted variables.
    cases : Cases
        Reference values.
    """
    return {name: _error(name, *pair) for name, pair in _pairs(predicted, cases).items()}


def error_table(predicted: Mapping[str, Array], cases: Cases) -> pd.DataFrame:
    """Return the relative errors of every case, and over all cases.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Predicted variables.
    cases : Cases
        Reference values.

    Returns
    -------
    DataFrame
        Index ``geometry`` and ``waveform``, a column for each error of :func:`pooled_errors`;
        the last row, labeled ``("pooled", "pooled")``, is over all cases.
    """
    pairs = _pairs(predicted, cases).items()
    return case_table(lambda s: {name: _error(name, v[s], t[s]) for name, (v, t) in pairs}, cases)


def case_table(measure: Callable[[slice], dict[str, Any]], cases: Cases) -> pd.DataFrame:
    """Return measures of every case, and of all cases, as rows of a table.

    Parameters
    ----------
    measure : callable
        Takes a range of cases, and returns its measures by name.
    cases : Cases
        The cases, whose labels are the index.
    """
    subsets = [*(slice(i, i + 1) for i in range(len(cases))), slice(None)]
    keys = [*case_keys(cases.labels), (POOLED, POOLED)]
    index = pd.MultiIndex.from_tuples(keys, names=["geometry", "waveform"])
    return pd.DataFrame([measure(subset) for subset in subsets], index)


def _pairs(predicted: Mapping[str, Array], cases: Cases) -> dict[str, tuple[Array, Array]]:
    """Return prediction and reference of everything that has an error."""
    pairs = {}
    for name in cases.variables():
        if name in predicted:
            truth = reference_of(name, predicted[name], cases)
            pairs[name] = compared(name, predicted[name]), compared(name, truth)
    if "pressure" in pairs:
        ends = measuring_positions(cases.z, cases.area_undeformed)
        values, truth = pairs["pressure"]
        for name, quantity in _DERIVED.items():
            pairs[name] = quantity(values, cases.z, *ends), quantity(truth, cases.z, *ends)
    if "wall_shear_stress" in pairs:
        values, truth = (np.abs(stress).mean(axis=1) for stress in pairs["wall_shear_stress"])
        pairs["time_averaged_wall_shear_stress"] = values, truth
    return {name: pairs[name] for name in ERRORS if name in pairs}


def _error(name: str, values: Array, truth: Array) -> float:
    """Return a relative error; that of a derived quantity is NaN if the reference is zero."""
    return float("nan") if name in _DERIVED and not truth.any() else relative_error(values, truth)


def pooled(table: pd.DataFrame) -> dict[str, float]:
    """Return the errors over all cases, by variable, from a table of :func:`error_table`."""
    return {str(variable): float(error) for variable, error in table.iloc[-1].items()}


def coverage(intervals: Mapping[str, tuple[Array, Array]], cases: Cases) -> dict[str, float]:
    """Return the share of the reference values inside their intervals, by their variable.

    Parameters
    ----------
    intervals : mapping of str to pair of arrays of shape (case, time, z)
        Lower and upper limits; see :meth:`pcnde_bridge.Prediction.interval`.
    cases : Cases
        Reference values.
    """
    return {
        name: float(((intervals[name][0] <= truth) & (truth <= intervals[name][1])).mean())
        for name, truth in cases.variables().items()
        if name in intervals
    }
