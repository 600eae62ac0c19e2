"""A prediction near the truth."""

from __future__ import annotations

import pytest

from pcnde_bridge.model.prediction import Prediction


@pytest.fixture(scope="module")
def predicted(small_cases):
    """Variables near the truth, but different from it."""
    return {
        "flow": small_cases.flow * 1.01,
        "area": small_cases.area * 0.99,
        "pressure": small_cases.pressure + 2e3,
    }


@pytest.fixture(scope="module")
def prediction(small_cases, predicted):
    return Prediction(
        **predicted,
        area_undeformed=small_cases.area_undeformed,
        time=small_cases.time,
        z=small_cases.z,
        period=1.0,
        labels=small_cases.labels,
    )
