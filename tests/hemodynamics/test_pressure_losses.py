import math

import numpy as np
import pytest

from pcnde_bridge.data.indices import reynolds_number
from pcnde_bridge.data.stenosis import diameter
from pcnde_bridge.hemodynamics.pressure_losses import (
    effective_length,
    pressure_drop,
    profile_pressure_drop,
    turbulent_drop,
    unsteady_pressure_drop,
    unsteady_profile_pressure_drop,
    viscous_coefficient,
    viscous_drop,
)

HEALTHY, LENGTH = math.pi * 0.04, 0.5
THROAT = 0.25 * HEALTHY
FLOW = np.array([-2.0, -0.3, 0.7, 2.5])


def test_printed_formula_for_forward_flow():
    """The paper's equation to the letter, with Re in it."""
    flow = FLOW[FLOW > 0]
    d0 = 0.4
    re = 1.06 * flow * d0 / (HEALTHY * 0.04)
    k_v = 32 * LENGTH / d0 * (HEALTHY / THROAT) ** 2
    dynamic = 1.06 * flow**2 / HEALTHY**2
    printed = dynamic * k_v / re + 1.52 * dynamic / 2 * (HEALTHY / THROAT - 1) ** 2
    np.testing.assert_allclose(pressure_drop(flow, HEALTHY, THROAT, LENGTH), printed, rtol=1e-13)
    np.testing.assert_allclose(reynolds_number(flow, HEALTHY), re, rtol=1e-13)
    assert viscous_coefficient(HEALTHY, THROAT, LENGTH) == pytest.approx(k_v, rel=1e-13)
    assert diameter(HEALTHY) == pytest.approx(d0, rel=1e-15)


def test_parts_sum_to_the_whole():
    whole = pressure_drop(FLOW, HEALTHY, THROAT, LENGTH)
    parts = viscous_drop(FLOW, HEALTHY, THROAT, LENGTH) + turbulent_drop(FLOW, HEALTHY, THROAT)
    np.testing.assert_array_equal(whole, parts)


def test_viscous_part_is_poiseuille_at_the_throat():
    poiseuille = 8 * math.pi * 0.04 * LENGTH * FLOW / THROAT**2
    np.testing.assert_allclose(viscous_drop(FLOW, HEALTHY, THROAT, LENGTH), poiseuille, rtol=1e-13)


def test_reversed_flow_reverses_the_drop_and_rest_has_none():
    forward = pressure_drop(FLOW, HEALTHY, THROAT, LENGTH)
    np.testing.assert_array_equal(pressure_drop(-FLOW, HEALTHY, THROAT, LENGTH), -forward)
    assert pressure_drop(0.0, HEALTHY, THROAT, LENGTH) == 0.0
    assert pressure_drop(0.0, HEALTHY, HEALTHY, LENGTH) == 0.0


def test_shapes_broadcast():
    flow = np.linspace(0.1, 2.0, 12).reshape(3, 4)
    throats = np.array([0.02, 0.05, 0.1])[:, None]
    drop = pressure_drop(flow, HEALTHY, throats, LENGTH)
    assert drop.shape == (3, 4)
    assert drop[1, 2] == pytest.approx(pressure_drop(flow[1, 2], HEALTHY, 0.05, LENGTH))


def test_same_and_differentiable_on_jax_arrays():
    jax = pytest.importorskip("jax")
    ours = pressure_drop(jax.numpy.asarray(FLOW), HEALTHY, THROAT, LENGTH)
    np.testing.assert_allclose(
        np.asarray(ours), pressure_drop(FLOW, HEALTHY, THROAT, LENGTH), rtol=1e-5
    )
    slope = jax.grad(lambda q: pressure_drop(q, HEALTHY, THROAT, LENGTH))(0.0)
    assert slope == pytest.approx(viscous_drop(1.0, HEALTHY, THROAT, LENGTH), rel=1e-5)


def test_effective_length():
    assert effective_length(10.0, 5.0) == pytest.approx(8.3 + 1.64 * math.sqrt(20 / math.pi))


def test_young_and_tsai():
    """The published formula to the letter, with its coefficients."""
    flow, rate = FLOW, np.array([30.0, -10.0, 0.0, 5.0])
    d0, ds = 0.4, 0.2
    k_v = 32 * (0.83 * LENGTH + 1.64 * ds) / d0 * (HEALTHY / THROAT) ** 2
    viscous = k_v * 0.04 / d0 * flow / HEALTHY
    turbulent = 1.52 * 1.06 / 2 * (HEALTHY / THROAT - 1) ** 2 * flow * abs(flow) / HEALTHY**2
    inertial = 1.2 * 1.06 * LENGTH * rate / HEALTHY
    found = unsteady_pressure_drop(flow, rate, HEALTHY, THROAT, LENGTH)
    np.testing.assert_allclose(found, viscous + turbulent + inertial, rtol=1e-13)


def test_losses_of_a_profile():
    """The formulas of Mirramezani et al. and of Itu et al., with their coefficients."""
    rate, mean = np.array([30.0, -10.0, 0.0, 5.0]), 0.7
    resistance, inertance, alpha = 900.0, 8.0, 2.6
    expansion = 1.52 * 1.06 / (2 * HEALTHY**2) * (HEALTHY / THROAT - 1) ** 2 * FLOW * abs(FLOW)
    steady = profile_pressure_drop(FLOW, resistance, HEALTHY, THROAT)
    np.testing.assert_allclose(steady, resistance * FLOW + expansion, rtol=1e-13)
    found = unsteady_profile_pressure_drop(
        FLOW, rate, mean, resistance, inertance, HEALTHY, THROAT, alpha
    )
    k_v, k_c = 1 + 0.053 * (THROAT / HEALTHY) * alpha**2, 0.0018 * alpha**2
    friction = k_v * resistance * FLOW + k_c * resistance * mean
    np.testing.assert_allclose(found, friction + expansion + 1.2 * inertance * rate, rtol=1e-13)
    still = unsteady_profile_pressure_drop(FLOW, 0.0, 0.0, resistance, 0.0, HEALTHY, THROAT, 0.0)
    np.testing.assert_array_equal(still, steady)
