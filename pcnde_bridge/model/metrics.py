"""Relative errors as the paper's table defines them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError

AREA_MARGIN = 5
"""Points left out at either end of the area: the walls are clamped there (section 3.3)."""

POOLED = "pooled"
"""Label of the row that pools all cases in :func:`error_table`."""


def relative_error(predicted: Array, truth: Array) -> float:
    """‖Y − Y_GT‖ / ‖Y_GT‖ over all numbers of an array (section 3.3).

    Raises
    ------
    InputError
        If the shapes differ or the truth is zero.
    """
    if predicted.shape != truth.shape:
        raise InputError(f"Cannot compare shape {predicted.shape} with shape {truth.shape}.")
    size = np.linalg.norm(truth.ravel())
    if size == 0:
        raise InputError("The relative error is undefined: the truth is zero everywhere.")
    return float(np.linalg.norm((predicted - truth).ravel()) / size)


def compared(variable: str, values: Array) -> Array:
    """Part of a variable (..., z) that its error counts: the area without its ends."""
    if variable == "area" and values.shape[-1] > 2 * AREA_MARGIN:
        return values[..., AREA_MARGIN:-AREA_MARGIN]
    return values


def pooled_errors(predicted: Mapping[str, Array], cases: Cases) -> dict[str, float]:
    """Relative error of each predicted variable over all cases, instants and points.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Any of flow, area and pressure.
    cases : Cases
        The truth.
    """
    return {
        variable: relative_error(
            compared(variable, values), compared(variable, getattr(cases, variable))
        )
        for variable, values in predicted.items()
    }


def error_table(predicted: Mapping[str, Array], cases: Cases) -> pd.DataFrame:
    """Relative errors of every case, and of all pooled.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Any of flow, area and pressure.
    cases : Cases
        The truth.

    Returns
    -------
    DataFrame
        Indexed by ``geometry`` and ``waveform``, with a column for each variable;
        the last row, labelled ``("pooled", "pooled")``, pools all cases.
    """
    together = pooled_errors(predicted, cases)
    rows = [
        {
            variable: relative_error(
                compared(variable, values[i]), compared(variable, getattr(cases, variable)[i])
            )
            for variable, values in predicted.items()
        }
        for i in range(len(cases))
    ]
    keys = list(cases.labels[["geometry", "waveform"]].itertuples(index=False, name=None))
    index = pd.MultiIndex.from_tuples([*keys, (POOLED, POOLED)], names=["geometry", "waveform"])
    return pd.DataFrame([*rows, together], index=index)


def pooled(table: pd.DataFrame) -> dict[str, float]:
    """Return the errors of all cases pooled from a table of :func:`error_table`.

    Parameters
    ----------
    table : DataFrame
        Its last row pools all cases.

    Returns
    -------
    dict
        By variable, as :func:`pooled_errors` gives them.
    """
    return {str(variable): float(error) for variable, error in table.iloc[-1].items()}


def coverage(intervals: Mapping[str, tuple[Array, Array]], cases: Cases) -> dict[str, float]:
    """Share of the true values that lie inside their intervals.

    Parameters
    ----------
    intervals : mapping of str to pair of arrays of shape (case, time, z)
        Lower and upper limits, as :meth:`pcnde_bridge.Prediction.interval` returns.
    cases : Cases
        The truth.
    """
    return {
        name: float(((low <= getattr(cases, name)) & (getattr(cases, name) <= high)).mean())
        for name, (low, high) in intervals.items()
    }
