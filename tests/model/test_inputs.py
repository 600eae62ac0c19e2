"""Plausibility of a prediction's inputs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import Ensemble, InputError
from pcnde_bridge.config import resolve_config
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.hemodynamics import Stenosis, Vessel, coronary
from pcnde_bridge.model.inputs import check_plausible, inputs_from_arrays
from pcnde_bridge.uncertainty.novelty import Novelty


@pytest.fixture
def check(small_cases):
    """Check the inputs of cases in some units, in place of CGS units without a statement."""
    inflow, area = 1.1 * small_cases.inflow, 1.1 * small_cases.area_undeformed
    novelty = Novelty.fit(small_cases.inflow, small_cases.area_undeformed, small_cases.grid)

    def check(flow=1.0, of_area=1.0, z=1.0, time=1.0, change=None, units=None):
        s_u = of_area * area if change is None else change(area)
        grid = small_cases.z * z, time * small_cases.period
        given = inputs_from_arrays(small_cases.grid, True, flow * inflow, s_u, *grid, units)
        chosen = np.ones(len(given), dtype=bool)
        check_plausible(given, chosen, novelty)
        return given

    return check


def test_cgs_units_are_usual(check, small_cases):
    assert np.array_equal(check().inflow, 1.1 * small_cases.inflow)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"flow": 1e-6}, r"--units flow=m\^3/s"),
        ({"flow": 60}, "--units flow=mL/min"),
        ({"flow": -1}, "mean inflow of case 0, -.* mL/s, is negative: .* change the sign"),
        ({"of_area": 100}, r"--units area=mm\^2"),
        ({"of_area": 1e-4}, r"--units area=m\^2"),
        ({"z": 10}, "ambiguous: .*with z in mm"),
        ({"time": 1000}, "--units time=ms"),
        ({"of_area": 100, "z": 10, "flow": 1000}, r"flow in mm\^3/s, area in mm\^2, z in mm"),
        ({"change": lambda s: np.sqrt(s / np.pi)}, "looks like a radius"),
        ({"change": lambda s: np.sqrt(4 * s / np.pi)}, "looks like a diameter"),
    ],
)
def test_other_numbers_are_refused(check, change, message):
    with pytest.raises(InputError, match=message):
        check(**change)


def test_no_flow_and_damaged_samples_are_refused(check):
    with pytest.raises(InputError, match="mean inflow of case 0, 0 mL/s, is zero: give"):
        check(flow=0.0)
    damaged = np.ones((20, 1))
    damaged[3] = 1.1
    with pytest.raises(InputError, match=r"inflow is .* at 0\.15 s \(time point 3, case 0\)"):
        check(flow=damaged.T)


def test_units_are_converted(check):
    expected = check()
    units = {"flow": "mL/min", "area": "mm^2", "z": "mm", "time": "ms"}
    found = check(60, 100, 10, 1000, units=units)
    for name in ("inflow", "area_undeformed"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12)
    assert isinstance(found.grid, Grid)
    np.testing.assert_allclose(found.grid.z, expected.grid.z, rtol=1e-12)
    assert found.grid.period == pytest.approx(1.0)
    check(z=10, units="cgs")


# ---- vessels and waveforms ---------------------------------------------------------


CLOSED = coronary().flow(np.arange(33) / 32).round(12)
VESSELS = [Vessel((Stenosis(b),)) for b in (0.4, 0.6)]


def test_vessels_and_waveforms_are_their_arrays(physics_model):
    flow, area = coronary().samples(32), [v.area_undeformed(physics_model.grid.z) for v in VESSELS]
    expected = physics_model.predict(flow, area, units="cgs").pressure
    for given in ((coronary(), VESSELS), (VESSELS, coronary()), (flow, VESSELS)):
        assert np.array_equal(physics_model.predict(*given).pressure, expected)
    both = physics_model.predict(VESSELS, [coronary(), coronary().scaled(0.5)])
    assert np.array_equal(both.pressure[0], expected[0])
    batches = physics_model.predict_batches(coronary(), VESSELS, batch=1)
    assert np.allclose(next(batches).pressure, expected[:1])


def test_a_vessel_and_a_waveform_bring_their_grid(physics_model):
    found = physics_model.predict(Vessel((Stenosis(0.5, 3.0),), length=6.0), coronary(0.8))
    assert found.z[-1] == 6.0
    assert found.period == 0.8
    assert found.z[found.area_undeformed.argmin()] == pytest.approx(3.0)
    finer = physics_model.predict(VESSELS[0], coronary(), z=np.linspace(0, 4, 81))
    assert finer.z.size == 81


def test_objects_on_a_model_of_one_grid(small_model):
    found = small_model.predict(VESSELS[0], coronary())
    assert np.array_equal(found.flow.shape, (1, 20, 21))
    with pytest.raises(InputError, match=r"The length is 6, but must be 4: "):
        small_model.predict(Vessel(length=6.0), coronary())
    with pytest.raises(InputError, match=r"The period is 0\.8, but must be 1: "):
        small_model.predict(VESSELS[0], coronary(0.8))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((VESSELS, [coronary(), coronary(0.8)]), r"period is 0\.8, but must be 1"),
        (([*VESSELS, Vessel(length=5)], coronary()), "length is 5, but must be 4"),
        (([*VESSELS, 3], coronary()), r"area_undeformed\[2\] must be a Vessel, got int"),
        ((coronary(),), "predict needs area_undeformed beside the inflow"),
        (("inflow.csv", VESSELS), r"inflow is the path 'inflow.csv': read the file"),
        ((pd.DataFrame({"time": [0.0], "q": 1.0}), VESSELS), r"pass one column, .* table\['q'\]"),
        ((coronary(), pd.DataFrame({"z": [0.0], "S": 1.0})), r"pass one column, .* table\['S'\]"),
        (
            (np.append(*[coronary().samples(32)] * 2)[:33], VESSELS),
            r"leave it out, inflow\[..., :-1\]",
        ),
    ],
)
def test_wrong_inputs(physics_model, given, message):
    with pytest.raises(InputError, match=message):
        physics_model.predict(*given)


def test_a_repeated_end(physics_model, small_model):
    flow = coronary().samples(32)
    closed = np.append(flow, flow[0])
    assert physics_model.predict(closed, VESSELS, period=1.0).time.size == 33
    assert physics_model.predict(np.full(33, 1.2), VESSELS).time.size == 33
    flow = coronary().samples(20)
    with pytest.raises(InputError, match="The last time point of the inflow repeats the first"):
        small_model.predict(np.append(flow, flow[0]), VESSELS[0])


def test_a_cycle_that_lacks_its_last_point(physics_model):
    flow = coronary().samples(32)
    for cut in (flow[:-1], flow[:-3], np.append(flow, flow[:2])):
        with pytest.raises(InputError, match=f"{len(cut)} time points, .* 32: give 32, or pass pe"):
            physics_model.predict(cut, VESSELS)
        assert physics_model.predict(cut, VESSELS, period=0.97).period == 0.97
    assert physics_model.predict(coronary().samples(64), VESSELS).time.size == 64


def test_a_period_in_milliseconds_is_found_for_a_steady_inflow(physics_model, physics_cases):
    """Its distance from the training data does not depend on the period."""
    inflow, area = physics_cases.inflow.mean(axis=1, keepdims=True), physics_cases.area_undeformed
    given = np.repeat(inflow, 32, axis=1)[:1], area[:1]
    assert physics_model.predict(*given, period=1.0).novelty < 1
    with pytest.raises(InputError, match=r"recording is 1000 s.*--units time=ms"):
        physics_model.predict(*given, period=1000.0)
    found = physics_model.predict(*given, period=1000.0, units={"time": "ms"})
    assert np.array_equal(found.time, np.arange(32) / 32)


def test_a_heart_rate_is_no_period(check):
    for time in (3.01, 60.0):
        with pytest.raises(InputError, match=rf"The period is {time:g} s.*not the heart rate"):
            check(time=time)
        assert check(time=time, units="time=s").grid.period == time
    assert check(time=3.0).grid.period == 3.0


def test_a_heart_rate_is_no_period_of_a_waveform(physics_model):
    with pytest.raises(InputError, match=r"recording is 75 s, usual are 0\.25 to 60"):
        physics_model.predict(VESSELS, coronary(75.0))
    assert physics_model.predict(VESSELS, coronary(75.0), units="time=s").period == 75.0


def test_several_cycles_are_no_cycle(physics_model, physics_cases):
    inflow, area = physics_cases.inflow[0], physics_cases.area_undeformed[0]
    for count in (2, 3):
        with pytest.raises(InputError, match=rf"itself {count} times: give one .* :32\]"):
            physics_model.predict(np.tile(inflow, count), area)
    assert physics_model.predict(np.tile(inflow, 2), area, period=2.0, units="cgs").period == 2.0


def test_an_ensemble_is_the_advice_where_there_are_no_samples(small_model, small_cases):
    with pytest.raises(InputError, match=r"fit an ensemble \(Ensemble.fit, pcnde fit --m"):
        small_model.predict(small_cases, samples=8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"config": "fast"}, "PCNDE needs a configuration and a Grid"),
        ({"grid": None}, "PCNDE needs a configuration and a Grid"),
        ({"engine": "fortran"}, "Unknown engine 'fortran'"),
        ({"parameters": None}, "NoneType do not belong to ClosureConfig: give ClosureParameters"),
    ],
)
def test_wrong_parts_of_a_model(physics_model, change, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(physics_model, **change)


def test_wrong_parts_of_an_ensemble(ensemble):
    with pytest.raises(InputError, match=r"Ensemble.members\[1\] must be a PCNDE, got int"):
        Ensemble([ensemble.members[0], 3], ensemble.calibration)
    with pytest.raises(InputError, match=r"Ensemble.calibration must be a Calibration"):
        Ensemble(ensemble.members, None)
    with pytest.raises(InputError, match=r"Change a preset by FAST.replace"):
        resolve_config({"flow": {"steps": 12}})
