"""Closures of the preset ``physics``: each equation by itself, and all coupled."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    AREA,
    BLOOD,
    CONFIG,
    CORRECTED,
    GRID,
    INFLOW,
    LOSSES,
    MEMBRANE,
    OFF,
    ON,
    OUTLET,
    PASSIVE,
    RADIUS,
    STRAIGHT,
    TIME,
    WAVEFORM,
    Z,
    compiled_quickly,
    solve,
    vessel,
    waveforms,
)
from scipy.integrate import solve_ivp

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import select_engine, shared_terms
from pcnde_bridge.engines.closure_parameters import sizes
from pcnde_bridge.engines.internal_points import internal_points
from pcnde_bridge.engines.jax.closures import (
    boundary_layer,
    correction,
    wall,
)
from pcnde_bridge.engines.jax.closures import (
    pressure_losses as losses,
)
from pcnde_bridge.engines.jax.closures.engine import _distinct_vessels
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError, SolveError


def rate(signal):
    """∂/∂t of (..., time, z), spectral."""
    omega = 2j * np.pi * np.fft.rfftfreq(32, 1 / 32)
    omega[-1] = 0
    return np.fft.irfft(omega[:, None] * np.fft.rfft(signal, axis=-2), n=32, axis=-2)


def in_double(function, **static):
    """Compile, and compute in float64 from and to numpy."""
    fast = compiled_quickly(partial(function, **static))

    def call(*arguments):
        with double_precision():
            return jax.tree.map(np.asarray, fast(*map(jnp.asarray, arguments)))

    return call


displacement = in_double(wall.displacement, law="membrane")
along_vessel = in_double(boundary_layer.along_vessel)


@in_double
def drop(parameters, flow, flow_rate, s_u, z):
    """p − p(L), (time, z)."""
    c, _ = losses.coefficients(parameters, s_u, z, BLOOD)
    return losses.drop(c, flow, flow_rate, z)


# ---- wall ------------------------------------------------------------------


def loads(seed=0):
    """Three loads, dyn/cm²: uniform, falling, random."""
    noise = np.random.default_rng(seed).uniform(0.5, 1.5, 41)
    return 1e5 * np.stack([np.ones(41), 1 - Z / 8, noise])


def test_membrane_is_clamped_linear_and_narrow_parts_move_less():
    moved = displacement(MEMBRANE, loads(), vessel(2.0), Z)
    assert (moved[:, [0, -1]] == 0).all()
    assert (moved[:2, 1:-1] > 0).all()
    # Nearly as r², of which the stenosis leaves 0.4.
    assert moved[0, 20] < 0.6 * moved[0, 10]
    other = displacement(MEMBRANE, loads(1), vessel(2.0), Z)
    both = displacement(MEMBRANE, 2 * loads() - 3 * loads(1), vessel(2.0), Z)
    assert np.allclose(both, 2 * moved - 3 * other, rtol=0, atol=1e-12 * np.abs(both).max())
    # p₀ belongs to the pressure, not to the loads.
    other = np.array([*MEMBRANE[:4], 9e4])
    assert np.array_equal(displacement(other, loads(), vessel(2.0), Z), moved)


def test_membrane_of_a_mirrored_vessel_moves_as_its_mirror():
    s_u = vessel(1.3)
    moved = displacement(MEMBRANE, loads(), s_u, Z)
    mirrored = displacement(MEMBRANE, loads()[:, ::-1], s_u[::-1], Z)
    assert np.allclose(mirrored[:, ::-1], moved, rtol=0, atol=1e-12 * moved.max())


def test_membrane_of_a_long_straight_vessel_follows_the_linear_wall_law():
    numbers = np.array([1e6, 0.45, 0.2, 1e6, 0.0])
    moved = displacement(numbers, loads()[[0, 0, 0]], STRAIGHT, 10 * Z)
    # The clamped ends reach r√k = 0.09 cm far, the middle is 20 cm away.
    assert moved[0, 20] == pytest.approx(RADIUS**2 * 1e5 / 1e6, rel=1e-5)


@pytest.mark.parametrize(("support", "poisson"), [(1e8, 0.45), (0.0, 0.45), (0.0, 0.0)])
def test_membrane_of_a_straight_vessel_equals_its_exact_solution(support, poisson):
    # Without support the axial strain takes up what ν asks for, but its integral is zero:
    # (1 − ν²)u/r² + ν²ū/r² − k u″ = p/K.  With stiff support there is none: ν drops out.
    shear, stiffness = 25.0, 1e6
    nu = 0.0 if support else poisson
    decay = RADIUS * np.sqrt(shear / (1 - nu**2))
    half = 2.0 / decay
    size = RADIUS**2 * 1e5 / stiffness / (1 - nu**2 * np.tanh(half) / half)
    exact = size * (1 - np.cosh((Z - 2) / decay) / np.cosh(half))
    numbers = np.array([stiffness, poisson, shear, support, 0.0])
    moved = displacement(numbers, loads()[[0, 0, 0]], STRAIGHT, Z)
    # Linear elements are off by h²/12 of the second derivative: 1e-3 of the size.
    assert np.allclose(moved[0], exact, rtol=0, atol=1e-3 * exact.max())


def test_membrane_makes_its_energy_stationary():
    """The docstring's energy, written down and minimized with dense matrices."""
    stiffness, nu, k, f, _ = MEMBRANE
    radius, load = np.sqrt(vessel(1.7) / np.pi), loads()[2]

    def energy(inside):
        u = jnp.pad(inside.reshape(39, 2), ((1, 1), (0, 0)))
        line = jnp.stack([Z, radius], axis=1)
        ds = jnp.linalg.norm(jnp.diff(line, axis=0), axis=1)
        tangent = jnp.diff(line, axis=0) / ds[:, None]
        normal = jnp.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        slope = jnp.diff(u, axis=0) / ds[:, None]
        total = 0.0
        for at in (0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5):
            r, p = ((1 - at) * a[:-1] + at * a[1:] for a in (radius, load))
            here = (1 - at) * u[:-1] + at * u[1:]
            e_s, e_t = (tangent * slope).sum(axis=1), here[:, 1] / r
            shear = (normal * slope).sum(axis=1)
            stored = e_s**2 + e_t**2 + 2 * nu * e_s * e_t + k * shear**2 + f * here[:, 0] ** 2
            work = p * (normal * here).sum(axis=1)
            total += ((0.5 * stiffness * stored - work) * r * ds / 2).sum()
        return total

    def minimize():
        zero = jnp.zeros(78)
        return -jnp.linalg.solve(jax.hessian(energy)(zero), jax.grad(energy)(zero))

    expected = in_double(minimize)().reshape(39, 2)[:, 1]
    moved = displacement(MEMBRANE, loads(), vessel(1.7), Z)[2, 1:-1]
    assert np.allclose(moved, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("exponent", [0.0, 1.0])
def test_local_law_equals_its_formula(exponent):
    s_u = vessel(2.0)
    radius = np.sqrt(s_u / np.pi)
    relative = radius / radius[0] if exponent else np.ones(41)
    moved = in_double(wall.displacement, law="local")([2e6, exponent, 5e3], loads(), s_u, Z)
    assert np.allclose(moved, radius * relative * loads() / 2e6, rtol=1e-13)


def test_block_tridiagonal_systems_are_solved():
    rng = np.random.default_rng(1)
    n = 7
    # A = B·Bᵀ of a lower block bidiagonal B is block tridiagonal and positive definite.
    lower = np.kron(np.eye(n), np.ones((2, 2))) + np.kron(np.eye(n, k=-1), np.ones((2, 2)))
    factor = lower * rng.normal(size=(2 * n, 2 * n)) + 2 * np.eye(2 * n)
    matrix, right = factor @ factor.T, rng.normal(size=(2 * n, 3))
    blocks = matrix.reshape(n, 2, n, 2).swapaxes(1, 2)
    diagonal = blocks[np.arange(n), np.arange(n)]
    above = np.concatenate([blocks[np.arange(n - 1), np.arange(1, n)], np.full((1, 2, 2), 9.0)])
    found = in_double(wall._solve_block_tridiagonal)(diagonal, above, right.reshape(n, 2, 3))
    expected = np.linalg.solve(matrix, right)
    assert np.allclose(found.reshape(2 * n, 3), expected, rtol=0, atol=1e-10)


# ---- losses ----------------------------------------------------------------

FLOW = np.repeat(waveforms()[3][:, None], 41, axis=1)
STEADY = np.full((32, 1), 1.5)
NAMES = losses._Parameters._fields
VISCOUS_LENGTH = np.pi * BLOOD.viscosity / BLOOD.density  # πν, cm²/s


def changed(parameters=LOSSES, **values):
    """Parameters of the losses with some changed by name."""
    return np.array([values.get(n, v) for n, v in zip(NAMES, parameters, strict=True)])


# Layer and jet alone: no friction and no term of ∂Q/∂t.
JET = changed(friction=0.0, inertia=0.0, jet_friction=0.0, jet_lag=0.0)
# The layer does not grow: once thinnest, its displacement is that of a constant m.
THINNEST = 1 - 2 / 3 * boundary_layer._THINNEST + boundary_layer._THINNEST**2 / 6
IDEAL = changed(
    JET,
    core=0.9 * THINNEST**2,
    layer_growth=0.0,
    jet_momentum=1.0,
    jet_recovery=0.9,
    jet_spread=0.12,
    jet_viscous_spread=0.0,
)


def drop_of(parameters, flow, s_u, z=Z):
    """p − p(L) of a periodic flow (32, z or 1)."""
    flow = np.broadcast_to(flow, (32, z.size))
    return drop(parameters, flow, rate(flow), s_u, z)


def reference_flow(s_u):
    """Q₀, mL/s: a Reynolds number of 60 at the ends."""
    return 30 * VISCOUS_LENGTH * np.sqrt((s_u[0] + s_u[-1]) / (2 * np.pi))


def along(s_u, z, flow, growth=1.3, momentum=1.25, spread=0.06, viscous_spread=2.0):
    """Return d and A_j, (flow, z)."""
    return along_vessel(s_u, z, VISCOUS_LENGTH / flow, growth, momentum, spread, viscous_spread)


def funnel(z, until=1.0):
    """Factor of S_u that narrows from 8 to 1: it makes the layer thinnest."""
    ramp = np.clip(z / until, 0, 1)
    return 8 - 7 * (3 * ramp**2 - 2 * ramp**3)


@pytest.mark.parametrize("direction", [1, -1])
def test_straight_vessel_has_poiseuilles_and_the_inertial_drop(direction):
    found = drop_of(LOSSES, direction * FLOW, STRAIGHT)
    friction = 1.2 * 8 * np.pi * BLOOD.viscosity / 0.125**2 * FLOW
    inertia = 1.1 * BLOOD.density / 0.125 * rate(FLOW)
    expected = direction * (friction + inertia) * (4 - Z)
    assert np.allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_straight_vessel_has_no_jet_and_a_fully_developed_layer():
    # A fused difference of equal squares leaves the round-off of a square.
    dynamic = BLOOD.density * (FLOW.max() / 0.125) ** 2
    assert np.abs(drop_of(JET, FLOW, STRAIGHT)).max() < 1e-14 * dynamic
    assert np.abs(drop_of(JET, -FLOW, STRAIGHT)).max() < 1e-14 * dynamic
    layer, jet, _ = along(STRAIGHT, Z, np.array([0.1, 1.0, 10.0]))
    assert (layer == 1).all()
    assert np.array_equal(jet, np.broadcast_to(STRAIGHT / 1.25, jet.shape))


def test_sudden_widening_loses_what_borda_and_carnot_say():
    z = np.linspace(0, 20, 10_001)
    narrow, wide = 0.05, 0.125
    # Narrows smoothly over 2 cm, opens at once at 5 cm; the jet fills the vessel 0.6 cm later.
    ramp = np.clip((z - 2) / 2, 0, 1)
    s_u = wide + (narrow - wide) * (3 * ramp**2 - 2 * ramp**3)
    s_u[z > 5] = wide
    # The inlet has a parabola; Borda and Carnot have a uniform flow, here behind a funnel.
    found = drop_of(IDEAL, STEADY, s_u * funnel(z), z)
    first = np.searchsorted(z, 1.5)
    expected = 0.9 * BLOOD.density * 1.5**2 / 2 * (1 / narrow - 1 / wide) ** 2
    assert found[0, first] == pytest.approx(expected, rel=0.01)
    # What the narrowing took alone is Bernoulli's, most of which the jet gives back.
    taken = found[0, first] - found[0, np.searchsorted(z, 4.5)]
    bernoulli = 0.9 * BLOOD.density * 1.5**2 / 2 * (1 / narrow**2 - 1 / wide**2)
    assert taken == pytest.approx(bernoulli, rel=1e-3)


def test_a_flow_that_fills_the_vessel_gets_back_what_it_gave():
    filled = changed(IDEAL, jet_spread=1e3)  # a jet that spreads as fast as any vessel
    for z in (Z, np.array([0.0, 0.3, 0.6, 1.0, 1.7, 2.1, 2.4, 2.5, 2.9, 3.6, 5.0])):
        s_u = vessel(2.3, blockage=0.8, z=z) * funnel(z)
        found = drop_of(filled, STEADY, s_u, z)[:, z >= 1]
        gained = 0.9 * BLOOD.density * 1.5**2 / 2 * (1 / s_u**2 - 1 / s_u[-1] ** 2)[z >= 1]
        assert np.allclose(found, -gained, rtol=0, atol=1e-12 * gained.max())


def test_a_filled_widening_recovers_pressure():
    # Whatever the layer does: c_j·β of the dynamic pressure of a uniform flow.
    filled, s_u = changed(JET, jet_spread=1e3), 0.05 + 0.02 * Z**1.5
    gained = 0.95 * 1.25 * BLOOD.density * 1.5**2 / 2 * (1 / s_u**2 - 1 / s_u[-1] ** 2)
    found = drop_of(filled, STEADY, s_u)
    assert np.allclose(found, -gained, rtol=0, atol=1e-12 * gained.max())


@pytest.mark.parametrize("parameters", [JET, LOSSES], ids=["without friction", "all"])
def test_drop_hardly_depends_on_the_points(parameters):
    drops = []
    for n in (161, 1601):
        z = np.linspace(0, 4, n)
        points = internal_points(z, 0.02)
        s_u = points.area(vessel(1.0, 2.6, blockage=0.8, z=z)[None])[0]
        drops.append(drop_of(parameters, STEADY, s_u, points.z)[0, 0])
    assert drops[0] == pytest.approx(drops[1], rel=0.002)


def test_reversed_flow_through_the_mirrored_vessel_has_the_opposite_drop():
    s_u, flow = vessel(1.3), FLOW * (1 - 0.02 * Z)
    there = drop_of(LOSSES, flow, s_u)
    back = drop_of(LOSSES, -flow[:, ::-1], s_u[::-1])
    expected = there[:, ::-1] - there[:, :1]
    assert np.allclose(back, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    # Layer and jet make it another drop than that of the same vessel.
    assert np.abs(drop_of(LOSSES, -flow, s_u) + there).max() > 0.1 * np.abs(there).max()


@pytest.mark.parametrize("viscous_spread", [0.0, 2.0])
@pytest.mark.parametrize("spread", [0.05, 0.12, 5.0])
def test_jet_grows_by_the_spread_until_it_fills_the_vessel(spread, viscous_spread):
    s_u, flow = vessel(1.1, 2.4, blockage=0.7), np.array([0.4, 6.0])
    _, found, _ = along(s_u, Z, flow, spread=spread, viscous_spread=viscous_spread)
    expected = np.tile(s_u / 1.25, (2, 1))
    for i, step in enumerate(np.diff(Z)):
        radius = np.sqrt(expected[:, i] / np.pi)
        half = step / 2 * viscous_spread * VISCOUS_LENGTH / flow
        jet = np.pi * ((radius * (1 + half) + spread * step) / (1 - half)) ** 2
        expected[:, i + 1] = np.minimum(s_u[i + 1] / 1.25, jet)
    assert np.allclose(found, expected, rtol=1e-12)
    separated = (found[1] < 0.999 * s_u / 1.25).any()
    assert separated == (spread < 1)


def layer_of_scipy(s_u, slope, z, flow, growth=1.3):
    """d by the docstring's equation, until it is fully developed again."""

    def rate_of(at, d):
        m, m_d = 1 - 2 * d / 3 + d**2 / 6, -2 / 3 + d / 3
        k, k_d = 1 - 14 * d / 15 + 4 * d**2 / 15, -14 / 15 + 8 * d / 15
        energy = k_d / m**2 - 2 * k * m_d / m**3
        viscous = growth * 4 * VISCOUS_LENGTH / (flow * m) * (d**6 - 1 / d)
        return (-slope(at) * (1 - k) / m**2 + viscous) / (energy + m_d / m**3)

    def developed(at, d):
        return d[0] - 1 if at > 1 else -1.0

    developed.terminal = True
    found = solve_ivp(
        rate_of, z[[0, -1]], [1.0], "Radau", z, events=developed, rtol=1e-11, atol=1e-13
    )
    assert found.success
    return np.concatenate([found.y[0], np.ones(z.size - found.y[0].size)])


@pytest.mark.parametrize("flow", [0.4, 1.5, 6.0])
def test_layer_follows_its_equation(flow):
    def slope(z):
        bump = np.exp(-(((z - 1.3) / 0.3) ** 2))
        return 0.6 * bump * 2 * (z - 1.3) / 0.09 / (1 - 0.6 * bump)

    exact = layer_of_scipy(vessel(1.3), slope, Z, flow)
    assert exact.min() < 0.75
    errors = []
    for refinement in (1, 2, 4, 8):
        z = np.linspace(0, 4, 40 * refinement + 1)
        found, *_ = along(vessel(1.3, z=z), z, np.array([flow]))
        errors.append(np.abs(found[0, ::refinement] - exact).max())
    assert errors[-1] < 1e-3
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > 1.85


def test_thin_layer_grows_like_that_of_a_plate():
    # δ² = 30 ν z/U with the quadratic profile, where the layer is thin.
    z, flow = np.linspace(0, 2, 401), 200.0
    layer, *_ = along(0.125 * funnel(z), z, np.array([flow]), growth=1.0)
    start = np.searchsorted(z, 1.0)
    grown = layer[0, start:] ** 2 - layer[0, start] ** 2
    expected = 30 * VISCOUS_LENGTH / flow * (z[start:] - 1)
    assert 0.05 < layer[0, -1] < 0.2
    # The equation's next order in d reduces the growth by the factor 1 − 2.9·d.
    assert np.allclose(grown, expected, rtol=3 * layer[0, -1], atol=0)
    assert np.allclose(grown[1:20], expected[1:20], rtol=3 * layer[0, start + 20], atol=0)
    assert layer[0, start] < 0.04


@pytest.mark.parametrize("direction", [1, -1])
def test_drop_is_exact_at_three_flows_and_between_in_between(direction):
    s_u = vessel(1.3)
    scaled = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    flows = scaled * reference_flow(s_u)
    flow = np.broadcast_to(direction * flows[:, None], (5, 41))
    found = drop(LOSSES, flow, 0 * flow, s_u, Z)
    if direction < 0:  # as of the mirrored vessel
        found, s_u = found[:, ::-1] - found[:, :1], s_u[::-1]
    layer, jet, _ = along(s_u, Z, flows)
    expected, slope = np.zeros((5, 41)), np.zeros(41)
    slope[1:-1] = (s_u[2:] - s_u[:-2]) / (Z[2:] - Z[:-2])
    for i in range(39, -1, -1):
        both = slice(i, i + 2)
        m = 1 - 2 / 3 * layer[:, both] + layer[:, both] ** 2 / 6
        speed = flows[:, None] / (s_u[both] * m)
        filled = jet[:, both] / (s_u[both] / 1.25)
        attached = 1.2 * 4 * BLOOD.viscosity * speed * layer[:, both] ** 6 * np.pi / s_u[both]
        apart = 1.15 * 8 * np.pi * BLOOD.viscosity * flows[:, None] / s_u[both] ** 2
        friction = (filled * attached + (1 - filled) * apart).mean(axis=1) * (Z[i + 1] - Z[i])
        core = 0.9 * BLOOD.density / 2 * np.diff(speed**2, axis=1)[:, 0]
        given = np.diff(1 / jet[:, both], axis=1)[:, 0]
        mixed = 0.95 * BLOOD.density * flows**2 * (1 / s_u[both]).mean() * given
        falls, rises = (np.maximum(sign * slope[both], 0).sum() for sign in (-1, 1))
        straight = 1e-3 * np.sqrt(np.pi * s_u[both]).mean()
        steep = falls + rises
        narrows = falls * steep / (steep**2 + straight**2) * filled.mean(axis=1) ** 8
        expected[:, i] = expected[:, i + 1] + friction + narrows * core + (1 - narrows) * mixed
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found - expected)[::2] < 1e-12 * size[::2]).all()
    # Halfway in between on the logarithmic scale; the jet begins at other flows than these.
    assert (np.abs(found - expected)[1::2] < 0.07 * size[1::2]).all()


