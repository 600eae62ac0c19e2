"""Detailed errors: per case, per grid point, and their distribution (section 3.3)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import POOLED, compared, error_table, reference_of
from pcnde_bridge.studies._shared import check_single

_WHISKER = 1.5  # interquartile ranges
_STATISTICS = ("median", "lower", "upper", "low", "high", "largest", "outliers")


def error_matrix(predicted: Mapping[str, Array], cases: Cases) -> dict[str, pd.DataFrame]:
    """Return the relative error of every case, geometries down and waveforms across.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Any of the variables.
    cases : Cases
        The truth.

    Returns
    -------
    dict of str to DataFrame
        For each variable, indexed by ``geometry``, with a column for each ``waveform``,
        both in increasing order; NaN where there is no such case.  Its ``attrs`` hold the
        ``blockage`` of each geometry.
    """
    table = error_table(predicted, cases).drop(index=(POOLED, POOLED))
    matrices = {
        str(name): table[name].unstack("waveform").sort_index().sort_index(axis=1)
        for name in predicted
        if name in table
    }
    blockage = cases.labels.groupby("geometry")["blockage"].first().to_dict()
    for matrix in matrices.values():
        matrix.attrs["blockage"] = blockage
    return matrices


@dataclass(frozen=True, eq=False, repr=False)
class PointwiseErrors(Displayed):
    """Truth, prediction and absolute error of one case at every time and grid point.

    Attributes
    ----------
    case : Cases
        The truth, a single case.
    predicted : mapping of str to array of shape (time, z)
        Flow (mL/s), area (cm²), pressure and wall shear stress (dyn/cm²).
    distance : mapping of str to array of shape (time, z)
        |S − S_GT|/S_GT(t=0) for area, |Y − Y_GT| for the others, such as flow (mL/s).
    """

    case: Cases
    predicted: Mapping[str, Array]
    distance: Mapping[str, Array]

    def to_frame(self) -> pd.DataFrame:
        """Return scalar measures, a row for each variable.

        Returns
        -------
        DataFrame
            ``mean`` and ``largest`` error, and the means ``upstream`` and ``downstream``
            of the middle of the vessel.
        """
        z = self.case.z
        middle = (z[0] + z[-1]) / 2
        rows = {
            name: (v.mean(), v.max(), v[:, z < middle].mean(), v[:, z > middle].mean())
            for name, v in self.distance.items()
        }
        columns = ["mean", "largest", "upstream", "downstream"]
        return pd.DataFrame.from_dict(rows, "index", columns=columns).rename_axis("variable")


def pointwise_errors(predicted: Mapping[str, Array], case: Cases) -> PointwiseErrors:
    """Return the absolute errors of one case; the area's are relative to its initial area.

    Parameters
    ----------
    predicted : mapping of str to array of shape (1, time, z)
        Any of the variables.
    case : Cases
        The truth, a single case.

    Raises
    ------
    InputError
        If there is not exactly one case, or a shape differs from that of the truth.
    """
    check_single(case, "Pointwise errors need")
    distance = {
        name: np.abs(values - reference_of(name, values, case))[0]
        for name, values in predicted.items()
    }
    if "area" in distance:
        distance["area"] = distance["area"] / case.area[0, :1]
    return PointwiseErrors(case, {name: v[0] for name, v in predicted.items()}, distance)


def box_statistics(predicted: Mapping[str, Mapping[str, Array]], cases: Cases) -> pd.DataFrame:
    """Return quartiles and outliers of the pointwise relative errors of several methods.

    The errors are |Y − Y_GT|/|Y_GT| of every value, for the area without the first and last
    five points.

    Parameters
    ----------
    predicted : mapping of str to mapping of str to array of shape (case, time, z)
        For each method, any of the variables.
    cases : Cases
        The truth.

    Returns
    -------
    DataFrame
        Indexed by ``variable`` and ``method``: ``median``, ``lower`` and ``upper``
        quartile, ``low`` and ``high`` whisker (the outermost values within 1.5
        interquartile ranges of the box), ``largest`` value and ``outliers``, the fraction
        of values beyond the whiskers.  NaN for a method with NaN, such as one that
        diverged.

    Raises
    ------
    InputError
        If a true value is zero, or a shape differs from that of the truth.
    """
    rows = {}
    for method, arrays in predicted.items():
        for name, values in arrays.items():
            truth = compared(name, reference_of(name, values, cases))
            if not truth.all():
                raise InputError(f"The true {name} is 0 somewhere: it has no relative error.")
            errors = (np.abs(compared(name, values) - truth) / np.abs(truth)).ravel()
            if np.isnan(errors).any():
                rows[name, method] = (np.nan,) * len(_STATISTICS)
                continue
            lower, median, upper = np.percentile(errors, [25, 50, 75])
            reach = _WHISKER * (upper - lower)
            inside = errors[(errors >= lower - reach) & (errors <= upper + reach)]
            outliers = 1 - inside.size / errors.size
            found = median, lower, upper, inside.min(), inside.max(), errors.max(), outliers
            rows[name, method] = found
    return pd.DataFrame(rows, index=_STATISTICS).T.rename_axis(["variable", "method"])
