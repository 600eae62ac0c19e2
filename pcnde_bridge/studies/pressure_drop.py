"""Pressure drop along the stenosis, compared with Seeley and Young (section 3.2)."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.config.settings import Physics
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.stenosis import check_length
from pcnde_bridge.hemodynamics import pressure_losses
from pcnde_bridge.model.metrics import case_table, reference_of, relative_error

_PHYSICS = Physics()


@dataclass(frozen=True, eq=False, repr=False)
class PressureDrops(Displayed):
    """Pressure drops over the middle third of the vessel.

    Attributes
    ----------
    cases : Cases
        The truth.
    truth, predicted, empirical : array of shape (case, time)
        p(L/3) − p(2L/3) of the cases and of the model, and Δp of Seeley and Young,
        dyn/cm².
    """

    cases: Cases
    truth: Array
    predicted: Array
    empirical: Array

    def to_frame(self) -> pd.DataFrame:
        """Return relative errors of the drop, a row for each case and one for all pooled.

        Returns
        -------
        DataFrame
            Indexed by ``geometry`` and ``waveform``; columns ``model`` and
            ``empirical``, and ``overestimated``: the fraction of time points at which the
            formula gives more than the truth.
        """
        return case_table(
            lambda s: {
                "model": relative_error(self.predicted[s], self.truth[s]),
                "empirical": relative_error(self.empirical[s], self.truth[s]),
                "overestimated": np.mean(self.empirical[s] > self.truth[s]),
            },
            self.cases,
        )


def pressure_drops(pressure: Array, cases: Cases, physics: Physics = _PHYSICS) -> PressureDrops:
    """Compare the predicted pressure drop with the empirical formula.

    The drop is taken between the grid points nearest to L/3 and 2L/3, between which the
    paper's pressure model drops.  The formula uses the true flow at the throat, which is
    the point with the smallest S_u, and the undeformed areas.

    Parameters
    ----------
    pressure : array of shape (case, time, z)
        Predicted p, dyn/cm².
    cases : Cases
        The truth.
    physics : Physics
        Blood and stenosis: ``model.config.physics``, with the ``stenosis_length`` of the cases.

    Raises
    ------
    InputError
        If the pressure has another shape than the cases.
    """
    reference_of("pressure", pressure, cases)
    check_length(cases.z, cases.area_undeformed, physics.stenosis_length)
    start, length = cases.z[0], cases.z[-1] - cases.z[0]
    first, second = (
        int(np.abs(cases.z - start - fraction * length).argmin()) for fraction in (1 / 3, 2 / 3)
    )
    throat = cases.area_undeformed.argmin(axis=1)
    flow, healthy = cases.flow[np.arange(len(cases)), :, throat], cases.area_undeformed[:, :1]
    narrowest = cases.area_undeformed.min(axis=1)[:, None]
    blood = physics.density, physics.viscosity, physics.turbulent_coefficient
    vessel = healthy, narrowest, physics.stenosis_length
    empirical: Array = pressure_losses.pressure_drop(flow, *vessel, *blood)
    truth, predicted = (p[:, :, first] - p[:, :, second] for p in (cases.pressure, pressure))
    return PressureDrops(cases, truth, predicted, empirical)
