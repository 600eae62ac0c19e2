"""Fits of the pressure network and of the spatial pressure."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers import LITTLE, loss_and_gradient_of

from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.types import FitData
from pcnde_bridge.training.pressure_fit import SpatialPressureFit, TemporalPressureFit


@pytest.mark.parametrize("activation", ["tanh", "gelu", "sigmoid", "swish"])  # relu starts dead
def test_the_pressure_networks_last_layer_is_at_its_minimum(engine, small_cases, grid, activation):
    config = LITTLE.replace(
        temporal_pressure={"activation": activation, "hidden": (3, 2)},
        full_batch={"pressure_weight_decay": 0.0},
    )
    inputs = small_cases.flow, small_cases.area, small_cases.area_undeformed
    outlet = small_cases.pressure[..., -1:]  # a larger drop, so that the ridge is small beside it
    target = (outlet + 10 * (small_cases.pressure - outlet)) / config.physics.reference_pressure
    start = initial_parameters(config, 20, 21, 0).temporal_pressure
    losses = []
    fit = TemporalPressureFit(FitData(inputs, target, grid, config)).fit
    vector = fit(start, lambda _, loss: losses.append(loss)).parameters
    stage = engine.temporal_pressure
    loss, gradient = loss_and_gradient_of(stage, vector, inputs, target, grid, config)
    first, before = loss_and_gradient_of(stage, start, inputs, target, grid, config)
    assert loss < 0.1 * first
    assert all(later <= earlier for earlier, later in pairwise(losses))
    assert losses[-1] == pytest.approx(loss, rel=0.05)  # but for the ridge
    last = 3 * small_cases.n_points
    assert np.abs(gradient[-last:]).max() < 1e-4 * np.abs(before[-last:]).max()


@pytest.mark.parametrize("form", ["continuous", "printed"])
def test_the_spatial_pressure_is_at_its_minimum(engine, small_cases, grid, form):
    config = LITTLE.replace(
        spatial_pressure={"form": form}, full_batch={"pressure_iterations": 200}
    )
    target = small_cases.pressure / config.physics.reference_pressure
    inputs = target, small_cases.flow, small_cases.area_undeformed
    start = initial_parameters(config, 20, 21, 0).spatial_pressure
    losses = []
    fit = SpatialPressureFit(FitData(inputs, target, grid, config)).fit
    vector = fit(start, lambda _, loss: losses.append(loss)).parameters
    stage = engine.spatial_pressure
    loss, gradient = loss_and_gradient_of(stage, vector, inputs, target, grid, config)
    first, before = loss_and_gradient_of(stage, start, inputs, target, grid, config)
    assert loss < first
    assert losses[-1] == pytest.approx(loss, rel=1e-6)
    assert np.abs(gradient[:22]).max() < 1e-8 * np.abs(before).max()  # a₁, a₂, b₁
    assert np.abs(gradient[22:]).max() < 1e-4 * np.abs(before).max()  # b₂
