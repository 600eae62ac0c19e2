import math

import numpy as np
import pytest

from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.tube_laws import (
    PAPER_REFERENCE_PRESSURE,
    LinearWall,
    OlufsenWall,
)

WALLS = [
    LinearWall(),
    LinearWall(reference_pressure=PAPER_REFERENCE_PRESSURE),
    OlufsenWall(),
    OlufsenWall(reference_pressure=1e5),
]
AREA_UNDEFORMED = np.array([0.02, 0.07, 0.1257])
STRETCH = np.linspace(0.8, 1.3, 6)[:, None]


@pytest.mark.parametrize("wall", WALLS)
def test_area_inverts_pressure(wall):
    area = STRETCH * AREA_UNDEFORMED
    pressure = wall.pressure(area, AREA_UNDEFORMED)
    np.testing.assert_allclose(wall.area(pressure, AREA_UNDEFORMED), area, rtol=1e-12)


@pytest.mark.parametrize("wall", WALLS)
def test_undeformed_at_the_reference_pressure(wall):
    assert wall.pressure(0.1, 0.1) == wall.reference_pressure
    assert wall.area(wall.reference_pressure, 0.1) == pytest.approx(0.1, rel=1e-15)


@pytest.mark.parametrize("wall", WALLS)
def test_slope_is_the_derivative(wall):
    area, h = STRETCH * AREA_UNDEFORMED, 1e-7
    change = wall.pressure(area + h, AREA_UNDEFORMED) - wall.pressure(area - h, AREA_UNDEFORMED)
    slope = wall.pressure_slope(area, AREA_UNDEFORMED)
    np.testing.assert_allclose(slope, change / (2 * h), rtol=1e-6)


def test_numbers_of_the_paper():
    wall = LinearWall()
    assert wall.stiffness(0.1) == pytest.approx(5.0e6, rel=1e-15)
    # c² = K/(2ρ) at S = S_u.
    assert wall.wave_speed(0.1257, 0.1257) == pytest.approx(math.sqrt(5e6 / 2.12), rel=1e-12)
    # 100 mmHg widen the tube by (1 + p/K)².
    assert wall.area(133_322.0, 1.0) == pytest.approx((1 + 133_322 / 5e6) ** 2, rel=1e-15)
    # Olufsen's stiffness at r0 = 0.2 cm, by hand.
    by_hand = 4 / 3 * (2e7 * math.exp(-22.53 * 0.2) + 8.65e5)
    assert OlufsenWall().stiffness(math.pi * 0.04) == pytest.approx(by_hand, rel=1e-12)


def test_area_beyond_the_end_of_the_law_is_negative():
    """Not that of another pressure, on the other branch of the square."""
    linear, olufsen = LinearWall(), OlufsenWall()
    end = linear.stiffness(0.1)
    assert linear.area(np.array([-1.1 * end, -end, -0.9 * end]), 0.1) == pytest.approx(
        [-0.001, 0.0, 0.001]
    )
    end = olufsen.stiffness(0.1)
    assert olufsen.area(np.array([0.9 * end, 1.1 * end]), 0.1) == pytest.approx([10.0, -10.0])


def test_numbers_may_be_numpys():
    wall = LinearWall(thickness=np.float32(0.5), reference_pressure=np.int64(3))
    assert wall == LinearWall(thickness=0.5, reference_pressure=3.0)
    assert type(wall.thickness) is float


def test_same_on_jax_arrays():
    jnp = pytest.importorskip("jax.numpy")
    for wall in WALLS:
        area = STRETCH * AREA_UNDEFORMED
        ours = wall.pressure(jnp.asarray(area), jnp.asarray(AREA_UNDEFORMED))
        theirs = wall.pressure(area, AREA_UNDEFORMED)
        np.testing.assert_allclose(np.asarray(ours), theirs, rtol=1e-4, atol=50.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LinearWall(young_modulus=0.0), r"young_modulus must be positive"),
        (lambda: LinearWall(thickness=-1.0), r"thickness must be positive"),
        (lambda: LinearWall(reference_pressure=math.nan), r"reference_pressure must be finite"),
        (lambda: OlufsenWall(k3=0.0), r"k3 must be positive"),
        (lambda: OlufsenWall(k1=-1.0), r"k1 must not be negative"),
        (lambda: OlufsenWall(k2=1e5), r"k2 must not be positive"),
        (lambda: OlufsenWall(k2="1"), r"k2 must be a number \(1/cm\)"),
        (lambda: LinearWall(radius=True), r"radius must be a number \(cm\)"),
    ],
)
def test_bad_input(make, words):
    with pytest.raises(InputError, match=words):
        make()
