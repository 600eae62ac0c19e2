"""Internal points of the closures: results that do not depend on the points of the data."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import CONFIG, CORRECTED, INFLOW, Z

from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.internal_points import internal_points
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel

SPACING = 0.02
FIXED = CONFIG.replace(losses={"spacing": SPACING})


def area(z, blockage=0.8, position=2.0):
    return Vessel((Stenosis(blockage, position),)).area_undeformed(z)


def predicted(z, s_u, config=FIXED):
    """Return the mean drop between the ends, and the wall shear stress at the throat."""
    inputs = ModelInputs(INFLOW[1:2], s_u[None], Grid(np.arange(32) / 32, z, 1.0))
    found = select_engine("jax").closures.predict(CORRECTED, np.zeros(1), inputs, config)
    drop = (found.pressure[0, :, 0] - found.pressure[0, :, -1]).mean()
    return drop, found.wall_shear_stress[0, :, s_u.argmin()].max()


def test_points_have_the_spacing_and_hold_the_given_ones():
    z = np.linspace(0, 4, 101)
    points = internal_points(z, SPACING)
    np.testing.assert_allclose(np.diff(points.z), SPACING, rtol=1e-9)
    np.testing.assert_allclose(points.inward @ points.outward, np.eye(z.size), atol=1e-9)
    np.testing.assert_allclose(z**3 @ points.inward, points.z**3, atol=1e-9)
    s_u = area(z)[None]
    assert (points.area(s_u) > 0).all()
    np.testing.assert_allclose(points.area(s_u) @ points.outward, s_u, rtol=1e-9)


def test_without_a_spacing_the_points_are_the_given_ones():
    points = internal_points(Z, None)
    assert np.array_equal(points.z, Z)
    assert np.array_equal(points.inward, points.outward)
    found, other = (predicted(Z, area(Z), config) for config in (CONFIG, FIXED))
    # 0.1 cm between two points is too much for a stenosis of 0.5 cm.
    assert abs(found[0] - other[0]) > 0.01 * other[0]


def test_drop_and_wall_shear_stress_do_not_depend_on_the_points():
    fine = np.linspace(0, 4, 101)
    drop, stress = predicted(fine, area(fine))
    for count in (51, 201, 801):
        z = np.linspace(0, 4, count)
        found = predicted(z, area(z))
        assert found[0] == pytest.approx(drop, rel=0.005)
        assert found[1] == pytest.approx(stress, rel=0.01)
    for count in (401, 801):
        z = np.linspace(0, 4, count)
        # The kinks lie between the knots.
        assert predicted(z, np.interp(z, fine, area(fine))) == pytest.approx(
            (drop, stress), rel=1e-6
        )


def test_drop_does_not_depend_on_where_the_throat_lies_between_points():
    z = np.linspace(0, 4, 101)
    drops = [predicted(z, area(z, position=2 + shift))[0] for shift in (0, 0.005, 0.01, 0.015)]
    assert np.ptp(drops) < 0.02 * np.mean(drops)


@pytest.mark.parametrize(("count", "blockage"), [(51, 0.85), (101, 0.0), (101, 0.85), (801, 0.6)])
def test_smooth_vessels_are_not_rough(count, blockage):
    z = np.linspace(0, 4, count)
    s_u = area(z, blockage) * np.linspace(1, 0.8, count)
    assert not internal_points(z, SPACING).is_rough(s_u[None]).any()


def test_noise_and_linear_interpolation_of_few_points_are_rough():
    z, few = np.linspace(0, 4, 401), np.linspace(0, 4, 51)
    noise = 1 + 0.01 * np.random.default_rng(0).standard_normal(z.size)
    rough = np.stack([noise * area(z, 0.0), noise * area(z), np.interp(z, few, area(few))])
    assert internal_points(z, SPACING).is_rough(rough).all()
