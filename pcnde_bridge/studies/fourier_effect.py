"""Effect of the Fourier stage on the area (section 3.4 of the paper)."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.config import resolve_pcnde_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.model.metrics import compared, relative_error
from pcnde_bridge.model.pcnde import PCNDE


@dataclass(frozen=True, eq=False, repr=False)
class FourierEffect(Displayed):
    """Area before and after the Fourier stage.

    Attributes
    ----------
    cases : Cases
        The truth.
    intermediate : array of shape (case, time, z)
        Ŝ in the last cycle, cm², from the continuity equation with its trained terms.
    final : array of shape (case, time, z)
        S, cm², after the Fourier stage.
    drift : array of shape (case, z)
        Change of Ŝ over one cycle, cm²: its deviation from periodicity.  S has none.
    """

    cases: Cases
    intermediate: Array
    final: Array
    drift: Array

    def to_frame(self) -> pd.DataFrame:
        """Return scalar measures, a row for each of the two areas.

        Returns
        -------
        DataFrame
            ``error`` is the relative error of the area; ``drift`` the largest change
            over a cycle, relative to the undeformed area (0 is periodic); ``closer`` the
            fraction of all values at which this area is the closer one to the truth.
            The first and last five points are excluded.
        """
        truth = compared("area", self.cases.area)
        intermediate, final = compared("area", self.intermediate), compared("area", self.final)
        closer = float(np.mean(np.abs(final - truth) < np.abs(intermediate - truth)))
        drift = np.abs(compared("area", self.drift / self.cases.area_undeformed)).max()
        rows = {
            "intermediate": [relative_error(intermediate, truth), float(drift), 1 - closer],
            "final": [relative_error(final, truth), 0.0, closer],
        }
        columns = ["error", "drift", "closer"]
        return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("area")


def fourier_effect(model: PCNDE, cases: Cases) -> FourierEffect:
    """Predict the area with and without the Fourier stage, from the same final flow.

    Parameters
    ----------
    model : PCNDE
        Model with the paper's stages (any preset but ``physics``).
    cases : Cases
        Cases to predict.

    Raises
    ------
    InputError
        If the model has no Fourier stage, or the cases are not on the model's grid.
    """
    config = resolve_pcnde_config(model.config)
    predicted = model.predict(cases)
    # At least two cycles: the drift is the difference of Ŝ between two of them.
    cycles = max(2, config.intermediate_area.cycles)
    intermediate = model.engine.intermediate_area.solve(
        dict(model.parameters)["intermediate_area"],
        (predicted.flow, cases.area_undeformed),
        cases.grid,
        config.replace(intermediate_area={"cycles": cycles}),
    )
    n_times, last = cases.n_times, config.intermediate_area.cycles * cases.n_times
    drift = intermediate[:, -1] - intermediate[:, -1 - n_times]
    return FourierEffect(cases, intermediate[:, last - n_times : last], predicted.area, drift)
