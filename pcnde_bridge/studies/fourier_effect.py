"""What the Fourier stage does to the area (section 3.4 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.types import IntermediateAreaInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import compared, relative_error
from pcnde_bridge.model.pcnde import PCNDE


@dataclass(frozen=True, eq=False)
class FourierEffect:
    """Area before and after the Fourier stage.

    Attributes
    ----------
    cases : Cases
        The truth.
    intermediate : array of shape (case, time, z)
        Ŝ of the last cycle, cm², of the continuity equation with its learnt terms.
    final : array of shape (case, time, z)
        S, cm², after the Fourier stage.
    drift : array of shape (case, z)
        Ŝ less Ŝ one cycle before, cm²: what it misses of being periodic.  S has none.
    """

    cases: Cases = field(repr=False)
    intermediate: Array = field(repr=False)
    final: Array = field(repr=False)
    drift: Array = field(repr=False)

    def to_frame(self) -> pd.DataFrame:
        """Scalar measures, a row for each of the two areas.

        Returns
        -------
        DataFrame
            ``error``, the relative error of the area; ``drift``, the largest change
            over a cycle relative to the area (0 is periodic); ``closer``, the share of
            all values that are the closer ones of the two.  The first and last five
            points are left out.
        """
        truth = compared("area", self.cases.area)
        areas = {"intermediate": self.intermediate, "final": self.final}
        inner = {name: compared("area", area) for name, area in areas.items()}
        distance = {name: np.abs(area - truth) for name, area in inner.items()}
        share = float(np.mean(distance["final"] < distance["intermediate"]))
        relative = np.abs(compared("area", self.drift / self.cases.area_undeformed)).max()
        return pd.DataFrame(
            {
                "error": {name: relative_error(area, truth) for name, area in inner.items()},
                "drift": {"intermediate": float(relative), "final": 0.0},
                "closer": {"intermediate": 1 - share, "final": share},
            }
        ).rename_axis("area")


def fourier_effect(model: PCNDE, cases: Cases) -> FourierEffect:
    """Predict the area with and without the Fourier stage.

    Both come from the flow of the last coupling pass.

    Parameters
    ----------
    model : PCNDE
        A model with the paper's stages (any preset but ``physics``).
    cases : Cases
        Cases to predict.

    Raises
    ------
    InputError
        If the model has no Fourier stage, or the cases' grid is not the model's.
    """
    if not isinstance(model.config, PCNDEConfig) or not isinstance(model.parameters, Parameters):
        raise InputError(
            "A model of the preset physics has no Fourier stage. Give a model of the preset "
            "paper or fast."
        )
    predicted = model.predict(cases)
    # Two cycles at least: Ŝ at an instant less Ŝ a cycle before is the drift.
    cycles = max(2, model.config.intermediate_area.cycles)
    intermediate = model.engine.intermediate_area.solve(
        model.parameters.intermediate_area,
        IntermediateAreaInputs(predicted.flow, cases.area_undeformed),
        cases.grid,
        model.config.replace(intermediate_area={"cycles": cycles}),
    )
    n_times, last = cases.n_times, model.config.intermediate_area.cycles * cases.n_times
    drift = intermediate[:, -1] - intermediate[:, -1 - n_times]
    return FourierEffect(cases, intermediate[:, last - n_times : last], predicted.area, drift)
