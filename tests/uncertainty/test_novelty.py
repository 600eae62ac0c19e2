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

from pcnde_bridge.data.grid import Grid
from pcnde_bridge.uncertainty.novelty import EDGE, QUANTITIES, Novelty

GRID = Grid(np.arange(32) / 32, Z, 1.0)


def scores(novelty, inflow, area, grid=GRID):
    found = novelty.score(inflow, area, grid) | novelty.score_shapes(inflow, area, grid.z)
    return {name: float(values[0]) for name, values in found.items()}


def changed(novelty, inflow=INFLOW[:1], area=AREA[:1], grid=GRID):
    """Return the scores above 1, without those of the shapes."""
    found = {name: score[0] for name, score in novelty.score(inflow, area, grid).items()}
    return {name: score for name, score in found.items() if score > EDGE}


def test_score_does_not_depend_on_the_grid():
    novelty = Novelty.fit(INFLOW, AREA, GRID)
    time = np.arange(100) / 100
    fine = np.linspace(0, 4, 401)
    wave = 1.4 * waveforms(time)[[3]]
    area = np.array([np.interp(fine, Z, AREA[15])])
    found = scores(novelty, wave, area, Grid(time, fine + 5, 1.0))
    expected = scores(novelty, 1.4 * waveforms()[[3]], AREA[[15]])
    for name, score in expected.items():
        # Profiles are interpolated linearly in the radius, here in the area.
        assert found[name] == pytest.approx(score, abs=0.02), name
    for name in ("mean flow", "amplitude", "frequency", "shape of the inflow"):
        assert found[name] == pytest.approx(expected[name], rel=1e-9), name


def test_each_change_is_named():
    novelty = Novelty.fit(INFLOW, AREA, GRID)
    inflow, area = INFLOW[15:], AREA[15:]
    mean = inflow.mean()
    assert changed(novelty, inflow, area) == {}
    stronger = mean + 1.5 * (inflow - mean)
    assert list(changed(novelty, stronger, area)) == ["amplitude"]
    assert list(changed(novelty, inflow + mean, area)) == ["mean flow"]
    assert list(changed(novelty, inflow, 0.5 * area)) == ["area"]
    narrower = area * np.where(area < 0.9 * area.max(), 0.7, 1.0)
    assert "blockage" in changed(novelty, inflow, narrower)
    assert list(changed(novelty, inflow, area, Grid(0.8 * GRID.time, Z, 0.8))) == ["frequency"]
    wider = np.where(np.arange(Z.size) < 4, 2 * area, area)
    assert list(changed(novelty, inflow, wider)) == ["widening"]
    doubled = np.minimum(area, np.roll(area, 10, axis=1))
    assert list(changed(novelty, inflow, doubled)) == ["length of the stenosis"]
    longer = Grid(GRID.time, 1.5 * Z, 1.0)
    lengths = ["length of the vessel", "length of the stenosis"]
    assert list(changed(novelty, inflow, area, longer)) == lengths


def test_shifts_in_time_and_moved_stenoses_change_the_shapes_only():
    novelty = Novelty.fit(INFLOW, AREA, GRID)
    before = scores(novelty, INFLOW[15:], AREA[15:])
    shifted = scores(novelty, np.roll(INFLOW[15:], 11, axis=1), AREA[15:])
    moved = scores(novelty, INFLOW[15:], np.roll(AREA[15:], 10, axis=1))
    for name in QUANTITIES:
        assert shifted[name] == pytest.approx(before[name], rel=1e-9), name
        assert moved[name] == pytest.approx(before[name], rel=1e-9), name
    assert shifted["shape of the inflow"] > 2 > before["shape of the inflow"]
    assert moved["shape of the vessel"] > 2 > before["shape of the vessel"]


def test_ranges_reach_as_far_as_left_out_cases_have_tested():
    amplitude = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    wave = np.sqrt(2) * np.cos(2 * np.pi * GRID.time)
    inflow, area = 1 + amplitude[:, None] * wave, np.repeat(AREA[:1], 5, axis=0)
    left_out = [np.array([0]), np.array([1, 2]), np.array([3, 4])]
    tested = Novelty.fit(inflow, area, GRID, left_out)
    # From 0.1 − 0.1 to 0.5 + 0.2: the highest fold lay 0.2 above the others.
    assert tested.ranges[:, 1] == pytest.approx([0.35, 0.35])
    assert Novelty.fit(inflow, area, GRID).ranges[:, 1] == pytest.approx([0.3, 0.2])
    assert list(changed(tested, 1 + 0.72 * wave[None], area[:1])) == ["amplitude"]
    assert changed(tested, 1 + 0.68 * wave[None], area[:1]) == {}


def test_steady_and_straight_cases_have_neither_frequency_nor_stenosis():
    novelty = Novelty.fit(INFLOW, AREA, GRID)
    steady, straight = np.full((1, 32), INFLOW.mean()), np.full((1, Z.size), AREA.max())
    found = scores(novelty, steady, straight)
    assert (found["frequency"], found["length of the stenosis"]) == (0, 0)
    only = Novelty.fit(steady, straight, GRID)
    assert np.isfinite(only.ranges).all()
    pulsatile = INFLOW[15:] - INFLOW[15].mean() + INFLOW.mean()
    assert list(changed(only, pulsatile, straight)) == ["amplitude"]
    assert list(changed(only, steady, AREA[15:])) == ["blockage"]


def test_score_ignores_unresolved_harmonics():
    factors, area = np.array([[0.5], [1.0], [1.75]]), AREA[:3]

    def family(count, highest):
        phase = 2 * np.pi * np.arange(count) / count
        ripple = sum(0.02 * np.cos(k * phase) for k in range(7, highest + 1))
        return factors * (1 + 0.5 * np.cos(phase) + ripple)

    def score(inflow):
        return novelty.score_shapes(inflow, area, Z)["shape of the inflow"].max()

    novelty = Novelty.fit(family(100, 12), area, GRID)
    assert score(family(100, 12)) == pytest.approx(1.0)
    # 16 time points resolve the harmonics below the eighth.
    assert score(family(16, 7)) == pytest.approx(1.0, abs=0.02)
    assert score(1.2 * family(16, 7)) > 1.4


def test_single_training_case_has_an_inside():
    novelty = Novelty.fit(INFLOW[:1], AREA[:1], GRID)
    assert max(scores(novelty, INFLOW[:1], AREA[:1]).values()) < 1e-9
    assert scores(novelty, 1.1 * INFLOW[:1], AREA[:1])["shape of the inflow"] > 1
    assert list(changed(novelty, 1.2 * INFLOW[:1])) == ["mean flow"]
