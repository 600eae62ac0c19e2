from __future__ import annotations

import numpy as np
import pytest
from io_helpers import results_of

from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import VesselResults
from pcnde_bridge.model.prediction import Prediction


@pytest.fixture(scope="session")
def vessel(small_cases) -> VesselResults:
    """Results of one vessel: one cycle without its end point."""
    return results_of(small_cases, 6)


@pytest.fixture(scope="session")
def sheared_vessel(sheared_cases) -> VesselResults:
    """The same vessel with a wall shear stress."""
    return results_of(sheared_cases, 6)


@pytest.fixture
def prediction(small_cases) -> Prediction:
    chosen = small_cases.select([0, 6, 11])
    return Prediction(
        *(np.array(getattr(chosen, name)) for name in (*VARIABLES, "area_undeformed", "time", "z")),
        period=1.0,
        labels=chosen.labels,
        novelty=np.array([0.1, 0.2, 0.3]),
    )
