"""Fits of the closures of the preset ``physics``."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import (
    AREA,
    CONFIG,
    CORRECTED,
    INFLOW,
    LOSSES,
    MEMBRANE,
    OUTLET,
    PASSIVE,
    SHEAR,
    as_cases,
    solve,
)

from pcnde_bridge.config import PHYSICS
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.closure_parameters import WALL_SHEAR_STRESS, sizes
from pcnde_bridge.engines.shared_terms import rate
from pcnde_bridge.errors import SolveError
from pcnde_bridge.model.metrics import relative_error
from pcnde_bridge.training import closure_fit as fit
from pcnde_bridge.training.closure_parts import hold_cases
from pcnde_bridge.training.closure_training import ClosureTraining


@pytest.fixture(scope="module")
def corrected():
    return solve(CORRECTED)


@pytest.fixture(scope="module")
def cases():
    return as_cases(solve())


@pytest.fixture(scope="module")
def closures():
    return select_engine("jax").closures


def fit_losses(closures, cases, config, **again):
    return fit.fit_losses(hold_cases("losses", closures, cases, config), config, **again).parameters


def fit_wall(closures, cases, config):
    return fit.fit_wall(hold_cases("wall", closures, cases, config), cases, config).parameters


def fit_correction(closures, cases, config, *how):
    held = hold_cases("correction", closures, cases, config)
    return fit.fit_correction(held, PASSIVE, config, *how).parameters


@pytest.mark.parametrize("kind", ["auto", "resistance"])
def test_outlet_resistance_is_found(cases, kind):
    found = fit.fit_outlet(cases, CONFIG.replace(outlet={"kind": kind}))
    # Q(L) of the cases and their pressure belong together to the last pass's change.
    assert found == pytest.approx(OUTLET, rel=1e-4)


def test_given_outlet_is_kept(cases):
    given = CONFIG.replace(outlet={"resistance": 9e4, "kind": "resistance"})
    r1, r2, compliance, distal = fit.fit_outlet(cases, given)
    assert (r1 + r2, compliance * r2) == (9e4, 0)
    assert distal == pytest.approx(5e3 + 1e4 * cases.flow[:, :, -1].mean())
    given = CONFIG.replace(outlet={"distal_pressure": 5e3})
    assert fit.fit_outlet(cases, given) == pytest.approx(OUTLET, rel=1e-4)
    assert fit.fit_outlet(cases, given)[3] == 5e3


@pytest.mark.parametrize("distal", [None, 5e3])
@pytest.mark.parametrize("kind", ["auto", "windkessel"])
def test_windkessel_is_found(kind, distal):
    outlet = np.array([2e4, 8e4, 2e-6, 5e3])
    cases = as_cases(solve(PASSIVE.replace(outlet=outlet)))
    settings = CONFIG.replace(outlet={"kind": kind, "distal_pressure": distal})
    assert fit.fit_outlet(cases, settings) == pytest.approx(outlet, rel=1e-3)


def largest_error_of_the_drop(closures, cases, parameters):
    """Largest error of p − p(L) with given losses, relative to the largest p − p(L)."""
    flow_rate = np.moveaxis(rate(np.moveaxis(cases.flow, 1, -1), cases.period), -1, 1)
    problem = closures.losses(cases.flow, flow_rate, cases.area_undeformed, cases.grid, CONFIG)
    expected = problem(LOSSES)[0]
    return np.abs(problem(parameters)[0] - expected).max() / np.abs(expected).max()


def test_losses_are_found(cases, closures):
    # The cases' modes take the storage's shares from a uniform pressure: not to round-off.
    found = fit_losses(closures, cases, CONFIG)
    # Several of the ten can replace each other, but the drop is the same.
    assert largest_error_of_the_drop(closures, cases, found) < 1e-3
    assert found[:2] == pytest.approx(LOSSES[:2], rel=0.05)


def test_losses_are_fitted_again_without_some_cases(cases, closures):
    pressure = cases.pressure.copy()
    pressure[:4] *= 1.1  # with which the cases are still plausible
    other = as_cases((cases.flow, cases.area, pressure))

    def fitted(some, left_out):
        return fit.fit_losses(
            hold_cases("losses", closures, some, CONFIG), CONFIG, again=(LOSSES, left_out, 3)
        ).parameters

    assert np.array_equal(fitted(other, np.arange(4)), fitted(cases, np.arange(4)))
    assert not np.array_equal(fitted(other, []), fitted(cases, []))


def test_given_losses_are_kept(cases, closures):
    given = CONFIG.replace(losses={"friction": 1.5, "jet_spread": 0.1})
    found = fit_losses(closures, cases, given)
    assert (found[0], found[7]) == (1.5, 0.1)
    assert found[1] == pytest.approx(1.1, rel=0.2)
    starts = np.array([start for start, _, _ in fit._LOSSES.values()])
    assert (np.delete(found, [0, 7]) != np.delete(starts, [0, 7])).all()


def test_membrane_is_found(cases, closures):
    assert fit.fit_wall(
        hold_cases("wall", closures, cases, CONFIG), cases, CONFIG
    ).parameters == pytest.approx(MEMBRANE, rel=0.01)


def test_membrane_with_given_zero_pressure_is_found(cases, closures):
    given = CONFIG.replace(wall={"zero_pressure": 2e3})
    found = fit_wall(closures, cases, given)
    assert found == pytest.approx(MEMBRANE, rel=5e-3)
    assert found[4] == 2e3
    given = CONFIG.replace(wall={"stiffness": 1.1e6, "poisson": 0.4})
    assert tuple(fit_wall(closures, cases, given)[:2]) == (1.1e6, 0.4)


def error_of_the_shear(cases, found):
    """Relative error of the magnitude for some parameters of the wall shear stress."""
    parameters = PASSIVE.replace(wall_shear_stress=found)
    predicted = solve(parameters, cases.inflow).wall_shear_stress
    return relative_error(predicted, cases.wall_shear_stress)


def test_wall_shear_stress_is_found_from_its_magnitude(cases, closures):
    assert cases.wall_shear_stress.min() >= 0
    start = error_of_the_shear(cases, WALL_SHEAR_STRESS)
    others = PASSIVE.replace(wall_shear_stress=np.empty(0))
    found = fit.fit_wall_shear_stress(closures, others, cases, CONFIG, [])
    assert start > 0.1
    assert error_of_the_shear(cases, found) < 0.01
    assert found[0] == pytest.approx(SHEAR[0], rel=0.05)


def test_parameters_without_a_wall_shear_stress_are_the_start(cases, closures):
    without = as_cases((cases.flow, cases.area, cases.pressure))
    found = fit.fit_wall_shear_stress(closures, PASSIVE, without, CONFIG, [])
    assert np.array_equal(found, WALL_SHEAR_STRESS)


@pytest.fixture(scope="module")
def local_cases(cases):
    """The same flow and pressure in a vessel of the local law, whose ends move."""
    radius = np.sqrt(AREA / np.pi)
    strain = (radius / radius[:, :1])[:, None] ** 0.7 * (cases.pressure - 2e3) / 2e6
    area = np.pi * (radius[:, None] * (1 + strain)) ** 2
    return as_cases((cases.flow, area, cases.pressure))


def test_local_law_is_found(local_cases, closures):
    config = CONFIG.replace(wall={"law": "local"})
    found = fit.fit_wall(
        hold_cases("wall", closures, local_cases, config), local_cases, config
    ).parameters
    assert found == pytest.approx([2e6, 0.7, 2e3], rel=0.01)


def test_law_is_chosen_by_whether_the_ends_move(cases, local_cases):
    def law(some, **wall):
        config = PHYSICS.replace(wall=wall)
        return ClosureTraining(some, config, select_engine("jax")).config.wall.law

    assert law(cases) == "membrane"
    assert law(local_cases) == "local"
    assert law(cases, law="local") == "local"


def test_correction_starts_from_the_cases(cases, corrected):
    found = fit.first_correction(cases, CONFIG, np.random.default_rng(0))
    # Central differences are 6 % off at the third harmonic of 32 time points.
    assert found[0] == pytest.approx(1.3, rel=0.06)
    assert found[1] < 0.06
    given = CONFIG.replace(correction={"storage": 1.3})
    found = fit.first_correction(as_cases(corrected), given, np.random.default_rng(0))
    assert found[0] == 1.3
    assert 0.3 < found[1] < 0.85
    assert found.size == sizes(CONFIG)["correction"]
    weights = fit.first_correction(cases, CONFIG, np.random.default_rng(1))[4:]
    assert not np.array_equal(weights[:-1], found[4:-1])


def test_storage_is_found_with_the_share_that_the_correction_hides(cases, closures):
    first = fit.first_correction(cases, CONFIG, np.random.default_rng(0))
    first[0] = 0.8
    found = fit.fit_correction(
        hold_cases("correction", closures, cases, CONFIG), PASSIVE, CONFIG, first, np.ones(16), 15
    ).parameters
    assert found.shape == first.shape
    assert np.array_equal(found[1:4], first[1:4])
    flow = solve(PASSIVE.replace(correction=found)).flow
    # κ·(1 − g) shows in the flow: neither alone, but the storage must be that of the cases.
    assert np.abs(flow - cases.flow).max() < 0.01 * np.abs(cases.flow - INFLOW[..., None]).max()


def test_given_storage_is_kept(cases, closures):
    given = CONFIG.replace(correction={"storage": 1.3})
    first = fit.first_correction(cases, given, np.random.default_rng(0))
    found = fit.fit_correction(
        hold_cases("correction", closures, cases, given), PASSIVE, given, first, np.ones(16), 15
    ).parameters
    assert found[0] == 1.3


def test_cases_of_weight_zero_do_not_count(cases, closures):
    flow = cases.flow.copy()
    flow[:4, :, 1:] *= 1.03
    other = as_cases((flow, cases.area, cases.pressure))
    first = fit.first_correction(cases, CONFIG, np.random.default_rng(0))
    without = (np.arange(16) >= 4).astype(float)

    def fitted(some, weight):
        return fit.fit_correction(
            hold_cases("correction", closures, some, CONFIG), PASSIVE, CONFIG, first, weight, 3
        ).parameters

    assert np.array_equal(fitted(other, without), fitted(cases, without))
    assert not np.array_equal(fitted(other, np.ones(16)), fitted(cases, np.ones(16)))


def test_first_values_that_cannot_be_computed_are_an_error(cases, closures):
    first = fit.first_correction(cases, CONFIG, np.random.default_rng(0))
    first[2] = np.nan
    with pytest.raises(SolveError, match="Check the units of the training cases"):
        fit.fit_correction(
            hold_cases("correction", closures, cases, CONFIG),
            PASSIVE,
            CONFIG,
            first,
            np.ones(16),
            3,
        )
