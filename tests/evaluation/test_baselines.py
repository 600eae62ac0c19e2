"""The baselines against calculations by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import (
    Cases,
    InputError,
)
from pcnde_bridge.data.stenosis import measuring_positions
from pcnde_bridge.data.variables import FIELDS, VARIABLES
from pcnde_bridge.evaluation.baselines import (
    FEM_WALL,
    DropRegression,
    ResponseSurface,
    Solver1D,
    StenosisLoss,
    Unchanged,
    itu,
    mirramezani,
    standard_baselines,
    young_tsai,
)
from pcnde_bridge.evaluation.benchmark import bench_baseline
from pcnde_bridge.hemodynamics import pressure_losses
from pcnde_bridge.hemodynamics.outlet import Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.model.metrics import pooled_errors


def polynomial_cases(n_waveforms: int = 5, n_geometries: int = 4) -> Cases:
    """Outputs that are polynomials in the scale w of the waveform and the width g."""
    w, g = (a.ravel() for a in np.meshgrid(range(n_waveforms), range(n_geometries)))
    time, z = np.arange(8) / 8, np.linspace(0, 4, 21)
    w_, g_ = w[:, None, None], g[:, None, None]
    inflow = 1.2 + 0.1 * w[:, None] * np.cos(2 * np.pi * time)
    area_undeformed = 0.12 + 0.004 * g[:, None] * np.sin(np.pi * z / 4) ** 2
    along, over = z / 4, np.sin(2 * np.pi * time)[:, None]
    flow = inflow[:, :, None] + along * over * (0.01 * w_**2 + 0.02 * w_ * g_**2)
    area = area_undeformed[:, None, :] * (1.05 + 0.001 * w_ * over + 0.002 * g_**3)
    pressure = 1e5 * flow[:, :, -1:] + (4 - z) * (100 * w_**3 + 50 * g_)
    labels = {"geometry": g, "waveform": w}
    stated = {"labels": labels, "units": "cgs,area=cm^2"}  # a pressure by formula
    return Cases(flow, area, pressure, area_undeformed, time, z, **stated)


@pytest.fixture
def sets(small_cases, small_split):
    return small_cases.split(small_split)._asdict()


# ---- each of them ----------------------------------------------------------------


def test_unchanged(small_cases):
    train, test = small_cases.select(slice(0, 6)), small_cases.select(slice(6, 12))
    found = Unchanged().fit(train).predict(test)
    q, p = train.flow[:, :, -1], train.pressure[:, :, -1]
    resistance = (q * p).sum() / (q * q).sum()
    for case, time_point, point in ((0, 3, 7), (5, 19, 20)):
        inflow = test.flow[case, time_point, 0]
        assert found["flow"][case, time_point, point] == inflow
        assert found["area"][case, time_point, point] == test.area_undeformed[case, point]
        np.testing.assert_allclose(found["pressure"][case, time_point, point], resistance * inflow)
    stress = 4 * 0.04 * found["flow"] / np.sqrt(found["area"] ** 3 / np.pi)
    np.testing.assert_allclose(found["wall_shear_stress"], stress, rtol=1e-14)
    assert {name: values.shape for name, values in found.items()} == dict.fromkeys(
        FIELDS, test.flow.shape
    )


def test_polynomial_finds_a_polynomial_outside_its_cases():
    cases = polynomial_cases()
    inside = cases.select((cases.labels["waveform"] < 4) & (cases.labels["geometry"] < 4))
    outside = cases.select(waveform=4)
    found = ResponseSurface(3, 3).fit(inside).predict(outside)
    for variable in VARIABLES:
        truth = getattr(outside, variable)
        np.testing.assert_allclose(found[variable], truth, rtol=1e-8)


def test_wall_shear_stress_of_polynomial_and_regression(sheared_cases):
    sets = {"train": sheared_cases}
    for method in (ResponseSurface(2, 2), DropRegression(1, base=ResponseSurface(2, 2))):
        errors = bench_baseline("polynomial", method, sets).errors["train"]
        assert list(errors)[-2:] == ["wall_shear_stress", "time_averaged_wall_shear_stress"]
        assert errors["wall_shear_stress"] < 0.05


def test_polynomial_of_degree_0_is_the_mean_and_of_degree_1_a_straight_line():
    cases = polynomial_cases()
    mean = ResponseSurface(0, 0).fit(cases).predict(cases)
    np.testing.assert_allclose(mean["pressure"][3], cases.pressure.mean(axis=0))
    # A straight line through two cases, at a third, by hand.
    row = cases.select(geometry=0)
    two, third = row.select([0, 1]), row.select([3])
    line = ResponseSurface(1, 1).fit(two).predict(third)
    by_hand = row.flow[0] + 3 * (row.flow[1] - row.flow[0])
    np.testing.assert_allclose(line["flow"][0], by_hand, rtol=1e-10)


def test_polynomial_components():
    cases = polynomial_cases()
    # Inflow and area have one component each; asking for more finds no more.
    for components in (None, 1, 3):
        surface = ResponseSurface(2, 2, components, components).fit(cases)
        assert surface._coefficients["flow"].shape == (9, 8, 21)
    # Two components of total degree 2: 1, x, y, x², xy, y².
    rng = np.random.default_rng(0)
    mixed = np.repeat(np.arange(20), 1)
    inflow = 1 + 0.1 * rng.standard_normal((20, 2)) @ rng.standard_normal((2, 8))
    flow = np.repeat(inflow[:, :, None], 5, axis=2)
    area_undeformed = np.full((20, 5), 0.12)
    area = np.repeat(area_undeformed[:, None], 8, axis=1)
    labels = {"geometry": mixed, "waveform": mixed}
    other = Cases(
        flow, area, 1e5 * flow, area_undeformed, np.arange(8) / 8, np.linspace(0, 4, 5),
        labels=labels, units="cgs,area=cm^2",
    )  # fmt: skip
    surface = ResponseSurface(2, 3).fit(other)
    assert surface._coefficients["flow"].shape == (6, 8, 5)
    np.testing.assert_allclose(surface.predict(other)["flow"], flow, rtol=1e-8)


@pytest.mark.parametrize(
    ("select", "degrees", "message"),
    [
        (
            {"waveform": [0, 1, 2]},
            (3, 3),
            r"16 coefficients, but the 12 training cases",
        ),
        (
            {"waveform": [0, 1, 2]},
            (3, 1),
            r"8 coefficients, .* \(3 different waveforms, 4 different geometries\) suffice for 6",
        ),
        (
            {"geometry": [0, 1]},
            (1, 2),
            "6 coefficients, .* 2 different geometries.* suffice for 4 only",
        ),
    ],
)
def test_polynomial_needs_enough_cases(select, degrees, message):
    with pytest.raises(InputError, match=message):
        ResponseSurface(*degrees).fit(polynomial_cases().select(**select))


def test_polynomial_needs_combinations():
    cases = polynomial_cases().select([(0, 0), (1, 0), (2, 0), (0, 1), (0, 2), (0, 3)])
    with pytest.raises(InputError, match=r"6 training cases \(4 different waveforms, 3"):
        ResponseSurface(1, 2).fit(cases)


@pytest.mark.parametrize("arguments", [(-1, 1), (1, 1.5), (1, 1, -2), (True, 1)])
def test_polynomial_refuses(arguments):
    with pytest.raises(InputError, match="whole number"):
        ResponseSurface(*arguments)


def test_another_grid(small_cases, other_period):
    surface = ResponseSurface(1, 1).fit(small_cases)
    with pytest.raises(InputError, match="but the model was trained on 20"):
        surface.predict(polynomial_cases())
    with pytest.raises(InputError, match=r"is 0\.76 in the cases but 0\.95 in"):
        surface.predict(other_period)


@pytest.mark.parametrize("name", list(standard_baselines()))
def test_predicting_before_fitting(name, small_cases):
    with pytest.raises(InputError, match="has not been fitted"):
        standard_baselines()[name].predict(small_cases)


def test_solver_is_the_solver(sets):
    found = Solver1D(stenosis_length=1.0).fit(sets["train"]).predict(sets["test"])
    outlet = Windkessel(outlet_resistance(sets["train"]))
    tube = Tube1D(n_times=20, steps=500)
    solved = tube.solve_like(sets["test"], outlet, stenosis_length=1.0)
    for variable in VARIABLES:
        assert (found[variable] == getattr(solved, variable)).all()
    assert found["flow"][:, :, 0] == pytest.approx(sets["test"].inflow, rel=1e-9)


def test_published_losses_are_added_up_to_the_throat(small_cases):
    found = StenosisLoss().fit(small_cases).predict(small_cases)
    nothing = Unchanged().fit(small_cases).predict(small_cases)
    assert np.array_equal(found["flow"], nothing["flow"])
    s_u = small_cases.area_undeformed
    healthy = np.sqrt(s_u[:, :1] * s_u[:, -1:])  # the throat is in the middle
    throat = s_u[:, 10:11]
    drop = pressure_losses.pressure_drop(small_cases.inflow, healthy, throat, 0.5)
    added = found["pressure"] - nothing["pressure"]
    np.testing.assert_allclose(added[:, :, :11], np.tile(drop[:, :, None], 11), rtol=1e-9)
    assert not added[:, :, 11:].any()


def test_published_losses_have_their_elements(small_cases):
    """Young and Tsai's rate of change; the friction and inertia integrated over the stenosis."""
    q, step = small_cases.inflow, small_cases.time[1]
    s_u, z = small_cases.area_undeformed, small_cases.z
    healthy, throat = np.sqrt(s_u[:, :1] * s_u[:, -1:]), s_u[:, 10:11]
    first, last = measuring_positions(z, s_u)
    fine = np.linspace(first, last, 2001, axis=1)
    area = np.array([np.interp(*row) for row in zip(fine, [z] * len(q), s_u, strict=True)])
    width = (fine[:, -1] - fine[:, 0])[:, None]
    resistance = 8 * np.pi * 0.04 * (area**-2).mean(axis=1, keepdims=True) * width
    inertance = 1.06 * (1 / area).mean(axis=1, keepdims=True) * width
    rate = (np.roll(q, -1, axis=1) - np.roll(q, 1, axis=1)) / (2 * step)  # coarse
    alpha = np.sqrt(healthy / np.pi) * np.sqrt(2 * np.pi * 1.06 / 0.04)
    mean = q.mean(axis=1, keepdims=True)
    expected = {
        young_tsai: pressure_losses.unsteady_pressure_drop(q, rate, healthy, throat, 0.5),
        mirramezani: pressure_losses.profile_pressure_drop(q, resistance, healthy, throat),
        itu: pressure_losses.unsteady_profile_pressure_drop(
            q, rate, mean, resistance, inertance, healthy, throat, alpha
        ),
    }
    for loss, drop in expected.items():
        error = np.linalg.norm(loss(small_cases, 0.5) - drop) / np.linalg.norm(drop)
        assert error < 0.02, loss


