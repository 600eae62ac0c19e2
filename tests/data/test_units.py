"""Statements of units: systems, quantities, and radii or diameters in place of areas."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge.data.units import SYSTEMS, in_cgs, option_of, stated_units, text_of
from pcnde_bridge.errors import InputError


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        (None, {}),
        ("si", SYSTEMS["si"]),
        ("z=mm,time=ms", {"z": "mm", "time": "ms"}),
        ({"radius": "mm"}, {"area": "mm^2", "shape": "radius"}),
        ({"diameter": "cm", "z": "mm"}, {"area": "cm^2", "shape": "diameter", "z": "mm"}),
        ("cgs,area=cm^2", {**SYSTEMS["cgs"], "shape": "area"}),
        ("CGS, area=cm2", {**SYSTEMS["cgs"], "shape": "area"}),
        ({"flow": "ml/min", "pressure": "dyn/cm²"}, {"flow": "mL/min", "pressure": "dyn/cm^2"}),
        ("mm-g-s,radius=m", {**SYSTEMS["mm-g-s"], "area": "m^2", "shape": "radius"}),
    ],
)
def test_statements(units, expected):
    assert stated_units(units) == expected
    assert stated_units(text_of(expected) or None) == expected


def test_an_option_keeps_what_is_stated():
    stated = stated_units("mm-g-s,flow=L/min")
    assert option_of(stated, "pressure", "kPa") == "--units mm-g-s,flow=L/min,pressure=kPa"
    radii = "--units mm-g-s,flow=L/min,radius=cm for radii, or --units mm-g-s,flow=L/min,diameter="
    assert option_of(stated, "area", "cm") == f"{radii}cm for diameters"
    assert option_of(stated, "area", "cm^2") == "--units mm-g-s,flow=L/min,area=cm^2"
    assert option_of({"z": "", "flow": "L/min"}, "time", "ms")[8:] == ("flow=L/min,time=ms")
    assert text_of({"flow": "L/min"}, "cgs") == "cgs,flow=L/min"


@pytest.mark.parametrize(
    ("units", "area"),
    [
        ({}, 2.0),
        ("area=mm^2", 0.02),
        ("radius=mm", 0.04 * np.pi),
        ("radius=cm", 4 * np.pi),
        ("diameter=mm", 0.01 * np.pi),
        ("diameter=m", 1e4 * np.pi),
    ],
)
def test_a_circle_of_two(units, area):
    assert in_cgs("area", 2.0, stated_units(units)) == pytest.approx(area, rel=1e-14)


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ({"radius": "mm", "area": "mm^2"}, "names radius and area: an area has one unit"),
        ("cgs,diameter=mm,radius=mm", "names diameter and radius"),
        ({"radius": "mm^2"}, r"Unknown unit 'mm\^2' of radius; known are \['cm', 'mm', 'm'\]"),
        ("cgs,flow", "must look like flow="),
        ("pressure=Pa,pressure=mmHg", "names pressure twice"),
        ("inches", "Unknown units 'inches'; give one of"),
        ("thickness=mm", "units names 'thickness'; it can name .*'diameter'"),
    ],
)
def test_statements_that_are_refused(units, message):
    with pytest.raises(InputError, match=message):
        stated_units(units)
