"""Pressure drops: positions, formula and errors by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import InputError
from pcnde_bridge.hemodynamics import pressure_losses as stenosis
from pcnde_bridge.model.metrics import (
    relative_error,
)
from pcnde_bridge.studies import (
    pressure_drops,
)

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")


def test_pressure_drops_by_hand(small_cases, predicted):
    drops = pressure_drops(predicted["pressure"], small_cases)
    # z = 0, 0.2, … 4: the points nearest to 4/3 and 8/3 are 1.4 and 2.6.
    first, second = 7, 13
    np.testing.assert_array_equal(
        drops.predicted, predicted["pressure"][:, :, first] - predicted["pressure"][:, :, second]
    )
    truth = small_cases.pressure[:, :, first] - small_cases.pressure[:, :, second]
    np.testing.assert_array_equal(drops.truth, truth)
    throat = small_cases.area_undeformed[5].argmin()
    formula = stenosis.pressure_drop(
        small_cases.flow[5, 4, throat],
        small_cases.area_undeformed[5, 0],
        small_cases.area_undeformed[5].min(),
        0.5,
    )
    assert drops.empirical[5, 4] == pytest.approx(formula)

    frame = drops.to_frame()
    assert len(frame) == 13
    assert frame.loc[("pooled", "pooled"), "empirical"] == relative_error(drops.empirical, truth)
    assert frame.loc[(2, 1), "model"] == relative_error(drops.predicted[5], truth[5])
    above = (drops.empirical > truth).mean()
    assert frame.loc[("pooled", "pooled"), "overestimated"] == above


def test_pressure_drops_need_the_cases_pressure(small_cases, predicted):
    with pytest.raises(InputError, match=r"shape is \(11, 20, 21\)"):
        pressure_drops(predicted["pressure"][1:], small_cases)