class _Truth:
    """Baseline with the true flow and area, and without a pressure drop."""

    def fit(self, train):
        return self

    def predict(self, cases):
        return {"flow": cases.flow, "area": cases.area, "pressure": 1e5 + 0 * cases.pressure}


def test_drop_regression_finds_its_own_terms(small_cases):
    q = small_cases.flow[:, :, 10]
    ratio = (small_cases.area_undeformed[:, 0] / small_cases.area_undeformed[:, 10])[:, None]
    drop = 300 * q * ratio**2 + 50 * q**1.5 * ratio + 20 * q**2
    pressure = 1e5 + drop[:, :, None] * (np.arange(21) <= 10)
    cases = Cases(
        small_cases.flow, small_cases.area, pressure, small_cases.area_undeformed,
        small_cases.time, small_cases.z, labels=small_cases.labels, units="cgs,area=cm^2",
    )  # fmt: skip
    train, test = cases.select(waveform=[1, 2]), cases.select(waveform=[3])
    found = DropRegression(2, _Truth()).fit(train).predict(test)
    np.testing.assert_allclose(found["pressure"], test.pressure, rtol=1e-6)
    with pytest.raises(InputError, match="too few different geometries or waveforms for 16"):
        DropRegression(3, _Truth()).fit(train)


@pytest.mark.data
def test_the_drop_of_the_papers_cases(published_cases):
    train, test = published_cases.split("paper")
    regression = DropRegression().fit(train)
    found = [pooled_errors(regression.predict(c), c)["pressure_drop"] for c in (train, test)]
    assert found == pytest.approx([0.0084, 0.0193], abs=2e-4)


@pytest.mark.data
def test_the_papers_finite_element_column(published_cases):
    train, test = published_cases.split("paper")
    found = pooled_errors(Solver1D(FEM_WALL).fit(train).predict(test), test)
    found = {name: found[name] for name in VARIABLES}
    paper = {"flow": 0.0204, "area": 0.0498, "pressure": 0.0365}
    assert found == pytest.approx(paper, rel=0.025)


@pytest.mark.data
def test_the_polynomial_on_the_papers_data(published_cases):
    sets = published_cases.split("paper")._asdict()
    surface = ResponseSurface().fit(sets["train"])
    found = {n: pooled_errors(surface.predict(c), c) for n, c in sets.items()}
    found = {n: {v: errors[v] for v in VARIABLES} for n, errors in found.items()}
    train = {"flow": 0.0020, "area": 0.0002, "pressure": 0.0033}
    assert found["train"] == pytest.approx(train, abs=1e-4)
    test = {"flow": 0.0044, "area": 0.0006, "pressure": 0.0070}
    assert found["test"] == pytest.approx(test, abs=1e-4)
