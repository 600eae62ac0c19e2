import math

import numpy as np
import pytest

from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel


@pytest.mark.parametrize("blockage", [0.0, 0.4, 0.85])
def test_throat_area_is_the_healthy_area_less_the_blockage(blockage):
    vessel = Vessel((Stenosis(blockage),))
    area = vessel.area_undeformed(vessel.grid())
    assert area[50] == pytest.approx((1 - blockage) * vessel.healthy_area, rel=1e-14)
    assert area.min() == area[50]
    assert vessel.blockage == blockage


def test_radius_follows_the_formula_and_is_healthy_outside():
    vessel = Vessel((Stenosis(0.75, position=1.5, length=0.8),))
    # r_min = 0.1, r0 = 0.2; a quarter of the length from the throat sin² is 1/2.
    assert vessel.radius_undeformed(1.7) == pytest.approx(0.15, rel=1e-14)
    assert vessel.radius_undeformed(1.3) == pytest.approx(0.15, rel=1e-14)
    np.testing.assert_array_equal(vessel.radius_undeformed([0.0, 1.1, 1.9, 4.0]), 0.2)


@pytest.mark.data
def test_shape_agrees_with_the_published_data(published_cases):
    tables = published_cases.labels.drop_duplicates("geometry")
    for row, blockage in tables["blockage"].items():
        # The mesh is a little narrower than 4 mm.
        vessel = Vessel((Stenosis(blockage),), diameter=0.3989)
        area = vessel.area_undeformed(published_cases.z)
        np.testing.assert_allclose(area, published_cases.area_undeformed[row], rtol=6e-3)


def test_several_stenoses_and_none():
    assert Vessel().blockage == 0.0
    np.testing.assert_allclose(Vessel().area_undeformed(np.linspace(0, 4, 9)), math.pi * 0.04)
    vessel = Vessel((Stenosis(0.5, 1.0), Stenosis(0.7, 3.0)))
    ratio = vessel.area_undeformed([1.0, 2.0, 3.0]) / vessel.healthy_area
    np.testing.assert_allclose(ratio, [0.5, 1.0, 0.3])
    assert vessel.blockage == 0.7


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Stenosis(1.0), r"blockage.*\[0, 1\)"),
        (lambda: Stenosis(-0.1), r"blockage"),
        (lambda: Stenosis(60), r"percentage"),
        (lambda: Stenosis(math.nan), r"blockage"),
        (lambda: Stenosis(0.5, length=0.0), r"length must be positive"),
        (lambda: Stenosis(0.5, position=math.inf), r"position must be finite"),
        (lambda: Vessel(diameter=-0.4), r"diameter must be positive"),
        (lambda: Vessel((Stenosis(0.5, 0.1),)), r"outside the tube"),
        (lambda: Vessel((Stenosis(0.5, 2.0), Stenosis(0.5, 2.4))), r"overlap"),
        (lambda: Vessel((0.5,)), r"must be a Stenosis"),
        (
            lambda: Vessel().area_undeformed([0.0, 4.5]),
            r"z\[1\] is 4.5: points must lie in the tube",
        ),
        (lambda: Vessel().grid(1), r"n_points"),
        (lambda: Vessel().grid(101.0), r"n_points must be a whole number"),
        (lambda: Vessel(length="4"), r"Vessel.length must be a number \(cm\)"),
        (lambda: Vessel(length=True), r"Vessel.length must be a number"),
        (lambda: Vessel(Stenosis(0.5)), r"must be a sequence of Stenosis, got Stenosis"),
        (lambda: Stenosis("0.5"), r"blockage must be a number"),
        (lambda: Stenosis(0.5, None), r"position must be a number \(cm\)"),
        (lambda: Vessel().area_undeformed(["a"]), r"z must hold real numbers"),
    ],
)
def test_bad_input(make, words):
    with pytest.raises(InputError, match=words):
        make()
