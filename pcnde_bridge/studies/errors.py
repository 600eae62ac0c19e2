"""Errors in detail: case by case, point by point, and their spread (section 3.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import (
    POOLED,
    compared,
    error_table,
)

_WHISKER = 1.5  # quartile distances
_STATISTICS = ("median", "lower", "upper", "low", "high", "largest", "outliers")


def error_matrix(predicted: Mapping[str, Array], cases: Cases) -> dict[str, pd.DataFrame]:
    """Relative error of every case, geometries down and waveforms across.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Any of flow, area and pressure.
    cases : Cases
        The truth.

    Returns
    -------
    dict of str to DataFrame
        For each variable, indexed by ``geometry``, a column for each ``waveform``, both
        in increasing order; NaN where there is no such case.
    """
    table = error_table(predicted, cases).drop(index=(POOLED, POOLED))
    return {
        str(name): table[name].unstack("waveform").sort_index().sort_index(axis=1)
        for name in table.columns
    }


@dataclass(frozen=True, eq=False)
class PointwiseErrors:
    """One case: truth, prediction and their distance at every instant and point.

    Attributes
    ----------
    case : Cases
        The truth, a single case.
    predicted : mapping of str to array of shape (time, z)
        Flow (mL/s), area (cm²) and pressure (dyn/cm²).
    distance : mapping of str to array of shape (time, z)
        Of flow |Q − Q_GT| (mL/s); of area |S − S_GT|/S_GT(t=0); of pressure
        |p − p_GT| (dyn/cm²).
    """

    case: Cases = field(repr=False)
    predicted: Mapping[str, Array] = field(repr=False)
    distance: Mapping[str, Array] = field(repr=False)

    def to_frame(self) -> pd.DataFrame:
        """Scalar measures, a row for each variable.

        Returns
        -------
        DataFrame
            ``mean`` and ``largest`` distance, and its means ``upstream`` and
            ``downstream`` of the vessel's middle.
        """
        middle = (self.case.z[0] + self.case.z[-1]) / 2
        first, second = self.case.z < middle, self.case.z > middle
        rows = {
            name: {
                "mean": float(values.mean()),
                "largest": float(values.max()),
                "upstream": float(values[:, first].mean()),
                "downstream": float(values[:, second].mean()),
            }
            for name, values in self.distance.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("variable")


def pointwise_errors(predicted: Mapping[str, Array], case: Cases) -> PointwiseErrors:
    """Absolute errors of one case; the area's are relative to its area at the first instant.

    Parameters
    ----------
    predicted : mapping of str to array of shape (1, time, z)
        Any of flow, area and pressure.
    case : Cases
        The truth, a single case.

    Raises
    ------
    InputError
        If there is not exactly one case, or a shape is not that of the truth.
    """
    if len(case) != 1 or any(len(values) != 1 for values in predicted.values()):
        raise InputError(
            f"Pointwise errors are of one case, got {len(case)}. Select it: "
            "cases.select(geometry=…, waveform=…)."
        )
    distance = {
        name: np.abs(values - _truth(name, values, case))[0] for name, values in predicted.items()
    }
    if "area" in distance:
        distance["area"] = distance["area"] / case.area[0, :1]
    return PointwiseErrors(case, {name: v[0] for name, v in predicted.items()}, distance)


def relative_errors(predicted: Mapping[str, Array], cases: Cases) -> dict[str, Array]:
    """|Y − Y_GT|/|Y_GT| of every value, in one row for each variable.

    The area leaves out the first and last five points.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Any of flow, area and pressure.
    cases : Cases
        The truth.

    Raises
    ------
    InputError
        If a true value is zero, or a shape is not that of the truth.
    """
    errors = {}
    for name, values in predicted.items():
        truth = compared(name, _truth(name, values, cases))
        if not truth.all():
            raise InputError(f"The truth's {name} is 0 somewhere: no relative error there.")
        errors[name] = (np.abs(compared(name, values) - truth) / np.abs(truth)).ravel()
    return errors


def box_statistics(predicted: Mapping[str, Mapping[str, Array]], cases: Cases) -> pd.DataFrame:
    """Quartiles and outliers of the pointwise relative errors of several methods.

    Parameters
    ----------
    predicted : mapping of str to mapping of str to array of shape (case, time, z)
        By method, then by variable.
    cases : Cases
        The truth.

    Returns
    -------
    DataFrame
        Indexed by ``variable`` and ``method``: ``median``, ``lower`` and ``upper``
        quartile, ``low`` and ``high`` whisker (the outermost values within 1.5 quartile
        distances of the box), ``largest`` value and ``outliers``, the share of values
        beyond the whiskers.  NaN for a method that has NaN, as one that diverged.

    Raises
    ------
    InputError
        As :func:`relative_errors`.
    """
    rows = {}
    for method, arrays in predicted.items():
        for name, errors in relative_errors(arrays, cases).items():
            if np.isnan(errors).any():
                rows[name, method] = dict.fromkeys(_STATISTICS, np.nan)
                continue
            lower, median, upper = np.percentile(errors, [25, 50, 75])
            reach = _WHISKER * (upper - lower)
            inside = errors[(errors >= lower - reach) & (errors <= upper + reach)]
            outliers = 1 - inside.size / errors.size
            found = median, lower, upper, inside.min(), inside.max(), errors.max(), outliers
            rows[name, method] = dict(zip(_STATISTICS, found, strict=True))
    frame = pd.DataFrame.from_dict(rows, orient="index")
    frame.index = pd.MultiIndex.from_tuples(list(rows), names=["variable", "method"])
    return frame


def _truth(name: str, values: Array, cases: Cases) -> Array:
    """Return what a predicted variable should be, of the same shape."""
    truth: Array = getattr(cases, name)
    if values.shape != truth.shape:
        raise InputError(f"The predicted {name} has the shape {values.shape}, not {truth.shape}.")
    return truth
