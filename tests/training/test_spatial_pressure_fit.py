"""Fit of the spatial pressure."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import LITTLE, loss_and_gradient_of

from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.types import (
    SpatialPressureInputs,
)
from pcnde_bridge.training.spatial_pressure_fit import SpatialPressureFit


@pytest.mark.parametrize("form", ["continuous", "printed"])
def test_the_spatial_pressure_is_at_its_minimum(engine, small_cases, grid, form):
    config = LITTLE.replace(
        spatial_pressure={"form": form}, full_batch={"pressure_iterations": 200}
    )
    target = small_cases.pressure / config.physics.reference_pressure
    inputs = SpatialPressureInputs(target, small_cases.flow, small_cases.area_undeformed)
    start = initial_parameters(config, 20, 21, 0).spatial_pressure
    losses = []
    fit = SpatialPressureFit(inputs, target, grid.z, config).fit
    vector = fit(start, engine.lbfgs, lambda _, loss: losses.append(loss)).parameters
    stage = engine.spatial_pressure
    loss, gradient = loss_and_gradient_of(stage, vector, inputs, target, grid, config)
    first, before = loss_and_gradient_of(stage, start, inputs, target, grid, config)
    assert loss < first
    assert losses[-1] == pytest.approx(loss, rel=1e-6)
    assert np.abs(gradient[:22]).max() < 1e-8 * np.abs(before).max()  # a₁, a₂, b₁
    assert np.abs(gradient[22:]).max() < 1e-4 * np.abs(before).max()  # b₂
