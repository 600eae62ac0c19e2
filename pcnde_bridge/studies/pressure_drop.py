"""Pressure drop along the stenosis, beside the formula of Seeley and Young (section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge.config import Physics
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics import pressure_losses as stenosis
from pcnde_bridge.model.metrics import POOLED, relative_error

_PHYSICS = Physics()


@dataclass(frozen=True, eq=False)
class PressureDrops:
    """Pressure drops over the middle third of the vessel.

    Attributes
    ----------
    cases : Cases
        The truth.
    truth, predicted, empirical : array of shape (case, time)
        p(L/3) − p(2L/3) of the cases and of the model, and Δp of Seeley and Young,
        dyn/cm².
    """

    cases: Cases = field(repr=False)
    truth: Array = field(repr=False)
    predicted: Array = field(repr=False)
    empirical: Array = field(repr=False)

    def to_frame(self) -> pd.DataFrame:
        """Relative errors of the drop, a row for each case and one for all pooled.

        Returns
        -------
        DataFrame
            Indexed by ``geometry`` and ``waveform``; columns ``model`` and
            ``empirical``, and ``overestimated``: the share of instants at which the
            formula gives more than the truth.
        """
        labels = self.cases.labels[["geometry", "waveform"]]
        keys = list(labels.itertuples(index=False, name=None))
        which = [*(slice(i, i + 1) for i in range(len(keys))), slice(None)]
        rows = [
            {
                "model": relative_error(self.predicted[part], self.truth[part]),
                "empirical": relative_error(self.empirical[part], self.truth[part]),
                "overestimated": float(np.mean(self.empirical[part] > self.truth[part])),
            }
            for part in which
        ]
        names = ["geometry", "waveform"]
        index = pd.MultiIndex.from_tuples([*keys, (POOLED, POOLED)], names=names)
        return pd.DataFrame(rows, index=index)


def pressure_drops(pressure: Array, cases: Cases, physics: Physics = _PHYSICS) -> PressureDrops:
    """Compare the pressure drop of a prediction with the formula's.

    The drop is taken from the point nearest to L/3 to the one nearest to 2L/3, between
    which the paper's pressure model drops.  The formula gets the cases' own flow at the
    throat, which is where S_u is smallest, and the undeformed areas.

    Parameters
    ----------
    pressure : array of shape (case, time, z)
        Predicted p, dyn/cm².
    cases : Cases
        The truth.
    physics : Physics
        Of blood and stenosis: ``model.config.physics``.

    Raises
    ------
    InputError
        If the pressure is not that of the cases.
    """
    if np.shape(pressure) != cases.pressure.shape:
        raise InputError(
            f"The pressure has the shape {np.shape(pressure)}, that of the cases is "
            f"{cases.pressure.shape}."
        )
    start, length = cases.z[0], cases.z[-1] - cases.z[0]
    first, second = (
        int(np.abs(cases.z - start - part * length).argmin()) for part in (1 / 3, 2 / 3)
    )
    throat = cases.area_undeformed.argmin(axis=1)
    empirical: Array = stenosis.pressure_drop(
        cases.flow[np.arange(len(cases)), :, throat],
        cases.area_undeformed[:, :1],
        cases.area_undeformed.min(axis=1)[:, None],
        physics.stenosis_length,
        density=physics.density,
        viscosity=physics.viscosity,
        turbulent_coefficient=physics.turbulent_coefficient,
    )
    truth, predicted = (p[:, :, first] - p[:, :, second] for p in (cases.pressure, pressure))
    return PressureDrops(cases, truth, predicted, empirical)
