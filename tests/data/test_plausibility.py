"""Plausibility of vessels: every mix of units, radii and diameters is refused or read right."""

from __future__ import annotations

import itertools
import re

import h5py
import numpy as np
import pytest
from helpers import artery
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.plausibility import check_units, sizes_of
from pcnde_bridge.data.units import FACTORS, SHAPES, SYSTEMS, in_cgs, stated_units
from pcnde_bridge.errors import InputError
from pcnde_bridge.io import read_hdf5
from pcnde_bridge.model.inputs import check_plausible, inputs_from_arrays


def is_usual(fields):
    """Whether an artery is within the ranges of the package."""
    try:
        check_units(sizes_of(**fields), {})
    except InputError:
        return False
    return True


arteries = st.builds(
    artery,
    st.floats(0.1, 3.5),
    st.floats(3, 80),
    st.floats(4, 80),
    st.floats(0.35, 2.0),
    st.floats(5e4, 2e5),
    rigid=st.booleans(),
    drop=st.booleans(),
    shear=st.none() | st.floats(0.4, 2.5),
).filter(is_usual)
mixes = st.fixed_dictionaries(
    {name: st.sampled_from(list(units)) for name, units in FACTORS.items()}
    | {"shape": st.sampled_from(list(SHAPES))}
)
told = st.sets(st.sampled_from(list(FACTORS)))
"""Quantities whose units the user states from the start."""

CGS = SYSTEMS["cgs"]
STATED = {**CGS, "shape": "area"}


def in_units(fields, units):
    """A vessel as a file holds it, in some units, with some shape in place of areas."""
    found = dict(fields)
    for name in (*FACTORS, "area_undeformed"):
        if name in fields:
            quantity = "area" if name == "area_undeformed" else name
            found[name] = fields[name] / FACTORS[quantity][units.get(quantity, CGS[quantity])]
    if (shape := units.get("shape", "area")) != "area":
        for name in ("area", "area_undeformed"):
            found[name] = np.sqrt(found[name] / SHAPES[shape])
    return found


def known_of(units, names):
    """The units of some quantities as a user states them."""
    stated = {name: units[name] for name in names}
    if "area" in names and units["shape"] != "area":
        stated[units["shape"]] = stated.pop("area").removesuffix("^2")
    return stated


def read_again(read, known):
    """The result of a reader, after following its advice; None if the reader refuses.

    The advice contains all units that are stated already.
    """
    try:
        return read(known)
    except InputError as error:
        advice = re.findall(r"--units ([^\s,)]+(?:,[^\s,)…]+)*)", str(error))
        follow = re.search(r"\(--units (\S+)\)\, or", str(error))
    for text in advice:
        stated = stated_units(text)
        assert {**stated, **stated_units(known), "shape": ""} == {**stated, "shape": ""}
    try:
        return None if follow is None else read(follow[1])
    except InputError:
        return None


@settings(max_examples=5 * settings().max_examples, suppress_health_check=[*HealthCheck])
@given(fields=arteries, units=mixes, names=told)
def test_a_file_in_any_mix_of_units_is_refused_or_right(fields, units, names, tmp_path):
    """Following the advice leads to the vessel itself, or to another refusal.

    The file may hold radii or diameters in place of areas.
    """
    path = tmp_path / "vessel.h5"
    with h5py.File(path, "w") as file:
        for name, values in in_units(fields, units).items():
            file[name] = values
    known = known_of(units, names)
    found = read_again(lambda stated: read_hdf5(path, units=stated), known)
    event(f"refused: {found is None}, area known: {'area' in names}")
    for name, values in fields.items() if found is not None else ():
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-12)


@settings(max_examples=5 * settings().max_examples)
@given(fields=arteries, units=mixes, names=told, alone=st.booleans())
def test_a_prediction_in_any_mix_of_units_is_refused_or_right(fields, units, names, alone):
    """If ``alone``, points and period are those of the training."""
    period, flow = fields["time"][-1] * 16 / 15, fields["flow"][:, :, 0]
    trained = Grid(fields["time"], fields["z"], period)
    given = in_units(fields, units)
    where = {} if alone else {"z": given["z"], "period": period / FACTORS["time"][units["time"]]}

    def read(stated):
        arrays = given["flow"][:, :, 0], given["area_undeformed"]
        found = inputs_from_arrays(trained, True, *arrays, **where, units=stated)
        check_plausible(found, np.array([True]), None)
        return found

    found = read_again(read, known_of(units, names))
    event(f"refused: {found is None}, area known: {'area' in names}")
    if found is not None:
        expected = flow, fields["area_undeformed"], fields["z"], period
        numbers = found.inflow, found.area_undeformed, found.grid.z, found.grid.period
        for one, other in zip(numbers, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)


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
    check_units(sizes_of(**fields), {})


