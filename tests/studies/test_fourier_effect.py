"""Effect of the Fourier stage: drift and areas follow from the equations."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge.model.metrics import (
    AREA_MARGIN,
    relative_error,
)
from pcnde_bridge.studies import (
    fourier_effect,
)

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")


def test_fourier_effect_on_the_equations(small_model, small_cases):
    cases = small_cases
    effect = fourier_effect(small_model, cases)
    prediction = small_model.predict(cases)
    np.testing.assert_array_equal(effect.final, prediction.area)
    # The drift is that of the continuity equation: period times its mean right-hand side.
    a, b = np.split(small_model.parameters.intermediate_area, 2)
    slope = np.gradient(prediction.flow, cases.z, axis=2).mean(axis=1)
    inner = slice(1, -1)
    expected = (cases.period * (b - a * slope))[:, inner]
    np.testing.assert_allclose(effect.drift[:, inner], expected, rtol=1e-6, atol=1e-12)
    # Ŝ starts from S_u: two drifts before the last of its three cycles.
    before = effect.intermediate[:, 0] - 2 * effect.drift
    np.testing.assert_allclose(before, cases.area_undeformed, rtol=1e-9)

    frame = effect.to_frame()
    whole = slice(AREA_MARGIN, -AREA_MARGIN)
    truth = cases.area[:, :, whole]
    for name, area in (("intermediate", effect.intermediate), ("final", effect.final)):
        assert frame.loc[name, "error"] == relative_error(area[:, :, whole], truth)
    near = np.abs(effect.final - cases.area) < np.abs(effect.intermediate - cases.area)
    assert frame.loc["final", "closer"] == pytest.approx(near[:, :, whole].mean())
    drift = np.abs(effect.drift / cases.area_undeformed)[:, whole].max()
    assert frame.loc["intermediate", "drift"] == pytest.approx(drift)
    assert frame.loc["final", "drift"] == 0
