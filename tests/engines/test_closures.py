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
    solve,
    vessel,
    waveforms,
)

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import select_engine, shared_terms
from pcnde_bridge.engines.closure_parameters import sizes
from pcnde_bridge.engines.jax.closures import (
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
    compiled = jax.jit(partial(function, **static))

    def call(*arguments):
        with double_precision():
            return jax.tree.map(np.asarray, compiled(*map(jnp.asarray, arguments)))

    return call


displacement = in_double(wall.displacement, law="membrane")
drop = in_double(losses.drop, physics=BLOOD)
jet_area = in_double(losses.jet_area)


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
JET = np.array([0.0, 0.0, 0.9, 0.12])


def test_straight_vessel_has_poiseuilles_and_the_inertial_drop():
    found = drop(LOSSES, FLOW, STRAIGHT, Z, 1.0)
    friction = 1.2 * 8 * np.pi * BLOOD.viscosity / 0.125**2 * FLOW
    inertia = 1.1 * BLOOD.density / 0.125 * rate(FLOW)
    expected = (friction + inertia) * (4 - Z)
    assert np.allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_straight_vessel_has_no_jet():
    assert (drop(JET, FLOW, STRAIGHT, Z, 1.0) == 0).all()
    assert (drop(JET, -FLOW, STRAIGHT, Z, 1.0) == 0).all()


def test_sudden_widening_loses_what_borda_and_carnot_say():
    z = np.linspace(0, 20, 10_001)
    narrow, wide = 0.05, 0.125
    # Narrows smoothly over 2 cm, opens at once at 5 cm; the jet fills the vessel 0.6 cm later.
    ramp = np.clip((z - 2) / 2, 0, 1)
    s_u = wide + (narrow - wide) * (3 * ramp**2 - 2 * ramp**3)
    s_u[z > 5] = wide
    found = drop(JET, np.full((32, z.size), 1.5), s_u, z, 1.0)
    expected = 0.9 * BLOOD.density * 1.5**2 / 2 * (1 / narrow - 1 / wide) ** 2
    assert found[0, 0] == pytest.approx(expected, rel=0.01)
    # What the narrowing took alone is Bernoulli's, most of which the jet gives back.
    taken = found[0, 0] - found[0, np.searchsorted(z, 4.5)]
    bernoulli = 0.9 * BLOOD.density * 1.5**2 / 2 * (1 / narrow**2 - 1 / wide**2)
    assert taken == pytest.approx(bernoulli, rel=1e-3)


def test_a_flow_that_fills_the_vessel_gets_back_what_it_gave():
    filled = np.array([0.0, 0.0, 0.9, 1e3])  # a jet that spreads as fast as any vessel
    for z in (Z, np.array([0.0, 0.7, 1.1, 1.4, 1.5, 1.9, 2.6, 4.0])):
        s_u = vessel(1.3, blockage=0.8, z=z)
        s_u[-1] = s_u[0]
        found = drop(filled, np.full((32, z.size), 1.5), s_u, z, 1.0)
        gained = 0.9 * BLOOD.density * 1.5**2 / 2 * (1 / s_u**2 - 1 / s_u[0] ** 2)
        assert np.allclose(found, -gained, rtol=0, atol=1e-12 * gained.max())


def test_drop_hardly_depends_on_the_points():
    drops = []
    for n in (161, 1601):
        z = np.linspace(0, 4, n)
        s_u = vessel(1.0, 2.6, blockage=0.8, z=z)
        drops.append(drop(JET, np.full((32, n), 1.5), s_u, z, 1.0)[0, 0])
    assert drops[0] == pytest.approx(drops[1], rel=0.007)


def test_reversed_flow_through_the_mirrored_vessel_has_the_opposite_drop():
    s_u, flow = vessel(1.3), FLOW * (1 - 0.02 * Z)
    there = drop(LOSSES, flow, s_u, Z, 1.0)
    back = drop(LOSSES, -flow[:, ::-1], s_u[::-1], Z, 1.0)
    expected = there[:, ::-1] - there[:, :1]
    assert np.allclose(back, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    # The jet makes it another drop than that of the same vessel.
    assert np.abs(drop(LOSSES, -flow, s_u, Z, 1.0) + there).max() > 0.1 * np.abs(there).max()


@pytest.mark.parametrize("spread", [0.05, 0.12, 5.0])
def test_jet_grows_by_the_spread_until_it_fills_the_vessel(spread):
    s_u, steps = vessel(1.1, 2.4, blockage=0.7), np.diff(Z)
    expected = s_u.copy()
    for i, step in enumerate(steps):
        jet = np.pi * (np.sqrt(expected[i] / np.pi) + spread * step) ** 2
        expected[i + 1] = min(s_u[i + 1], jet)
    found = jet_area(s_u, steps, spread)
    assert np.allclose(found, expected, rtol=1e-12)
    separated = (found < 0.999 * s_u).any()
    assert separated == (spread < 1)


def test_moved_stenosis_moves_the_drop():
    near, far = (drop(LOSSES, FLOW, vessel(at), Z, 1.0) for at in (1.0, 2.0))
    # 10 points further; the bump's tail at the inlet is e^(−11), the rest friction alone.
    slope_near, slope_far = np.diff(near), np.diff(far)
    assert np.allclose(slope_far[:, 10:], slope_near[:, :-10], rtol=0, atol=1e-4 * near.max())
    assert near[:, 0] == pytest.approx(far[:, 0], rel=1e-4)


def test_two_stenoses_far_apart_take_twice_the_drop_of_one():
    z = 2 * Z
    one, two = (drop(JET, FLOW, vessel(*at, z=z), z, 1.0) for at in ((2,), (2, 5.4)))
    assert one[:, 0].min() > 5
    assert np.allclose(two[:, 0], 2 * one[:, 0], rtol=1e-6)


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

        c = losses.coefficients(numbers, s_u, z, BLOOD)
        in_time, rates = map(jnp.stack, losses.modes_in_time(with_rates(q), with_rates(d)))
        return in_time.T @ losses.modes_in_space(c, share, z), in_time, rates

    found, in_time, rates = product(LOSSES, q, d, share, s_u, Z)
    expected = drop(LOSSES, q[:, None] - d[:, None] * share, s_u, Z, 1.0)
    assert np.allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    # Products of harmonics up to 3 have harmonics up to 6, far from Nyquist's 16.
    derived = rate(in_time[..., None])[..., 0]
    assert np.allclose(rates, derived, rtol=0, atol=1e-11 * np.abs(derived).max())


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
        expected = drop(LOSSES, found.flow[case], AREA[case], Z, 1.0)
        below = found.pressure[case] - found.pressure[case, :, -1:]
        assert np.allclose(below, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_pressure_follows_the_losses_of_the_flow(corrected):
    for case in (0, 15):
        expected = drop(LOSSES, corrected.flow[case], AREA[case], Z, 1.0)
        below = corrected.pressure[case] - corrected.pressure[case, :, -1:]
        # The storage before z is taken in the shares of a uniform pressure.
        assert np.allclose(below, expected, rtol=0, atol=0.01 * np.abs(expected).max())


def test_straight_vessel_among_others_has_no_drop_but_friction_and_inertia():
    area = AREA.copy()
    area[:4] = STRAIGHT
    with_jets = solve(CORRECTED, area=area)
    without = solve(CORRECTED.replace(losses=LOSSES * [1, 1, 1e-9, 1]), area=area)
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
    inflow[[71, 105]] *= 1e4
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
    expected = drop(LOSSES, found.flow[3], AREA[3], Z, 1.0)
    below = found.pressure[3] - found.pressure[3, :, -1:]
    assert np.allclose(below, expected, rtol=0, atol=0.01 * np.abs(expected).max())


# ---- parameters ------------------------------------------------------------


def test_parameters_have_the_lengths_that_the_configuration_needs():
    assert sizes(CONFIG) == {"outlet": 4, "losses": 4, "wall": 5, "correction": 4 + 17}
    deeper = CONFIG.replace(wall={"law": "local"}, correction={"hidden": (3, 2)})
    assert (sizes(deeper)["wall"], sizes(deeper)["correction"]) == (3, 4 + 9 + 8 + 3)
    PASSIVE.check(CONFIG)
    for wrong in (
        {"wall": MEMBRANE[:3]},
        {"correction": OFF[:-1]},
        {"losses": LOSSES * [1, 1, 1, np.nan]},
    ):
        with pytest.raises(InputError, match=rf"The {next(iter(wrong))} parameters (have|are not)"):
            PASSIVE.replace(**wrong).check(CONFIG)
    with pytest.raises(InputError, match=r"wall\.law is 'auto'"):
        PASSIVE.check(PHYSICS)
    with pytest.raises(ValueError, match="read-only"):
        PASSIVE.wall[0] = 1.0