def test_moved_stenosis_moves_the_drop():
    near, far = (drop_of(LOSSES, FLOW, vessel(at)) for at in (1.0, 2.0))
    # 10 points further; the bump's tail at the inlet is e^(−11), the rest friction alone.
    slope_near, slope_far = np.diff(near), np.diff(far)
    assert np.allclose(slope_far[:, 10:], slope_near[:, :-10], rtol=0, atol=1e-4 * near.max())
    assert near[:, 0] == pytest.approx(far[:, 0], rel=1e-4)


def test_two_stenoses_far_apart_take_twice_the_drop_of_one():
    # A layer at the largest of the three flows needs 1.6 cm to grow by a factor of e.
    z = np.linspace(0, 60, 1201)
    none, one, two = (
        drop_of(LOSSES, FLOW[:, :1], vessel(*at, z=z), z)[:, 0] for at in ((), (5,), (5, 35))
    )
    assert (one - none).max() > 200
    expected = 2 * (one - none)
    assert np.allclose(two - none, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("direction", [1, -1])
def test_modes_give_the_drop_of_a_flow_that_is_stored_on_its_way(direction):
    share = np.sin(np.pi * Z / 8) ** 2
    q, s_u = direction * waveforms()[3], vessel(1.3)
    d = 0.1 * np.roll(waveforms()[2], 4)

    @in_double
    def product(numbers, q, d, share, s_u, z):
        def with_rates(x):
            first = shared_terms.rate(x, 1.0, jnp)
            return x, first, shared_terms.rate(first, 1.0, jnp)

        c, _ = losses.coefficients(numbers, s_u, z, BLOOD)
        signals = with_rates(q), with_rates(d), c.reference_flow
        in_time, rates = map(jnp.stack, losses.modes_in_time(*signals))
        return in_time.T @ losses.modes_in_space(c, share, z), in_time, rates, c

    errors = []
    for size in (1.0, 0.5):
        found, in_time, rates, c = product(LOSSES, q, size * d, share, s_u, Z)
        # The lag is that of the inflow.
        no_lag = changed(jet_lag=0.0)
        flow = q[:, None] - size * d[:, None] * share
        lag = drop_of(LOSSES, q[:, None], s_u) - drop_of(no_lag, q[:, None], s_u)
        expected = drop_of(no_lag, flow, s_u) + lag
        errors.append(np.abs(found - expected).max())
        # The only other difference is the rational term's, beyond the first order in d.
        middle = np.abs(flow[:, 1:] + flow[:, :-1]) / 2 / reference_flow(s_u)
        x = np.abs(q[:, None]) / reference_flow(s_u)
        slope = x * (2 + x) / (1 + x) ** 2
        beyond = middle**2 / (1 + middle) - x**2 / (1 + x) - slope * (middle - x)
        pieces = beyond * (c.forward if direction > 0 else c.back)[1]
        until = np.cumsum(np.pad(pieces, ((0, 0), (1, 0))), axis=1)
        exact = found + until[:, -1:] - until
        assert np.allclose(exact, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    assert errors[0] < 2e-3 * np.abs(expected).max()
    assert errors[0] == pytest.approx(4 * errors[1], rel=0.15)
    # Products of harmonics up to 3 have harmonics up to 6, far from Nyquist's 16; the
    # rational ones have all, of which those above it are folded back.
    derived = rate(in_time[..., None])[..., 0]
    rational = np.isin(np.arange(18) % 8, [4, 5])
    for which, tolerance in ((~rational, 1e-11), (rational, 1e-4)):
        close = {"rtol": 0, "atol": tolerance * np.abs(derived[which]).max()}
        assert np.allclose(rates[which], derived[which], **close)


# ---- correction ------------------------------------------------------------


def test_hidden_share_lies_between_none_and_its_ceiling():
    def share(scale, shift):
        u, y = scale * np.random.default_rng(0).normal(size=(2, 500)) * [[1e6], [1.0]]
        with double_precision():
            return np.asarray(correction.hidden_share(jnp.asarray(ON), u, y, shift, (4,)))

    g = share(1.0, 0.0)
    assert (g > 0).all()
    assert (g < 0.8).all()
    assert np.ptp(g) > 0.1
    assert (share(1.0, 1.0) > g).all()
    for extreme in (share(1e9, 0.0), share(1.0, 1e9), share(1.0, -1e9)):
        assert ((extreme >= 0) & (extreme <= 0.8)).all()


# ---- all coupled -----------------------------------------------------------


@pytest.fixture(scope="module")
def passive():
    return solve()


@pytest.fixture(scope="module")
def corrected():
    return solve(CORRECTED)


@pytest.mark.parametrize("outlet", [OUTLET, np.array([2e4, 8e4, 2e-6, 5e3])])
@pytest.mark.parametrize("n_times", [32, 33])
def test_inlet_flow_and_outlet_law_are_met(outlet, n_times):
    # Whatever an inflow holds: the highest harmonic of 32 time points is Nyquist's.
    inflow = waveforms(np.arange(n_times) / n_times)[WAVEFORM]
    inflow += 0.05 * np.random.default_rng(7).normal(size=inflow.shape)
    grid = Grid(np.arange(n_times) / n_times, Z, 1.0)
    found = solve(CORRECTED.replace(outlet=outlet), inflow, grid=grid)
    assert np.array_equal(found.flow[:, :, 0], inflow)
    r1, r2, compliance, distal = outlet
    omega = 2 * np.pi * np.fft.rfftfreq(n_times, 1 / n_times)
    impedance = r1 + r2 / (1 + 1j * omega * r2 * compliance)
    harmonics = np.fft.rfft(found.flow[:, :, -1], axis=1)
    law = np.fft.irfft(harmonics * impedance, n=n_times, axis=1) + distal
    # The passes may end once Q(L) changes by less than 1e-4 of the largest inflow.
    allowed = 1e-4 * outlet[:2].sum() * INFLOW.max()
    assert np.abs(found.pressure[:, :, -1] - law).max() < allowed


def stored(area):
    """∂V/∂t (case, time, z) of the volume before z, which the closures integrate likewise."""
    pieces = (area[..., 1:] + area[..., :-1]) / 2 * np.diff(Z)
    return rate(np.concatenate([np.zeros((16, 32, 1)), pieces.cumsum(axis=-1)], axis=-1))


def test_what_flows_in_and_not_out_fills_the_vessel(passive):
    filling = -1.3 * stored(passive.area)
    assert np.abs(filling).max() > 0.01
    assert np.allclose(passive.flow - INFLOW[..., None], filling, rtol=0, atol=1e-8)


def test_correction_hides_one_share_of_the_storage_all_along_the_vessel(corrected):
    filling, shown = -1.3 * stored(corrected.area), corrected.flow - INFLOW[..., None]
    there = np.abs(filling[..., -1]) > 0.01 * np.abs(filling).max()
    share = 1 - shown[..., -1] / filling[..., -1]
    assert 0 < share[there].min() < share[there].max() < 0.8
    expected = ((1 - share)[..., None] * filling)[there]
    assert np.allclose(shown[there], expected, rtol=0, atol=1e-7)


def test_area_is_positive_periodic_and_clamped(corrected):
    assert corrected.area.min() > 0
    ends = corrected.area[:, :, [0, -1]]
    assert np.allclose(ends, AREA[:, None, [0, -1]], rtol=1e-14)
    # Nothing jumps from the last time point to the first.
    inside = np.abs(np.diff(corrected.area, axis=1)).max()
    assert np.abs(corrected.area[:, 0] - corrected.area[:, -1]).max() <= inside


def test_wave_shifted_in_time_gives_the_shifted_answer(corrected):
    shifted = solve(CORRECTED, np.roll(INFLOW, 5, axis=1))
    for mine, theirs in zip(shifted[:3], corrected[:3], strict=True):
        expected = np.roll(theirs, 5, axis=1)
        assert np.allclose(mine, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_steady_inflow_gives_steady_flow_and_the_drop_of_the_losses():
    inflow = np.repeat(np.linspace(-1, 2, 16)[:, None], 32, axis=1)
    found = solve(CORRECTED, inflow)
    assert np.allclose(found.flow, inflow[..., None], rtol=0, atol=1e-12)
    for case in (0, 15):
        expected = drop_of(LOSSES, found.flow[case], AREA[case])
        below = found.pressure[case] - found.pressure[case, :, -1:]
        assert np.allclose(below, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_pressure_follows_the_losses_of_the_flow(corrected):
    for case in (0, 15):
        expected = drop_of(LOSSES, corrected.flow[case], AREA[case])
        below = corrected.pressure[case] - corrected.pressure[case, :, -1:]
        # The storage before z is taken in the shares of a uniform pressure.
        assert np.allclose(below, expected, rtol=0, atol=0.01 * np.abs(expected).max())


def test_straight_vessel_among_others_has_no_drop_but_friction_and_inertia():
    area = AREA.copy()
    area[:4] = STRAIGHT
    with_jets = solve(CORRECTED, area=area)
    without = changed(core=1e-9, jet_recovery=1e-9, jet_lag=1e-9)
    without = solve(CORRECTED.replace(losses=without), area=area)
    difference = np.abs(with_jets.pressure - without.pressure).max(axis=(1, 2))
    dynamic = BLOOD.density * (INFLOW.max() / 0.125) ** 2
    assert difference[:4].max() <= 1e-9 * dynamic
    assert difference[4:].min() > 0.01 * dynamic


def test_same_waveform_on_other_time_points_gives_the_same_answer(corrected):
    count = 33  # odd: no harmonic at Nyquist's frequency
    time = np.arange(count) / count
    found = solve(CORRECTED, waveforms(time)[WAVEFORM], grid=Grid(time, Z, 1.0))
    for mine, theirs in zip(found[:3], corrected[:3], strict=True):
        # Trigonometric interpolation, exact for the 15 harmonics that 32 time points resolve.
        spectrum = np.fft.rfft(mine, axis=1)[:, :16] / count
        expected = np.fft.rfft(theirs, axis=1)[:, :16] / 32
        # What the network's tanh adds above them is folded back: 1e-4 of the size.
        assert np.abs(spectrum - expected).max() < 1e-4 * np.abs(expected).max()


def test_absurd_units_are_an_error_that_names_the_first_case():
    # More than one batch: the name counts all cases, and does not depend on who was first.
    which = np.arange(130) % 16
    inflow = INFLOW[which]
    inflow[[71, 105]] *= 1e6  # with these losses the passes settle even at 1e5
    with pytest.raises(SolveError, match=r"case 71 do not settle in 8 .*units"):
        solve(inflow=inflow, area=AREA[which])


def test_too_few_passes_are_an_error_that_says_so():
    once = CONFIG.replace(correction={"passes": 1})
    message = r"case 0 do not settle in 1 .*needs more passes \(correction\.passes"
    with pytest.raises(SolveError, match=message):
        solve(config=once)


def test_many_cases_are_predicted_as_one_by_one(corrected):
    rng = np.random.default_rng(0)
    which = rng.permutation(np.arange(130) % 16)
    many = solve(CORRECTED, INFLOW[which], AREA[which])
    alone = solve(CORRECTED, INFLOW[which[129:]], AREA[which[129:]])
    for name in ("flow", "area", "pressure"):
        found, expected = getattr(many, name), getattr(corrected, name)
        tolerance = 1e-11 * np.abs(expected).max()
        assert np.allclose(found, expected[which], rtol=0, atol=tolerance)
        assert np.allclose(getattr(alone, name)[0], found[129], rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", ["wall", "losses", "z", "physics"])
def test_what_is_kept_of_vessels_is_that_of_the_same_equations_only(name):
    """One engine serves all models: each prediction is that without any stored vessels."""
    other = {"parameters": PASSIVE, "grid": GRID, "config": CONFIG}
    if name == "z":
        other["grid"] = Grid(TIME, 1.1 * Z, 1.0)
    elif name == "physics":
        other["config"] = CONFIG.replace(physics={"density": 1.2})
    else:
        other["parameters"] = PASSIVE.replace(**{name: 1.1 * getattr(PASSIVE, name)})
    solve()
    found = solve(**other)
    _distinct_vessels.cache_clear()
    expected = solve(**other)
    assert np.array_equal(found.pressure, expected.pressure)
    assert not np.array_equal(found.pressure, solve().pressure)


@pytest.mark.parametrize("outlet", [OUTLET, np.array([2e4, 8e4, 2e-6, 5e3])])
def test_passes_end_at_the_answer_of_many_more(outlet):
    parameters = CORRECTED.replace(outlet=outlet)
    found = solve(parameters, config=CONFIG.replace(correction={"passes": 60}))
    # Passes that do not end when settled, as the fit makes them.
    points, many = np.arange(41), CONFIG.replace(correction={"passes": 40})
    closures = select_engine("jax").closures
    problem = closures.flow(parameters, ModelInputs(INFLOW, AREA, GRID), points, many)
    expected, _ = problem(parameters.correction)
    assert np.abs(found.flow - expected).max() < 1e-9 * INFLOW.max()


def test_reversing_flow_changes_nothing_for_the_cases_beside_it(corrected):
    inflow = INFLOW.copy()
    inflow[3] = 2.5 * (inflow[3] - inflow[3].mean()) + 0.5
    assert inflow[3].min() < -0.3
    found = solve(CORRECTED, inflow)
    beside = np.arange(16) != 3
    for mine, theirs in zip(found[:3], corrected[:3], strict=True):
        expected = theirs[beside]
        assert np.allclose(mine[beside], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.array_equal(found.flow[3, :, 0], inflow[3])
    expected = drop_of(LOSSES, found.flow[3], AREA[3])
    below = found.pressure[3] - found.pressure[3, :, -1:]
    assert np.allclose(below, expected, rtol=0, atol=0.01 * np.abs(expected).max())


# ---- parameters ------------------------------------------------------------


def test_parameters_have_the_lengths_that_the_configuration_needs():
    counts = {"outlet": 4, "losses": 10, "wall": 5, "wall_shear_stress": 9, "correction": 4 + 17}
    assert sizes(CONFIG) == counts
    deeper = CONFIG.replace(wall={"law": "local"}, correction={"hidden": (3, 2)})
    assert (sizes(deeper)["wall"], sizes(deeper)["correction"]) == (3, 4 + 9 + 8 + 3)
    PASSIVE.check(CONFIG)
    for wrong in (
        {"wall": MEMBRANE[:3]},
        {"correction": OFF[:-1]},
        {"losses": changed(core=np.nan)},
    ):
        with pytest.raises(InputError, match=rf"The {next(iter(wrong))} parameters (have|are not)"):
            PASSIVE.replace(**wrong).check(CONFIG)
    with pytest.raises(InputError, match=r"wall\.law is 'auto'"):
        PASSIVE.check(PHYSICS)
    with pytest.raises(ValueError, match="read-only"):
        PASSIVE.wall[0] = 1.0
