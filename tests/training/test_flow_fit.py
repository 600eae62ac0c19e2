"""Fit of the flow network: weights, starts, validation, and the balanced reference flow."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import LITTLE

from pcnde_bridge import (
    Cases,
)
from pcnde_bridge.data.splits import training_and_validation
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import (
    Fit,
    FlowInputs,
)
from pcnde_bridge.training import flow_fit
from pcnde_bridge.training.collocation import collocation
from pcnde_bridge.training.flow_fit import amplitude_weight, balanced_flow, fit_flow
from pcnde_bridge.training.variable_projection import VariableProjection


def unchanged(parameters):
    return Fit(parameters, np.empty(0), True, "not fitted")


def test_the_flow_fit_uses_its_training_part_alone(engine, small_cases, everything):
    """The held cases' targets decide when to stop, and nothing else."""
    parts = training_and_validation(small_cases, 0.3, 0)
    area = undeformed(small_cases.area_undeformed, 20)
    start = initial_parameters(LITTLE, 20, 21, 0).flow

    def fit(cases, selection):
        return fit_flow([start], cases, area, selection, engine, LITTLE, 3)

    flow = small_cases.flow.copy()
    flow[parts[1], :, 1:] *= 1.01
    other = Cases(
        flow,
        small_cases.area,
        small_cases.pressure,
        small_cases.area_undeformed,
        small_cases.time,
        small_cases.z,
        period=1.0,
        labels=small_cases.labels,
    )
    assert np.array_equal(fit(small_cases, parts[:1]), fit(other, parts[:1]))
    assert not np.array_equal(fit(small_cases, everything), fit(other, everything))


def test_the_validation_error_has_the_weights_of_the_loss(engine, small_cases, grid, monkeypatch):
    fitted, held = parts = training_and_validation(small_cases, 0.3, 0)
    area = undeformed(small_cases.area_undeformed, 20)
    start = initial_parameters(LITTLE, 20, 21, 0).flow
    errors = []

    def validated_once(objective, coordinates, settings, iterations, unit, validate, *_, **__):
        errors.append(validate(coordinates))
        return unchanged(coordinates)

    monkeypatch.setattr(flow_fit, "minimize", validated_once)
    monkeypatch.setattr(VariableProjection, "fit", lambda _, start, *__, **___: unchanged(start))
    vector = fit_flow([start], small_cases, area, parts, engine, LITTLE, 3)
    flow = engine.flow.solve(vector, FlowInputs(small_cases.inflow, area), grid, LITTLE)
    off = flow - balanced_flow(small_cases, fitted, LITTLE)
    power = LITTLE.full_batch.amplitude_exponent
    weight = amplitude_weight(small_cases.inflow, fitted, power)[held]
    assert np.ptp(weight) > 0.1
    assert errors == pytest.approx([np.mean(weight[:, None, None] * off[held] ** 2)])


@pytest.mark.parametrize("validation", [0.0, 0.3])
@pytest.mark.parametrize("terms", [(), ("inertia",)])
def test_the_best_of_several_starts_goes_on(
    engine, small_cases, grid, validation, terms, monkeypatch
):
    config = LITTLE.replace(flow={"terms": terms})
    parts = training_and_validation(small_cases, validation, 0)
    area = undeformed(small_cases.area_undeformed, 20)
    starts = [initial_parameters(config, 20, 21, 0, start).flow for start in range(3)]
    assert not np.array_equal(starts[0], starts[1])
    asked, along = [], []
    fit_along = VariableProjection.fit

    def kept(*args, **options):
        found = fit_along(*args, **options)
        along.append(found.parameters)
        return found

    monkeypatch.setattr(VariableProjection, "fit", kept)

    def fit(*chosen):
        def run(number, optimize):
            asked.append(number)
            return optimize(None).parameters

        return fit_flow(chosen, small_cases, area, parts, engine, config, 3, run)

    def error(vector):
        inputs = FlowInputs(small_cases.inflow, area)
        flow = engine.flow.solve(vector, inputs, grid, config)
        return np.mean((flow - small_cases.flow)[parts[-1]] ** 2)

    alone = [fit(start) for start in starts]
    # What is chosen from: the fits along the known flow or, with terms, those of the equation.
    assert len(along) == (0 if terms else 3)
    errors = [error(vector) for vector in along or alone]
    assert np.ptp(errors) > 1e-3 * min(errors)
    asked.clear()
    assert np.array_equal(fit(*starts), alone[int(np.argmin(errors))])
    assert asked == ([1, 2, 3] if terms else [1, 2, 3, 4])


