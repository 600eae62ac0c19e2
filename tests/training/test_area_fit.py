"""Fit of the area stages."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import LITTLE, julia_or_skip, loss_and_gradient_of

from pcnde_bridge.engines.types import FitData
from pcnde_bridge.training.area_fit import fit_area_stage


def area_gradients(engine, cases, grid, config):
    """Gradients of both area stages at their fit and at a = 1, b = 0, and the fits."""
    inputs = cases.flow, cases.area_undeformed
    found = fit_area_stage(engine.intermediate_area, FitData(inputs, cases.area, grid, config))
    first, loss = found.parameters, found.losses[-1]
    whole = engine.intermediate_area.solve(first, inputs, grid, config)
    fourier = cases.flow, whole[:, -1]
    found = fit_area_stage(engine.fourier_area, FitData(fourier, cases.area, grid, config))
    second, fourier_loss = found.parameters, found.losses[-1]
    start = np.repeat([1.0, 0.0], cases.n_points)
    for stage, arrays, vector, least in (
        (engine.intermediate_area, inputs, first, loss),
        (engine.fourier_area, fourier, second, fourier_loss),
    ):
        found, at_fit = loss_and_gradient_of(stage, vector, arrays, cases.area, grid, config)
        _, before = loss_and_gradient_of(stage, start, arrays, cases.area, grid, config)
        assert found == pytest.approx(least, rel=1e-9)
        yield np.abs(at_fit).max() / np.abs(before).max(), vector


def test_the_area_stages_are_at_their_minimum(engine, small_cases, grid):
    for ratio, _ in area_gradients(engine, small_cases, grid, LITTLE):
        assert ratio < 1e-9


@pytest.mark.julia
def test_the_area_stages_are_the_same_with_both_engines(engine, small_cases, grid):
    theirs = area_gradients(julia_or_skip(), small_cases, grid, LITTLE)
    ours = area_gradients(engine, small_cases, grid, LITTLE)
    for (_, mine), (ratio, other) in zip(ours, theirs, strict=True):
        assert ratio < 1e-9
        assert np.allclose(mine, other, rtol=1e-8, atol=1e-10)
