"""Checks of the arrays of a data set: values, shapes, time and units."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers import case_arguments

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.errors import InputError


def changed(cases, name, place, value):
    array = np.array(getattr(cases, name))
    array[place] = value
    return Cases(**case_arguments(cases, **{name: array}))


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("flow", (3, 17, 20), np.nan, r"flow\[3, 17, 20\] is nan: all values must be finite$"),
        ("flow", (3, 17), np.inf, r"flow\[3, 17, 0\] is inf: .*; 21 values of flow are wrong"),
        ("pressure", (0, 0, 1), -np.inf, r"pressure\[0, 0, 1\] is -inf"),
        ("area", (11, 2, 5), -0.1, r"area\[11, 2, 5\] is -0\.1: areas must be positive"),
        ("area_undeformed", (2, 5), 0, r"area_undeformed\[2, 5\] is 0\.0: areas must be positive"),
        ("z", 4, 0.1, r"z\[4\] is 0\.1: z must be strictly increasing \(cm\)$"),
        ("time", 3, 0.16, r"time\[3\] is 0\.16: time must have uniform steps \(here 0\.05 s\)"),
        ("time", 3, np.nan, r"time\[3\] is nan"),
    ],
)
def test_refuses_wrong_values(small_cases, name, place, value, message):
    with pytest.raises(InputError, match=message):
        changed(small_cases, name, place, value)


@pytest.mark.parametrize("name", ["flow", "area", "pressure"])
@pytest.mark.parametrize(
    ("order", "found", "remedy"),
    [
        ((0, 2, 1), "(case, z, time)", (0, 2, 1)),
        ((1, 2, 0), "(time, z, case)", (2, 0, 1)),
        ((2, 0, 1), "(z, case, time)", (1, 2, 0)),
    ],
)
def test_names_a_wrong_axis_order(small_cases, name, order, found, remedy):
    right = getattr(small_cases, name)
    wrong = np.transpose(right, order)
    assert np.array_equal(np.transpose(wrong, remedy), right)
    with pytest.raises(InputError) as caught:
        Cases(**case_arguments(small_cases, **{name: wrong}))
    text = str(caught.value)
    assert text.startswith(f"{name} must have the shape (case, time, z) = (12, 20, 21), but ")
    assert text.endswith(f"; that looks like {found}: pass np.transpose({name}, {remedy})")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"flow": np.ones((12, 20, 20))}, r"flow must have .* = \(12, 20, 21\).* \(12, 20, 20\)$"),
        ({"flow": np.ones((20, 21))}, r"for a single case pass flow\[np\.newaxis\]"),
        ({"area_undeformed": np.ones(21)}, r"pass area_undeformed\[np\.newaxis\]"),
        (
            {"area_undeformed": np.ones((12, 20))},
            r"area_undeformed must have the shape \(case, z\)",
        ),
        ({"area_undeformed": np.ones((0, 21))}, "there is no case"),
        ({"area_undeformed": 1.0}, r"its shape is \(\)"),
        ({"time": np.ones((2, 10))}, r"time must have one axis, but its shape is \(2, 10\)"),
        ({"time": np.arange(3)}, "time has 3 values; at least 4 are needed"),
        ({"z": np.arange(2)}, "z has 2 values; at least 3 are needed"),
        ({"time": -np.arange(20)}, "time must increase"),
        ({"flow": np.ones((12, 20, 21), complex)}, "flow must hold real numbers.*complex128"),
        ({"flow": np.ones((12, 20, 21), bool)}, "flow must hold real numbers.*bool"),
        ({"flow": np.full((12, 20, 21), "1")}, "flow must hold real numbers"),
        ({"flow": np.ones((12, 20, 21), object)}, "flow must hold real numbers.*object"),
        ({"flow": [[1, 2], [3]]}, "flow is not a regular array"),
        (
            {"flow": np.ma.masked_less(np.zeros((12, 20, 21)), 1)},
            "flow has masked values",
        ),
        ({"period": "1"}, r"period must be a number \(s\), got '1'"),
        ({"period": True}, r"period must be a number \(s\)"),
        ({"period": np.nan}, r"period must be finite \(s\), got nan"),
        (
            {"period": 0.5},
            r"20 time points in steps of 0\.05 s give 1 s: time must cover",
        ),
        ({"period": 0.95}, "the last time point repeats the first, one period later; leave it out"),
        ({"period": 1.05}, "the last time point of the cycle is missing"),
    ],
)
def test_refuses_wrong_arguments(small_cases, changes, message):
    with pytest.raises(InputError, match=message):
        Cases(**case_arguments(small_cases, **changes))


def closed(array):
    return np.concatenate([array, array[:, :1]], axis=1)


def test_refuses_a_repeated_end_point_without_a_period(small_cases):
    given = case_arguments(small_cases, time=np.arange(21) / 20, period=None)
    given |= {name: closed(given[name]) for name in ("flow", "area", "pressure")}
    with pytest.raises(InputError, match=r"last time point repeats the first.*or pass period="):
        Cases(**given)
    steady = {name: np.repeat(given[name][:, :1], 21, axis=1) for name in ("flow", "area")}
    steady["pressure"] = np.repeat(given["pressure"][:, :1], 21, axis=1)
    assert Cases(**given | steady).period == pytest.approx(1.05)


def test_time_may_start_anywhere_and_be_stored_in_single_precision(small_cases):
    for time in (2.0 + small_cases.time, (3.0 + small_cases.time).astype(np.float32)):
        assert Cases(**case_arguments(small_cases, time=time)).period == 1.0


@pytest.mark.parametrize(
    ("name", "factor", "message"),
    [
        ("area_undeformed", 100, r"the area over the undeformed area is 0\.0105"),
        ("pressure", 1 / 1333.22, r"the mean pressure is .* with pressure in mmHg: pass units="),
        ("pressure", 1e3, "the mean pressure is .*every combination of known units"),
        ("pressure", -1, "the mean pressure is -.*relative to the surroundings"),
        ("flow", 60, "flow over area is .* with flow in mL/min"),
        ("flow", 1e-6, "flow over area is .* with flow in m"),
        ("flow", -1, "case 0: the flow runs against z.*Change its sign"),
        ("time", 1e3, "the length of the recording is .* with time in ms"),
    ],
)
def test_other_units_are_refused(small_cases, name, factor, message):
    changes = {name: factor * getattr(small_cases, name), "period": None}
    with pytest.raises(InputError, match=message):
        Cases(**case_arguments(small_cases, **changes))
    if "runs against z" not in message:
        with pytest.warns(UnitsWarning, match=message):
            Cases(**case_arguments(small_cases, **changes), check=False)


@pytest.mark.parametrize(("factor", "unit"), [(100, r"mm\^2"), (1e-4, r"m\^2")])
def test_areas_in_other_units_are_refused(small_cases, factor, unit):
    both = {name: factor * getattr(small_cases, name) for name in ("area", "area_undeformed")}
    with pytest.raises(InputError, match=f"does not look like CGS.* with area in {unit}"):
        Cases(**case_arguments(small_cases, **both))


def test_damaged_samples_and_signs_are_refused(sheared_cases):
    """One absurd sample, or a wall shear stress against the flow."""
    for name in ("flow", "area", "pressure", "wall_shear_stress"):
        array = np.array(getattr(sheared_cases, name))
        array[1, 7, 3] *= 3
        with pytest.raises(InputError, match=rf"case 1: {name} is .* at 0\.35 s .*point 3"):
            Cases(**case_arguments(sheared_cases, **{name: array}))
        Cases(**case_arguments(sheared_cases, **{name: array}), check=False)
    negative = -np.abs(sheared_cases.wall_shear_stress)
    with pytest.raises(InputError, match="case 0: the wall shear stress points against the flow"):
        Cases(**case_arguments(sheared_cases, wall_shear_stress=negative))


def test_usual_values_do_not_warn(small_cases):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Cases(**case_arguments(small_cases))
        Cases(**case_arguments(small_cases, flow=np.zeros(small_cases.flow.shape)))
