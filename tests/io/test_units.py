"""Units of other programs' results."""

from __future__ import annotations

import numpy as np
import pytest
from io_helpers import replaced

from pcnde_bridge import InputError, UnitsWarning
from pcnde_bridge.data.units import FACTORS
from pcnde_bridge.data.variables import FIELDS
from pcnde_bridge.io import to_cases


@pytest.fixture
def vessel(sheared_vessel):
    return sheared_vessel


@pytest.mark.parametrize(
    ("units", "factors"),
    [
        ({"pressure": "mmHg"}, {"pressure": 1 / 1333.22}),
        ({"pressure": "kPa", "z": "mm"}, {"pressure": 1e-4, "z": 10}),
        ({"flow": "L/min"}, {"flow": 0.06}),
        ({"time": "ms"}, {"time": 1e3}),
        (
            "mm-g-s",
            {"flow": 1e3, "area": 100, "area_undeformed": 100, "pressure": 0.1, "z": 10}
            | {"wall_shear_stress": 0.1},
        ),
        (
            "si",
            {"flow": 1e-6, "area": 1e-4, "area_undeformed": 1e-4, "pressure": 0.1, "z": 0.01}
            | {"wall_shear_stress": 0.1},
        ),
    ],
)
def test_other_units_are_refused_unless_they_are_stated(vessel, units, factors):
    other = replaced(vessel, **{name: f * getattr(vessel, name) for name, f in factors.items()})
    with pytest.raises(InputError, match=r"does not look like CGS units.*--units") as caught:
        to_cases([other])
    if isinstance(units, dict):
        listed = ", ".join(f"{name} in {units[name]}" for name in FACTORS if name in units)
        assert f"with {listed}" in str(caught.value)
        # Where it is stated that areas are areas, only one mix of the other units is usual.
        area, others = units.get("area", "cm^2"), {**units}
        others.pop("area", None)
        if others:
            with pytest.raises(InputError) as caught:
                to_cases([other], units={"area": area})
            advice = ",".join(f"{name}={others[name]}" for name in FACTORS if name in others)
            assert f"--units area={area},{advice})" in str(caught.value)
    found = to_cases([other], units=units)
    expected = to_cases([vessel])
    for name in (*FIELDS, "area_undeformed", "time", "z"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12)


IN_CGS = {
    ("flow", "mL/s"): 1,
    ("flow", "cm^3/s"): 1,
    ("flow", "mm^3/s"): 0.001,
    ("flow", "m^3/s"): 1_000_000,
    ("flow", "mL/min"): 0.016666666666666667,
    ("flow", "L/min"): 16.666666666666667,
    ("area", "cm^2"): 1,
    ("area", "mm^2"): 0.01,
    ("area", "m^2"): 10_000,
    ("pressure", "dyn/cm^2"): 1,
    ("pressure", "Pa"): 10,
    ("pressure", "kPa"): 10_000,
    ("pressure", "mmHg"): 1333.22,
    ("wall_shear_stress", "dyn/cm^2"): 1,
    ("wall_shear_stress", "Pa"): 10,
    ("z", "cm"): 1,
    ("z", "mm"): 0.1,
    ("z", "m"): 100,
    ("time", "s"): 1,
    ("time", "ms"): 0.001,
}
"""Value of one of each unit in mL/s, cm², dyn/cm², cm or s."""


def test_the_factor_of_every_unit_is_tested():
    assert {(name, unit) for name, units in FACTORS.items() for unit in units} == set(IN_CGS)


@pytest.mark.parametrize(("name", "unit"), IN_CGS)
def test_every_unit(vessel, name, unit):
    of_it = (name, "area_undeformed") if name == "area" else (name,)
    other = {array: getattr(vessel, array) / IN_CGS[name, unit] for array in of_it}
    found, expected = to_cases([replaced(vessel, **other)], units={name: unit}), to_cases([vessel])
    for array in (*FIELDS, "area_undeformed", "time", "z"):
        np.testing.assert_allclose(getattr(found, array), getattr(expected, array), rtol=1e-12)
    assert found.period == pytest.approx(expected.period, rel=1e-12)


@pytest.mark.parametrize("name", [*FIELDS, "z"])
def test_what_is_off_by_a_thousand_is_refused(vessel, name):
    for factor in (1e3, 1e-3):
        with pytest.raises(InputError, match="does not look like CGS units"):
            to_cases([replaced(vessel, **{name: factor * getattr(vessel, name)})])


def test_units_that_do_not_go_together_are_refused(vessel):
    """4 cm and 40 mm are both lengths of vessels, but not of this diameter."""
    long = replaced(vessel, z=10 * vessel.z)
    with pytest.raises(InputError, match=r"length over the diameter is 10.*units='z=mm' \("):
        to_cases([long])
    assert to_cases([long], units={"z": "mm"}).z[-1] == pytest.approx(4.0)
    small = replaced(vessel, flow=vessel.flow / 60, wall_shear_stress=None)
    with pytest.raises(InputError, match=r"flow over area is .*--units flow="):
        to_cases([small])
    with pytest.raises(InputError, match=r"area over the undeformed area is 0\.0105"):
        to_cases([replaced(vessel, area=vessel.area / 100)])


def test_units_cgs_says_that_unusual_numbers_are_right(vessel):
    low = replaced(vessel, pressure=vessel.pressure / 1333.22)
    with pytest.warns(UnitsWarning):
        found = to_cases([low], units="cgs")
    assert np.array_equal(found.pressure[0], low.pressure)


def test_units_that_the_file_states_count(vessel):
    low = replaced(vessel, pressure=vessel.pressure / 1333.22, units={"pressure": "mmHg"})
    np.testing.assert_allclose(to_cases([low]).pressure[0], vessel.pressure)
