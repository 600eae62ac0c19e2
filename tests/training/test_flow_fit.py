"""Fit of the flow network: weights, and the balanced reference flow."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import LITTLE, loss_and_gradient_of

from pcnde_bridge import (
    Cases,
)
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import Fit, FitData
from pcnde_bridge.training import flow_fit
from pcnde_bridge.training.collocation import Collocation
from pcnde_bridge.training.flow_fit import amplitude_weight, balanced_flow, fit_flow
from pcnde_bridge.training.variable_projection import VariableProjection


def unchanged(parameters):
    return Fit(parameters, np.empty(0), True, "not fitted")


def data(cases, config):
    inputs = cases.inflow, undeformed(cases.area_undeformed, cases.n_times)
    return FitData(inputs, cases.flow, cases.grid, config)


def record(number, optimize):
    return optimize(lambda *_: None).parameters


@pytest.mark.parametrize("terms", [(), ("inertia",)])
def test_collocation_comes_first_but_not_with_terms(engine, small_cases, grid, terms):
    config = LITTLE.replace(flow={"terms": terms})
    area = undeformed(small_cases.area_undeformed, 20)
    start = initial_parameters(config, 20, 21, 0).flow
    losses = {}

    def run(number, optimize):
        losses[number] = []
        return optimize(lambda _, loss: losses[number].append(loss)).parameters

    fitted = fit_flow(start, small_cases, data(small_cases, config), engine, 3, run)
    collocation = LITTLE.full_batch.collocation_iterations
    assert {number: len(of_fit) for number, of_fit in losses.items()} == (
        {1: 3 + collocation} if terms else {1: collocation, 2: 3}
    )
    inputs = small_cases.inflow, area
    loss, before = (
        loss_and_gradient_of(engine.flow, vector, inputs, small_cases.flow, grid, config)[0]
        for vector in (fitted, start)
    )
    assert loss < 0.5 * before


def test_weaker_waves_weigh_more_up_to_a_bound():
    wave = np.cos(2 * np.pi * np.arange(8) / 8)
    inflow = 1 + np.array([0.0, 0.1, 1.0, 2.0, 4.0])[:, None] * wave
    found = amplitude_weight(inflow, 1.5)
    expected = np.array([0.4, 0.4, 1.0, 2.0, 4.0]) ** -1.5
    assert np.allclose(found, expected / expected.mean())
    assert np.allclose(amplitude_weight(inflow, 0.0), 1.0)
    assert np.allclose(amplitude_weight(inflow[2:], 1.0), np.array([2.0, 1.0, 0.5]) / (3.5 / 3))
    assert np.array_equal(amplitude_weight(np.ones((3, 8)), 1.5), np.ones(3))
    # Weights are finite for any exponent, and steady cases have weights, too.
    assert np.allclose(amplitude_weight(inflow, 1e6), [2.5, 2.5, 0, 0, 0])
    steady = 1 + np.array([1e-6, 1e-6, 1e-6, 1.0, 2.0])[:, None] * wave
    found = amplitude_weight(steady, 1.0)
    assert np.allclose(found / found[-1], [10, 10, 10, 2, 1])


def test_both_fits_of_the_flow_have_the_weights(engine, small_cases, monkeypatch):
    seen = {}

    def seen_collocation(data, weight, *others):
        seen["collocation"] = weight
        return Collocation(data, weight, *others)

    make = engine.flow.objective

    def objective(data, weight):
        seen["equation"] = weight
        return make(data, weight)

    monkeypatch.setattr(flow_fit, "Collocation", seen_collocation)
    monkeypatch.setattr(engine.flow, "objective", objective)
    start = initial_parameters(LITTLE, 20, 21, 0).flow
    fit_flow(start, small_cases, data(small_cases, LITTLE), engine, 2, record)
    expected = amplitude_weight(small_cases.inflow, LITTLE.full_batch.amplitude_exponent)
    assert np.ptp(expected) > 0.1
    assert np.array_equal(seen["collocation"], expected)
    assert np.array_equal(seen["equation"], expected)


def test_a_start_whose_equation_diverges_is_left(engine, small_cases, monkeypatch):
    """The parameters before collocation are fitted through the equation then."""
    start = initial_parameters(LITTLE, 20, 21, 0).flow
    far = Fit(np.full_like(start, 1e6), np.empty(0), True, "not fitted")
    monkeypatch.setattr(VariableProjection, "fit", lambda *_: far)
    fitted = fit_flow(start, small_cases, data(small_cases, LITTLE), engine, 3, record)
    assert np.isfinite(fitted).all() and np.abs(fitted).max() < 1e3


@pytest.fixture(scope="module")
def elastic_cases():
    """A wall that moves by another phase in each case, and the flow that conserves volume."""
    t, z = np.arange(40) / 40, np.linspace(0, 4, 21)
    phase = np.array([0.0, 0.7, 2.0, 4.0])[:, None, None]
    s_u = np.broadcast_to(0.12 + 0.01 * np.cos(z), (4, 21))
    angle = 2 * np.pi * t[:, None] + phase
    area = s_u[:, None] * (1 + 0.02 * (1 + 0.1 * z) * np.sin(angle))
    filling = 2 * np.pi * 0.02 * np.cos(angle) * s_u[:, None] * (1 + 0.1 * z)
    integral = np.cumsum(np.diff(z) * (filling[..., 1:] + filling[..., :-1]) / 2, axis=2)
    flow = np.repeat(1.5 + 0.5 * np.sin(angle), 21, axis=2)
    flow[..., 1:] -= integral / 0.5  # so that â is one half
    pressure = 1e5 * flow[..., :1] * np.ones(21)
    return Cases(flow, area, pressure, s_u, t, z, period=1.0, units="cgs,area=cm^2")


@pytest.mark.parametrize(("anchor", "cycles"), [("last_time_point", 3), ("last_cycle", 2)])
def test_the_balanced_flow_leads_to_the_areas_start(elastic_cases, anchor, cycles):
    cases = elastic_cases
    config = LITTLE.replace(fourier_area={"anchor": anchor})
    balanced = balanced_flow(cases, config)
    assert np.allclose(balanced[:, :, 0], cases.flow[:, :, 0], rtol=1e-12)
    change = balanced - cases.flow
    assert np.allclose(change, change.mean(axis=1, keepdims=True), atol=1e-12)
    slope = np.diff(balanced.mean(axis=1), axis=1) / np.diff(cases.z)
    start = cases.area[:, 0] - cases.area_undeformed
    start = start - start.mean(axis=0)
    asked = -(start[:, 1:] + start[:, :-1]) / 2
    a_hat = asked / (cycles * slope)  # of one second
    assert np.allclose(a_hat, 0.5, rtol=0.01)  # ∂V/∂t by differences


@pytest.mark.parametrize(
    "change", [{"fourier_area": {"anchor": "undeformed"}}, {"full_batch": {"mean_flow": "data"}}]
)
def test_the_datas_own_mean_flow(elastic_cases, change):
    config = LITTLE.replace(**change)
    assert balanced_flow(elastic_cases, config) is elastic_cases.flow


def test_where_flow_and_volume_do_not_agree_the_flow_is_the_datas(small_cases):
    assert balanced_flow(small_cases, LITTLE) is small_cases.flow
    still = np.repeat(small_cases.area_undeformed[:, None], 20, axis=1)
    same = np.repeat(small_cases.flow[:, :, :1], 21, axis=2)
    grid = {"time": small_cases.time, "z": small_cases.z, "period": 1.0}
    grid["units"] = "cgs,area=cm^2"
    rigid = Cases(same, still, small_cases.pressure, small_cases.area_undeformed, **grid)
    assert balanced_flow(rigid, LITTLE) is rigid.flow
