"""Plausibility of vessels: every mix of units is refused or read right; flow along a vessel."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pcnde_bridge.data.plausibility import (
    CONVERT,
    OPTION,
    check_flow,
    check_units,
    input_sizes,
    sizes_of,
)
from pcnde_bridge.data.units import FACTORS, SYSTEMS, factors_to_cgs
from pcnde_bridge.errors import InputError


def artery(diameter, speed, slenderness, period, pressure, n_times=16, rigid=False, shear=1.0):
    """An artery in CGS units whose volume is conserved: pulses that grow along it.

    Its wall shear stress is ``shear`` times Poiseuille's; None: it has none.
    """
    time, z = np.arange(n_times) / n_times * period, np.linspace(0, slenderness * diameter, 7)
    undeformed = np.full(7, np.pi / 4 * diameter**2)
    angle = 2 * np.pi * np.arange(n_times) / n_times
    strain = 1.05 + (0.0 if rigid else 0.03) * np.cos(angle)
    area = strain[:, None] * undeformed
    flow = speed * undeformed[0] * (1 + 0.5 * np.sin(angle))[:, None] * np.ones(7)
    growth = np.gradient(area, time, axis=0)
    growth -= growth.mean(axis=0)
    flow = flow - growth * z
    pressures = pressure * (1 + 0.2 * np.cos(angle))[:, None] * np.ones(7)
    fields = {
        "flow": flow[None],
        "area": area[None],
        "pressure": pressures[None],
        "area_undeformed": undeformed[None],
        "time": time,
        "z": z,
    }
    if shear is None:
        return fields
    stress = shear * 4 * 0.04 * flow / (np.pi * (diameter / 2) ** 3)
    return {**fields, "wall_shear_stress": stress[None]}


arteries = st.builds(
    artery,
    st.floats(0.1, 3.5),
    st.floats(3, 80),
    st.floats(4, 80),
    st.floats(0.35, 2.0),
    st.floats(5e4, 2e5),
    rigid=st.booleans(),
    shear=st.none() | st.floats(0.4, 2.5),
)
mixes = st.fixed_dictionaries(
    {name: st.sampled_from(list(units)) for name, units in FACTORS.items()}
)


def in_units(fields, units):
    factors = factors_to_cgs(units)
    factors["area_undeformed"] = factors["area"]
    return {name: values / factors[name] for name, values in fields.items()}


def stated_in(message):
    """The units that a message suggests, or None."""
    found = re.search(r"\(--units (\S+)\)\, or", message)
    if found is None:
        return None
    if found[1] in SYSTEMS:
        return SYSTEMS[found[1]]
    return dict(part.split("=") for part in found[1].split(","))


@settings(max_examples=10 * settings().max_examples)
@given(fields=arteries, units=mixes, whole=st.booleans())
def test_every_mix_of_units_is_refused_or_right(fields, units, whole):
    """Following the advice leads to the vessel itself, or to another refusal."""

    def sizes(fields):
        if whole:
            return sizes_of(**fields)
        length, period = np.ptp(fields["z"]), np.ptp(fields["time"])
        return input_sizes(fields["flow"], fields["area_undeformed"], length, period)

    try:
        check_units(sizes(fields), (), CONVERT)
    except InputError:
        assume(False)  # not an artery of the table's ranges
    measured = [name for name in FACTORS if whole or name in ("flow", "area", "z", "time")]
    given = in_units(fields, {name: units[name] for name in measured})
    try:
        check_units(sizes(given), (), OPTION, unique=True)
    except InputError as error:
        stated = stated_in(str(error))
        if stated is None:
            return
        factors = factors_to_cgs(stated)
        factors["area_undeformed"] = factors["area"]
        given = {name: factors[name] * values for name, values in given.items()}
        try:
            check_units(sizes(given), stated, OPTION, unique=True)
        except InputError:
            return
    for name, values in fields.items():
        if whole or name in ("flow", "area_undeformed", "z", "time"):
            np.testing.assert_allclose(given[name], values, rtol=1e-12)


@pytest.mark.parametrize(
    ("diameter", "flow", "length", "pressure"),
    [
        (2.4, 90.0, 24.1, 1.3e5),  # thoracic aorta
        (1.7, 8.0, 8.6, 1.3e5),  # abdominal aorta
        (0.6, 6.5, 12.6, 1.3e5),  # common carotid
        (0.3, 1.0, 10.0, 1.2e5),  # left anterior descending coronary
        (0.25, 0.4, 23.0, 1.2e5),  # radial
        (0.1, 0.04, 2.0, 9e4),  # digital
    ],
)
def test_arteries_are_usual(diameter, flow, length, pressure):
    speed = flow / (np.pi / 4 * diameter**2)
    fields = artery(diameter, speed, length / diameter, 0.9, pressure)
    check_units(sizes_of(**fields), (), CONVERT)


def test_the_volume_balance_tells_lengths_apart():
    """An artery in mm³/s, mm² and mm is another artery in CGS units unless it is compared."""
    fields = artery(0.4, 10.0, 33.0, 1.0, 1.3e5)
    check_units(sizes_of(**fields), (), OPTION, unique=True)
    rigid = artery(0.4, 10.0, 33.0, 1.0, 1.3e5, rigid=True)
    with pytest.raises(InputError, match=r"ambiguous: .* in CGS units, and with z in mm"):
        check_units(sizes_of(**rigid), (), OPTION, unique=True)
    check_units(sizes_of(**rigid), ("z",), OPTION, unique=True)


def along(change):
    flow = (1.2 + np.sin(2 * np.pi * np.arange(12) / 12))[:, None] * np.ones(12)
    area = np.full((12, 12), 0.1) * (1 - 0.5 * np.exp(-((np.arange(12) - 6.0) ** 2)))
    return change(flow, area), area, np.arange(12.0)


def half(flow, area):
    return np.where(np.arange(12) > 7, 0.5, 1.0) * flow


def caps(flow, area):
    return np.where(np.isin(np.arange(12), (0, 11)), 0.0, flow)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (half, r"but 0\\.6 mL/s at z = 8 cm \\(point 8\\).*Leave out branches"),
        (caps, "but 0 mL/s at z = 0 cm.*ends alone: leave out the end points"),
        (lambda flow, area: flow / area, "these are velocities: flow × area is constant"),
        (
            lambda flow, area: np.where(np.arange(12) > 7, -flow, flow),
            "Its sign seems to change",
        ),
        (lambda flow, area: flow.T, r"look transposed.*np\\.swapaxes"),
        (lambda flow, area: -flow, "runs against z.*turn it"),
    ],
)
def test_flow_that_is_not_that_of_one_vessel(change, message):
    with pytest.raises(InputError, match=message.replace("\\\\", "\\")):
        check_flow(*along(change), "Please turn it.")


def test_flow_that_averaging_leaves():
    check_flow(*along(lambda flow, area: np.linspace(1, 0.97, 12) * flow), "")
    check_flow(*along(lambda flow, area: 0 * flow), "")


def test_units_are_all_tried():
    """Each pair of units of two quantities is told from CGS units."""
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    for one, other in itertools.combinations(FACTORS, 2):
        for units in itertools.product(FACTORS[one].items(), FACTORS[other].items()):
            if all(factor == 1 for _, factor in units):
                continue
            mix = {one: units[0][0], other: units[1][0]}
            with pytest.raises(InputError, match="CGS"):
                check_units(sizes_of(**in_units(fields, mix)), (), OPTION, unique=True)
