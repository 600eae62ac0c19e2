"""Collocation of the flow network on the reference flow."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers import LITTLE, loss_and_gradient_of

from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import FitData
from pcnde_bridge.training.collocation import Collocation
from pcnde_bridge.training.flow_fit import amplitude_weight
from pcnde_bridge.training.whitening import Whitening


def known_flow(cases, config):
    area = undeformed(cases.area_undeformed, cases.n_times)
    seen = np.moveaxis(np.concatenate([cases.flow, area], axis=1), 1, 2)
    inputs = seen.reshape(-1, 2 * cases.n_times)
    whitening = Whitening(inputs, config.flow.hidden[0], config.full_batch.whitening)
    weight = amplitude_weight(cases.inflow, config.full_batch.amplitude_exponent)
    data = FitData((cases.inflow, area), cases.flow, cases.grid, config)
    return Collocation(data, weight, whitening), area


def test_twice_the_weight_is_the_case_twice(small_cases):
    config = LITTLE.replace(flow={"loss": "sum"}, full_batch={"weight_decay": 1e-4})
    area = undeformed(small_cases.area_undeformed, 20)
    inputs = np.moveaxis(np.concatenate([small_cases.flow, area], axis=1), 1, 2).reshape(-1, 40)
    whitening = Whitening(inputs, config.flow.hidden[0], config.full_batch.whitening)
    n = len(small_cases)
    twice, weight = np.r_[np.arange(n), 2], np.ones(n)
    weight[2] = 2
    vector = initial_parameters(config, 20, 21, 0).flow
    found = []
    for cases, weights in ((np.arange(n), weight), (twice, np.ones(n + 1))):
        flow, inputs = small_cases.flow[cases], (small_cases.inflow[cases], area[cases])
        # The decay is in units of the flow's squares.
        decay = 1e-4 * np.sum(small_cases.flow**2) / np.sum(flow**2)
        settings = config.replace(full_batch={"weight_decay": decay})
        data = FitData(inputs, flow, small_cases.grid, settings)
        known = Collocation(data, weights, whitening)
        found.append(known.objective(known.coordinates(vector)))
    (loss, gradient), (expected, its_gradient) = found
    assert loss == pytest.approx(expected, rel=1e-8)
    assert np.allclose(gradient, its_gradient, rtol=0, atol=1e-8 * np.abs(gradient).max())


@pytest.mark.parametrize("loss", ["mean", "sum"])
@pytest.mark.parametrize("activation", ["tanh", "gelu"])
def test_the_gradient_along_the_known_flow(small_cases, activation, loss):
    config = LITTLE.replace(
        flow={"hidden": (4, 3), "activation": activation, "loss": loss},
        full_batch={"weight_decay": 1e-4},
    )
    known, _ = known_flow(small_cases, config)
    start = known.coordinates(initial_parameters(config, 20, 21, 0).flow)
    found, gradient = known.objective(start)
    rng = np.random.default_rng(0)
    for _ in range(3):
        way = rng.normal(size=start.size)
        step = 1e-5
        rise = known.objective(start + step * way)[0] - known.objective(start - step * way)[0]
        assert gradient @ way == pytest.approx(rise / (2 * step), rel=1e-5)
    assert found > 0


def test_the_fit_along_the_known_flow_is_nearly_that_of_the_equation(engine, small_cases, grid):
    settings = {"collocation_iterations": 60, "weight_decay": 0.0, "amplitude_exponent": 0.0}
    config = LITTLE.replace(full_batch=settings)
    known, area = known_flow(small_cases, config)
    start, losses = initial_parameters(config, 20, 21, 0).flow, []
    found = known.fit(start, lambda _, loss: losses.append(loss))
    fitted = found.parameters
    assert all(later <= earlier for earlier, later in pairwise(losses))
    inputs = small_cases.inflow, area
    through, _ = loss_and_gradient_of(engine.flow, fitted, inputs, small_cases.flow, grid, config)
    before, _ = loss_and_gradient_of(engine.flow, start, inputs, small_cases.flow, grid, config)
    assert through < 1.5 * losses[-1] < 1e-3 * before
