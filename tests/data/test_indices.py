"""Pressure drop, FFR and other quantities on arrays that can be checked by hand."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers import case_arguments

from pcnde_bridge import Cases, InputError, PCNDEWarning
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.data.indices import reynolds_number
from pcnde_bridge.data.stenosis import check_length, ends, measuring_positions
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel

TIME, Z = np.arange(4) / 4, np.linspace(0.0, 4.0, 5)
MMHG = 1333.22


def vessels(pressure, area_undeformed=None, flow=None) -> Cases:
    """Two cases of 4 time points and 5 points."""
    shape = (2, 4, 5)
    s_u = np.full((2, 5), 0.125) if area_undeformed is None else np.asarray(area_undeformed)
    area = np.repeat(s_u[:, None, :], 4, axis=1)
    flow = np.full(shape, 2.0) if flow is None else flow
    given = flow, area, np.broadcast_to(pressure, shape), s_u, TIME, Z
    return Cases(*given, units={"area": "cm^2", "flow": "mL/s", "z": "cm"})


@pytest.fixture
def cases() -> Cases:
    """Pressure p(t, z) = 1e5·(1 + t) − 1e4·(1 + t)·z in both cases; a straight tube."""
    return vessels(1e5 * (1 + TIME[:, None]) - 1e4 * (1 + TIME[:, None]) * Z)


def test_drop_between_and_on_points(cases):
    drop = cases.pressure_drop(1.0, 3.0)
    np.testing.assert_allclose(drop, np.tile(2e4 * (1 + TIME), (2, 1)), rtol=1e-14)
    assert np.array_equal(drop, cases.pressure[:, :, 1] - cases.pressure[:, :, 3])
    between = cases.pressure_drop(0.25, 3.5)
    np.testing.assert_allclose(between, np.tile(3.25e4 * (1 + TIME), (2, 1)), rtol=1e-14)


def test_drop_in_mmhg(cases):
    drop, millimeters = cases.pressure_drop(1, 3), cases.pressure_drop(1, 3, units="mmHg")
    np.testing.assert_allclose(MMHG * millimeters, drop, rtol=1e-15)


def test_positions_of_each_case(cases):
    drop = cases.pressure_drop([0.0, 1.0], [1.0, 4.0])
    np.testing.assert_allclose(drop[:, 0], [1e4, 3e4], rtol=1e-14)


def test_ffr_is_the_ratio_of_means_and_not_the_mean_of_ratios():
    upstream, downstream = np.array([100.0, 60, 80, 60]), np.array([50.0, 60, 40, 60])
    pressure = np.repeat(1e3 * upstream[:, None], 5, axis=1)
    pressure[:, 3:] = 1e3 * downstream[:, None]
    cases = vessels(pressure)
    assert cases.ffr() == pytest.approx(210 / 300, rel=1e-15)
    ratio = cases.pressure_ratio()
    np.testing.assert_allclose(ratio[0], [0.5, 1, 0.5, 1], rtol=1e-15)
    assert ratio.mean() != pytest.approx(0.7)


def test_velocity_reynolds_resistance_and_poiseuille():
    s_u = np.full((2, 5), np.pi * 0.04)
    flow = np.broadcast_to(np.array([1.0, 2.0, 3.0, 2.0])[:, None], (2, 4, 5))
    cases = vessels(1e5 - 1e3 * Z, s_u, flow)
    speed = flow / (np.pi * 0.04)
    np.testing.assert_allclose(cases.velocity(), speed, rtol=1e-14)
    np.testing.assert_allclose(cases.reynolds(), 1.06 * speed * 0.4 / 0.04, rtol=1e-14)
    np.testing.assert_allclose(cases.reynolds(1.0, 0.03), speed * 0.4 / 0.03, rtol=1e-14)
    assert cases.stenosis_resistance(1, 3) == pytest.approx(2e3 / 2, rel=1e-14)
    stress = cases.poiseuille_wall_shear_stress()
    np.testing.assert_allclose(stress, 4 * 0.04 * flow / (np.pi * 0.008), rtol=1e-14)


def test_reynolds_number():
    area = np.pi * 0.04
    assert reynolds_number(-2.0, area) == pytest.approx(1.06 * 2 * 0.4 / (area * 0.04), rel=1e-13)


def test_indices_by_hand():
    pressure = 1e5 - np.array([1.0, 2.0, 6.0, 3.0])[:, None] * 1e3 * (Z > 2)
    flow = np.broadcast_to(np.array([1.0, 2.0, 4.0, 1.0])[:, None], (2, 4, 5))
    table = vessels(pressure, flow=flow).indices()
    row = table.iloc[1]
    assert (row["geometry"], row["waveform"], row["blockage"]) == (2, 0, 0)
    assert (row["positions"], row["proximal"], row["distal"]) == ("whole vessel", 0, 4)
    assert (row["mean_flow"], row["peak_flow"], row["peak_velocity"]) == (2, 4, 32)
    upstream = row["systolic_mmHg"], row["diastolic_mmHg"], row["mean_pressure_mmHg"]
    assert upstream == pytest.approx([1e5 / MMHG] * 3, rel=1e-14)
    assert row["mean_drop_mmHg"] == pytest.approx(3e3 / MMHG, rel=1e-14)
    assert row["peak_drop_mmHg"] == pytest.approx(6e3 / MMHG, rel=1e-14)
    assert row["ffr"] == pytest.approx(0.97, rel=1e-14)
    assert row["resistance"] == pytest.approx(1.5e3, rel=1e-14)
    assert len(table) == 2
    assert set(vessels(pressure).indices(1, 3)["positions"]) == {"given"}


@pytest.mark.parametrize("blockage", [0.05, 0.4, 0.85])
def test_positions_are_a_diameter_beyond_the_ends_of_the_stenosis(blockage):
    vessel = Vessel((Stenosis(blockage, 2.0, 0.5),))
    z = vessel.grid(401)  # the ends, 1.75 and 2.25 cm, are points
    first, last = measuring_positions(z, vessel.area_undeformed(z)[None])
    assert first == pytest.approx(1.35, abs=0.021)
    assert last == pytest.approx(2.65, abs=0.021)


def test_positions_of_the_narrowest_stenosis_within_the_vessel():
    z = np.linspace(0, 4, 401)
    vessel = Vessel((Stenosis(0.7, 0.5), Stenosis(0.5, 2.0)))
    (first,), (last,) = measuring_positions(z, vessel.area_undeformed(z)[None])
    assert (first, last) == (0.0, pytest.approx(1.15, abs=0.021))
    # An even taper is no stenosis.
    taper = np.geomspace(0.2, 0.1, 401)[None]
    assert [float(p[0]) for p in measuring_positions(z, taper)] == [0.0, 4.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3.0, 1.0), r"proximal \(3 cm\) must lie upstream of distal \(1 cm\) in case 0"),
        ((1.0, 1.0), "must lie upstream"),
        ((-0.1, 1.0), r"proximal is -0\.1: positions must lie in the vessel, from 0 to 4 cm"),
        ((1.0, float("nan")), "distal is nan"),
        (([1.0, 1.0, 1.0], 2.0), r"one for each of the 2 cases; it has shape \(3,\)"),
        (("here", 2.0), "must hold real numbers"),
    ],
)
def test_positions_that_cannot_be_used(cases, arguments, message):
    with pytest.raises(InputError, match=message):
        cases.pressure_drop(*arguments)


def test_unknown_unit(cases):
    with pytest.raises(InputError, match="Unknown units 'psi'"):
        cases.pressure_drop(units="psi")


@pytest.mark.data
def test_the_papers_cases(published_cases):
    assert published_cases.pressure_drop(1.32, 2.68) == pytest.approx(
        published_cases.pressure[:, :, 33] - published_cases.pressure[:, :, 67], rel=1e-9
    )
    table = published_cases.indices()
    assert set(table["positions"]) == {"stenosis"}
    assert table["proximal"].to_numpy() == pytest.approx(1.32, abs=0.002)
    assert table["distal"].to_numpy() == pytest.approx(2.68, abs=0.002)
    assert table["ffr"].min() == pytest.approx(0.972, abs=5e-4)
    assert table["ffr"].max() == pytest.approx(0.999, abs=5e-4)


def test_wall_shear_stress_by_hand():
    rows = [[1.0, 0, 0, 0, 2], [-4, 0, 9, 0, 2], [1, 0, -12, 0, 2], [2, 0, 3, 0, 2]]
    arrays = {"wall_shear_stress": np.stack([rows, np.abs(rows)])}
    plain = vessels(1e5 + 0 * Z)
    with pytest.warns(UnitsWarning, match="the wall shear stress over Poiseuille's is 0"):
        cases = Cases(**case_arguments(plain, **arrays, check=False))
    average, (peak, position) = (
        cases.time_averaged_wall_shear_stress(),
        cases.peak_wall_shear_stress(units="Pa"),
    )
    assert average.tolist() == [[2, 0, 6, 0, 2]] * 2
    assert (peak.tolist(), position.tolist()) == ([1.2, 1.2], [2, 2])
    row = cases.indices().iloc[0]
    assert (row["peak_wss"], row["peak_wss_z"], row["peak_tawss"]) == (12, 2, 6)
    assert "peak_wss" not in plain.indices()
    with pytest.raises(InputError, match="only models of the preset 'physics' predict it"):
        plain.time_averaged_wall_shear_stress()
    with pytest.raises(InputError, match=r"'mmHg'; use one of \['dyn/cm\^2', 'Pa'\]"):
        cases.peak_wall_shear_stress("mmHg")


def test_a_length_that_is_not_that_of_the_stenosis_is_reported():
    z = np.linspace(0.0, 4.0, 201)
    stenosed = Vessel((Stenosis(0.6, 2.0, 1.0),), length=4.0).area_undeformed(z)
    areas = np.stack([np.full(201, 0.125), stenosed])
    start, end = ends(z, areas)
    np.testing.assert_allclose(start, [0.0, 1.5], atol=0.03)
    np.testing.assert_allclose(end, [4.0, 2.5], atol=0.03)
    with pytest.warns(PCNDEWarning, match=r"case 1 is 1 cm long.*L_s = 0\.5 cm"):
        check_length(z, areas, 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_length(z, areas, 1.0)
        check_length(z, areas[:1], 0.5)  # there is no stenosis
