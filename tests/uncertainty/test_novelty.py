"""Distance of inputs from the training data."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import (
    AREA,
    INFLOW,
    Z,
    waveforms,
)

from pcnde_bridge.uncertainty.novelty import Novelty


def test_score_does_not_depend_on_the_grid():
    novelty = Novelty.fit(INFLOW, AREA, Z)
    time = np.arange(100) / 100
    fine = np.linspace(0, 4, 401)
    wave = 1.4 * waveforms(time)[[1, 3]]
    area = np.array([np.interp(fine, Z, s) for s in AREA[[0, 15]]])
    of_inflow, of_area = novelty.score(wave, area, fine + 5)
    expected, _ = novelty.score(1.4 * waveforms()[[1, 3]], AREA[[0, 15]], Z)
    assert of_inflow == pytest.approx(expected, rel=1e-9)
    # Profiles are interpolated linearly in the radius, here in the area.
    assert of_area.max() == pytest.approx(1.0, abs=0.02)


def test_score_ignores_unresolved_harmonics():
    factors, area = np.array([[0.5], [1.0], [1.75]]), AREA[:3]

    def family(count, highest):
        phase = 2 * np.pi * np.arange(count) / count
        ripple = sum(0.02 * np.cos(k * phase) for k in range(7, highest + 1))
        return factors * (1 + 0.5 * np.cos(phase) + ripple)

    novelty = Novelty.fit(family(100, 12), area, Z)
    assert novelty.score(family(100, 12), area, Z)[0].max() == pytest.approx(1.0)
    # 16 time points resolve the harmonics below the eighth.
    assert novelty.score(family(16, 7), area, Z)[0].max() == pytest.approx(1.0, abs=0.02)
    assert novelty.score(1.2 * family(16, 7), area, Z)[0].max() > 1.4


def test_single_training_case_has_an_inside():
    novelty = Novelty.fit(INFLOW[:1], AREA[:1], Z)
    assert np.concatenate(novelty.score(INFLOW[:1], AREA[:1], Z)).max() < 1e-9
    assert novelty.score(1.1 * INFLOW[:1], AREA[:1], Z)[0][0] > 1
