"""Wall shear stress of the preset ``physics``: limits that are known, and its memory."""

from __future__ import annotations

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    AREA,
    CONFIG,
    CORRECTED,
    GRID,
    INFLOW,
    LOSSES,
    MEMBRANE,
    OFF,
    OUTLET,
    RADIUS,
    SHEAR,
    STRAIGHT,
    Z,
    solve,
    vessel,
)
from scipy.integrate import solve_ivp
from scipy.special import iv

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.data.indices import poiseuille_wall_shear_stress
from pcnde_bridge.engines import select_engine, shared_terms
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.jax.closures.wall_shear_stress import _relaxed

PARAMETERS = ClosureParameters(OUTLET, LOSSES, MEMBRANE, OFF, SHEAR)


def stress(flow, area, flow_rate=0.0, parameters=SHEAR):
    """Return the wall shear stress (case, time, z) of flows (case, time) at all points."""
    flow, flow_rate = (
        np.repeat((f + np.zeros_like(flow))[..., None], 41, axis=-1) for f in (flow, flow_rate)
    )
    closures = select_engine("jax").closures
    problem = closures.wall_shear_stress(PARAMETERS, flow, flow_rate, area, GRID, CONFIG)
    return problem(parameters)[0]


FLOWS = np.array([[0.3, 1.0, 2.5], [-0.3, -1.0, -2.5]])


def test_straight_vessel_has_poiseuilles_for_any_parameters():
    found = stress(FLOWS, np.array([STRAIGHT, STRAIGHT]), 4.0)
    expected = 4 * 0.04 * FLOWS / (np.pi * RADIUS**3) + 0.6 * 1.06 / (6 * np.pi * RADIUS) * 4
    assert found == pytest.approx(np.repeat(expected[..., None], 41, axis=-1), rel=1e-9)


def test_slow_oscillation_in_a_straight_vessel_has_womersleys():
    parameters = np.concatenate([[1.0], SHEAR[1:]])
    omega = 0.3 * 0.04 / 1.06 / RADIUS**2  # a Womersley number of 0.55
    phase = 2 * np.pi * np.arange(3) / 16
    flow, rate = 1 + 0.5 * np.cos(phase), -0.5 * omega * np.sin(phase)
    found = stress(flow[None], STRAIGHT[None], rate[None], parameters)[0, :, 20]
    x = np.sqrt(0.3j)
    response = x * iv(1, x) / (4 * iv(2, x))
    expected = 0.16 / (np.pi * RADIUS**3) * (1 + 0.5 * (response * np.exp(1j * phase)).real)
    assert found == pytest.approx(expected, rel=2e-4)
    assert abs(response.imag) > 0.01


def test_reversed_flow_through_the_mirrored_vessel_has_the_opposite_stress():
    area = vessel(1.3)
    there = stress(FLOWS[:1], area[None], 2.0)
    back = stress(FLOWS[1:], area[None, ::-1], -2.0)
    assert there == pytest.approx(-back[:, :, ::-1], rel=1e-9)


def test_stress_is_high_in_the_throat_low_behind_and_recovers():
    flow = np.array([[0.3, 1.0, 1.5]])
    area = np.array([vessel(1.2, blockage=0.7), vessel(2.0, blockage=0.7)])
    first, moved = stress(np.repeat(flow, 2, axis=0), area)
    poiseuille = poiseuille_wall_shear_stress(flow[0][:, None], area[0])
    # The peak relative to Poiseuille's grows with the Reynolds number; it lies before the throat.
    peak = (first / poiseuille).max(axis=1)
    assert (np.diff(peak) > 0).all()
    assert peak[-1] > 2
    lowest = (first / poiseuille).min(axis=1)
    assert (np.diff(lowest) < 0).all()
    assert lowest[-1] < 0.5
    assert (Z[first.argmax(axis=1)] <= 1.2 + 1e-9).all()
    assert first[0, -1] == pytest.approx(poiseuille[0, -1], rel=0.02)
    # A moved stenosis moves the stress.
    assert moved[:, 8:] == pytest.approx(first[:, :-8], rel=0, abs=0.01 * first.max())


def test_memory_of_a_linear_source_is_exact():
    source, length = np.sin(Z) + 1, 0.3 + 0.05 * np.cos(Z)
    with double_precision():
        found = np.asarray(_relaxed(*map(jnp.asarray, (source, length, Z))))

    def slope(z, y):
        i = min(int(z / 0.1 + 1e-9), 39)
        return (np.interp(z, Z, source) - y) / ((length[i] + length[i + 1]) / 2)

    exact = [0.0]
    for a, b in pairwise(Z):
        exact.append(solve_ivp(slope, (a, b - 1e-12), exact[-1:], rtol=1e-10, atol=1e-12).y[0, -1])
    assert found == pytest.approx(np.array(exact), rel=1e-7)


def test_prediction_is_the_magnitude_for_the_predicted_flow():
    inflow = INFLOW.copy()
    inflow[3] = 2.5 * (inflow[3] - inflow[3].mean()) + 0.5  # reverses
    found = solve(CORRECTED, inflow)
    flow_rate = np.moveaxis(shared_terms.rate(np.moveaxis(found.flow, 1, -1), 1.0), -1, 1)
    closures = select_engine("jax").closures
    problem = closures.wall_shear_stress(CORRECTED, found.flow, flow_rate, AREA, GRID, CONFIG)
    expected, slope = problem(SHEAR)
    none, _ = problem(np.zeros(9))
    assert expected == pytest.approx(none + slope @ SHEAR, rel=1e-9, abs=1e-9)
    error = found.wall_shear_stress - np.abs(expected)
    assert np.abs(error).max() < 0.01 * np.abs(expected).max()