def test_weaker_waves_weigh_more_up_to_a_bound():
    wave = np.cos(2 * np.pi * np.arange(8) / 8)
    inflow = 1 + np.array([0.0, 0.1, 1.0, 2.0, 4.0])[:, None] * wave
    everything, power = np.arange(5), 1.5
    found = amplitude_weight(inflow, everything, power)
    expected = np.array([0.4, 0.4, 1.0, 2.0, 4.0]) ** -power
    assert np.allclose(found, expected / expected.mean())
    assert np.allclose(amplitude_weight(inflow, everything, 0.0), 1.0)
    # The others' weights follow those of the fitted cases.
    some = amplitude_weight(inflow, np.array([2, 3, 4]), 1.0)
    assert np.allclose(some[2:], np.array([2.0, 1.0, 0.5]) / (3.5 / 3))
    assert some[0] == some[1] == some[2]
    assert np.array_equal(amplitude_weight(np.ones((3, 8)), np.arange(3), power), np.ones(3))
    # Weights are finite for any left-out waveforms, and steady cases have weights, too.
    assert np.allclose(amplitude_weight(inflow, everything, 1e6), [2.5, 2.5, 0, 0, 0])
    assert np.isfinite(amplitude_weight(inflow, np.array([3, 4]), 1e6)).all()
    steady = 1 + np.array([1e-6, 1e-6, 1e-6, 1.0, 2.0])[:, None] * wave
    found = amplitude_weight(steady, everything, 1.0)
    assert np.allclose(found / found[-1], [10, 10, 10, 2, 1])


def test_both_fits_of_the_flow_have_the_weights(engine, small_cases, everything, monkeypatch):
    seen = {}

    def seen_collocation(flow, area, weight, *others):
        seen["collocation"] = weight
        return collocation(flow, area, weight, *others)

    make = engine.flow.objective

    def objective(inputs, target, weight, *others):
        seen["equation"] = weight
        return make(inputs, target, weight, *others)

    monkeypatch.setattr(flow_fit, "collocation", seen_collocation)
    monkeypatch.setattr(engine.flow, "objective", objective)
    area = undeformed(small_cases.area_undeformed, 20)
    start = initial_parameters(LITTLE, 20, 21, 0).flow
    fit_flow([start], small_cases, area, everything, engine, LITTLE, 2)
    expected = amplitude_weight(
        small_cases.inflow, everything[0], LITTLE.full_batch.amplitude_exponent
    )
    assert np.ptp(expected) > 0.1
    assert np.array_equal(seen["collocation"], expected)
    assert np.array_equal(seen["equation"], expected)


@pytest.mark.parametrize("validation", [0.0, 0.3])
def test_starts_whose_equation_diverges_are_left(engine, small_cases, validation, monkeypatch):
    """The first start is fitted through the equation then."""
    parts = training_and_validation(small_cases, validation, 0)
    start = initial_parameters(LITTLE, 20, 21, 0).flow
    area = undeformed(small_cases.area_undeformed, 20)
    far = unchanged(np.full_like(start, 1e6))
    monkeypatch.setattr(VariableProjection, "fit", lambda *_, **__: far)
    fitted = fit_flow([start], small_cases, area, parts, engine, LITTLE, 3)
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
    return Cases(flow, area, 1e5 * flow, s_u, t, z, period=1.0)


@pytest.mark.parametrize(("anchor", "cycles"), [("last_time_point", 3), ("last_cycle", 2)])
def test_the_balanced_flow_leads_to_the_areas_start(elastic_cases, anchor, cycles):
    cases, chosen = elastic_cases, np.arange(4)
    config = LITTLE.replace(fourier_area={"anchor": anchor})
    balanced = balanced_flow(cases, chosen, config)
    assert np.allclose(balanced[:, :, 0], cases.flow[:, :, 0], rtol=1e-12)
    change = balanced - cases.flow
    assert np.allclose(change, change.mean(axis=1, keepdims=True), atol=1e-12)
    slope = np.diff(balanced.mean(axis=1), axis=1) / np.diff(cases.z)
    start = cases.area[:, 0] - cases.area_undeformed
    start = start - start.mean(axis=0)
    asked = -(start[:, 1:] + start[:, :-1]) / 2
    a_hat = asked / (cycles * slope)  # of one second
    assert np.allclose(a_hat, 0.5, rtol=0.01)  # ∂V/∂t by differences
    few = balanced_flow(cases, chosen[:2], config)
    assert not np.allclose(few, balanced)


@pytest.mark.parametrize(
    "change", [{"fourier_area": {"anchor": "undeformed"}}, {"full_batch": {"mean_flow": "data"}}]
)
def test_the_datas_own_mean_flow(elastic_cases, change):
    config = LITTLE.replace(**change)
    assert balanced_flow(elastic_cases, np.arange(4), config) is elastic_cases.flow


def test_where_flow_and_volume_do_not_agree_the_flow_is_the_datas(small_cases, everything):
    assert balanced_flow(small_cases, *everything, LITTLE) is small_cases.flow
    still = np.repeat(small_cases.area_undeformed[:, None], 20, axis=1)
    same = np.repeat(small_cases.flow[:, :, :1], 21, axis=2)
    grid = {"time": small_cases.time, "z": small_cases.z, "period": 1.0}
    rigid = Cases(same, still, small_cases.pressure, small_cases.area_undeformed, **grid)
    assert balanced_flow(rigid, *everything, LITTLE) is rigid.flow