def test_the_volume_balance_tells_lengths_apart():
    """An artery in mm³/s, mm² and mm is another artery in CGS units unless it is compared."""
    fields, area = artery(0.4, 10.0, 33.0, 1.0, 1.3e5, drop=False), stated_units({"area": "cm^2"})
    check_units(sizes_of(**fields), area, unique=True)
    rigid = artery(0.4, 10.0, 33.0, 1.0, 1.3e5, rigid=True, drop=False)
    with pytest.raises(InputError, match=r"ambiguous: .* in CGS units, and with z in mm"):
        check_units(sizes_of(**rigid), area, unique=True)
    check_units(sizes_of(**rigid), {"z": "cm", **area}, unique=True)


@pytest.mark.parametrize(("name", "factor"), [("z", 10), ("flow", 60), ("flow", 0.06)])
@pytest.mark.parametrize("diameter", [0.15, 0.4, 0.6, 2.0])
def test_rigid_walls_in_other_units_are_refused(diameter, name, factor):
    """Pressures that accelerate the flow settle it; without such pressures it is ambiguous."""
    fields = artery(diameter, 20.0, 10.0, 0.9, 1.2e5, rigid=True, shear=None)
    Cases(**fields, units={"area": "cm^2"})
    other = {**fields, name: factor * fields[name]}
    with pytest.raises(InputError, match=r"look like CGS.*: (pass units=|state the units)"):
        Cases(**other)
    check_units(sizes_of(**fields), STATED)
    with pytest.raises(InputError, match=r"with the stated units .* possible are"):
        check_units(sizes_of(**other), STATED)
    still = artery(diameter, 20.0, 10.0, 0.9, 1.2e5, rigid=True, shear=None, drop=False)
    with pytest.raises(InputError, match=r"look like CGS|ambiguous"):
        Cases(**{**still, name: factor * still[name]})


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("diameter", [0.15, 0.3, 0.4, 2.5, 3.0])
@pytest.mark.parametrize("factor", [1, 2])
def test_radii_and_diameters_in_place_of_areas_are_refused(diameter, rigid, factor):
    fields = artery(diameter, 20.0, 10.0, 0.9, 1.2e5, rigid=rigid, shear=None)
    Cases(**fields)
    for name in ("area", "area_undeformed"):
        fields[name] = factor * np.sqrt(fields[name] / np.pi)
    with pytest.raises(InputError, match=r"CGS units"):
        Cases(**fields)


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("shape", ["radius", "diameter"])
@pytest.mark.parametrize("diameter", [0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8])
def test_radii_of_half_a_centimeter_are_refused_unless_stated(diameter, shape, rigid, tmp_path):
    """Their numbers nearly are those of the areas."""
    fields = artery(diameter, 20.0, 10.0, 0.9, 1.2e5, rigid=rigid, shear=None)
    for side in ("cm", "mm"):
        given = in_units(fields, {"area": f"{side}^2", "shape": shape})
        for units in (None, "cgs"):
            with pytest.raises(InputError, match=rf"{shape} in {side}|radii or diameters in place"):
                Cases(**given, units=units)
        with h5py.File(tmp_path / "vessel.h5", "w") as file:
            for name, values in given.items():
                file[name] = values
        with pytest.raises(InputError, match=rf"{shape} in {side}"):
            read_hdf5(tmp_path / "vessel.h5")
        for units in ({shape: side}, f"cgs,{shape}={side}"):
            found = read_hdf5(tmp_path / "vessel.h5", units=units)
            np.testing.assert_allclose(found.area, fields["area"], rtol=1e-12)
            np.testing.assert_allclose(Cases(**given, units=units).area, found.area, rtol=1e-12)
    Cases(**fields, units={"area": "cm^2"})


@pytest.mark.data
@pytest.mark.parametrize("every", [1, 2, 5, 10])
@pytest.mark.parametrize("shape", SHAPES)
def test_each_published_case_is_told_from_its_radii(published_cases, shape, every):
    """Without the wall shear stress, and with few time points."""
    names = ("flow", "area", "pressure", "area_undeformed")
    for case in published_cases:
        fields = {name: np.array(getattr(case, name)) for name in names}
        fields |= {name: fields[name][:, ::every] for name in names[:3]}
        fields |= {"time": case.time[::every], "z": case.z}
        given = in_units(fields, {"shape": shape})
        for units in (None, "cgs"):
            if shape == "area":
                assert np.array_equal(Cases(**given, units=units).area, fields["area"])
                check_units(sizes_of(**given), stated_units(units), unique=True)
            else:
                with pytest.raises(InputError, match=rf"{shape} in cm|radii or diameters in pla"):
                    Cases(**given, units=units)


def test_undeformed_areas_that_do_not_go_with_the_areas_are_refused():
    """Such as those of another vessel, or from the outlet to the inlet."""
    fields = artery(0.4, 20.0, 10.0, 0.9, 1.2e5, shear=None, drop=False)
    taper = np.linspace(1, 0.4, 7)
    fields |= {name: taper * fields[name] for name in ("area", "area_undeformed")}
    fields["flow"] = fields["flow"][..., :1] * np.ones(7)
    Cases(**fields, check=False)
    check_units(sizes_of(**fields), STATED, unique=True)
    fields["area_undeformed"] = fields["area_undeformed"][:, ::-1]
    for stated in ({}, STATED):
        with pytest.raises(
            InputError, match=r"these ratios along the vessel over the smallest is 6\.25"
        ):
            check_units(sizes_of(**fields), stated)


@pytest.mark.parametrize("factor", [0.5, 2])
def test_half_and_twice_the_flow_are_refused(factor):
    """The growth of the volume alone does not tell."""
    fields = artery(0.4, 20.0, 10.0, 0.9, 1.2e5, shear=None)
    with pytest.raises(InputError, match=r"CGS units.* the density by pressures and accelerations"):
        Cases(**{**fields, "flow": factor * fields["flow"]})
    fields = artery(0.4, 20.0, 10.0, 0.9, 1.2e5, shear=None, drop=False)
    Cases(**{**fields, "flow": factor * fields["flow"]}, units={"area": "cm^2"})


def test_cases_that_are_ambiguous_are_refused():
    fields = artery(0.3, 14.0, 33.0, 0.9, 1.2e5, rigid=True, shear=None, drop=False)
    message = "ambiguous: .*, and with z in mm, or .*radius in cm: state the units .*; if they are"
    with pytest.raises(InputError, match=rf"{message} CGS, pass units='cgs,area=cm\^2' \("):
        Cases(**fields)
    with pytest.raises(
        InputError,
        match=r"with z in mm: .*area=cm\^2,…\); if the others are CGS, pass units='cgs,area=cm\^2'",
    ):
        Cases(**fields, units={"area": "cm^2"})
    with pytest.raises(InputError, match=r"in CGS units, and with radius in cm: state the units"):
        Cases(**fields, units="cgs")
    for stated in ("cgs,area=cm^2", {"area": "cm^2", "z": "cm"}):
        assert np.array_equal(Cases(**fields, units=stated).area, fields["area"])
    Cases(**fields, check=False)


def test_units_are_all_tried():
    """Each pair of units of two quantities is told from CGS units."""
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    for one, other in itertools.combinations(FACTORS, 2):
        for units in itertools.product(FACTORS[one].items(), FACTORS[other].items()):
            if all(factor == 1 for _, factor in units):
                continue
            mix = {one: units[0][0], other: units[1][0]}
            with pytest.raises(InputError, match="CGS"):
                check_units(sizes_of(**in_units(fields, mix)), {}, unique=True)


@pytest.mark.parametrize("name", FACTORS)
def test_a_wrongly_stated_unit_is_refused(name):
    """An elastic artery in CGS units, one of which is stated wrongly."""
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    check_units(sizes_of(**fields), STATED)
    arrays = {name, "area_undeformed"} if name == "area" else {name}
    for factor in FACTORS[name].values():
        read = {n: factor * v if n in arrays else v for n, v in fields.items()}
        if factor != 1:
            with pytest.raises(InputError, match=r"with the stated units .* possible are"):
                check_units(sizes_of(**read), STATED)


@pytest.mark.parametrize("shear", [0.35, 1.0, 3.0])
def test_a_wall_shear_stress_in_pascal_is_refused(shear):
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5, shear=shear)
    check_units(sizes_of(**fields), {}, unique=True)
    fields["wall_shear_stress"] /= 10
    with pytest.raises(InputError, match=r"Pa: pass units='wall_shear_stress=Pa' \("):
        check_units(sizes_of(**fields), {}, unique=True)
    with pytest.raises(InputError, match=r"in Pa: pass units="):
        Cases(**fields)
    with pytest.raises(InputError, match=r"with the stated units the wall shear stress over"):
        check_units(sizes_of(**fields), STATED)


@pytest.mark.parametrize(("real", "stated"), itertools.permutations(SYSTEMS, 2))
def test_a_wrongly_stated_system_is_refused(real, stated):
    fields = artery(0.4, 20.0, 10.0, 1.0, 1.3e5)
    read = {
        n: in_cgs("area" if n == "area_undeformed" else n, v, SYSTEMS[stated])
        for n, v in in_units(fields, SYSTEMS[real]).items()
    }
    with pytest.raises(InputError, match=r"with the stated units .* possible are"):
        check_units(sizes_of(**read), STATED)


def test_units_that_are_stated_may_be_unusual():
    """Start-up cycles need not balance; pressures may be relative to that of the outlet."""
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5, shear=None)
    check_units(sizes_of(**{**fields, "pressure": fields["pressure"] - 1.3e5}), STATED)
    fast = sizes_of(**{**fields, "flow": 5 * fields["flow"]})
    check_units(fast, STATED, unique=True, start=True)
    with pytest.raises(InputError, match="inflow less outflow"):
        check_units(fast, STATED)


def test_a_factor_of_the_flow_is_found():
    """Three times the flow does not go with the growth of the volume."""
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    check_units(sizes_of(**fields), {})
    fields.pop("wall_shear_stress")
    Cases(**fields)
    for factor in (1 / 4, 3.0):
        with pytest.raises(
            InputError, match=rf"growth of the volume is {factor:g}[.0-9]*, usual are"
        ):
            Cases(**{**fields, "flow": factor * fields["flow"]})
