import math
from functools import partial

import numpy as np
import pandas as pd
import pytest
from helpers import compiled_quickly
from scipy.integrate import trapezoid

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.hemodynamics.discretization import discretize
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import (
    CoronaryOutlet,
    Reflection,
    Windkessel,
    outlet_resistance,
)
from pcnde_bridge.hemodynamics.pressure_losses import pressure_drop
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.tube_laws import (
    PAPER_REFERENCE_PRESSURE,
    LinearWall,
    OlufsenWall,
)
from pcnde_bridge.hemodynamics.waveform import Waveform, coronary

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.UnitsWarning")

RESISTANCE = 109_237.0
STIFF = LinearWall(young_modulus=1e13)
HEALTHY = math.pi * 0.04


def straight(length, n_points, area=HEALTHY, n_cases=1):
    return np.linspace(0.0, length, n_points), np.full((n_cases, n_points), area)


def relative(ours, theirs):
    return np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)


# ---- analytic solutions --------------------------------------------------------------


@pytest.mark.parametrize("profile_exponent", [2.0, 9.0])
def test_poiseuille_drop_in_a_rigid_tube(profile_exponent):
    z, area = straight(4.0, 41, n_cases=2)
    tube = Tube1D(wall=STIFF, profile_exponent=profile_exponent, n_times=4, steps=20)
    flow = np.array([0.5, 2.0])
    cases = tube.solve(area, [Waveform(q) for q in flow], Windkessel(RESISTANCE), z=z)
    # 2(ζ + 2)πμQL/S², which is 8πμQL/S² for the parabola.
    per_length = 2 * (profile_exponent + 2) * math.pi * 0.04 * flow / HEALTHY**2
    expected = RESISTANCE * flow[:, None] + per_length[:, None] * (4.0 - z)
    np.testing.assert_allclose(cases.pressure[:, -1], expected, rtol=1e-6)
    drop = cases.pressure[:, -1, 0] - cases.pressure[:, -1, -1]
    np.testing.assert_allclose(drop, 4.0 * per_length, rtol=1e-4)


def test_rigid_stenosis_without_loss_recovers_its_pressure():
    """Convection alone is reversible: −(1 + δ)ρ/2·Δ(Q²/S²) down, and up again."""
    vessel = Vessel((Stenosis(0.6, length=1.0),))
    tube = Tube1D(wall=STIFF, stenosis_loss="none", viscosity=1e-9, n_times=4, steps=20)
    cases = tube.solve([vessel], [Waveform(2.0)], Windkessel(RESISTANCE), n_points=201)
    pressure = cases.pressure[0, -1]
    dip = 4 / 3 * 1.06 / 2 * 4.0 * ((0.4 * HEALTHY) ** -2 - HEALTHY**-2)
    assert pressure[0] - pressure[100] == pytest.approx(dip, rel=0.01)
    assert abs(pressure[0] - pressure[-1]) < 1e-4 * dip


@pytest.mark.parametrize(
    "vessel",
    [
        Vessel((Stenosis(0.7),)),
        Vessel((Stenosis(0.5, position=1.234, length=0.77), Stenosis(0.8, position=3.0))),
    ],
)
def test_seeley_young_drop_comes_out_whole(vessel):
    flow = 1.7
    tube = Tube1D(wall=STIFF, n_times=4, steps=20)
    cases = tube.solve([vessel], [Waveform(flow)], Windkessel(RESISTANCE), n_points=201)
    loss = sum(
        pressure_drop(flow, HEALTHY, HEALTHY * (1 - s.blockage), s.length) for s in vessel.stenoses
    )
    healthy = vessel.length - sum(s.length for s in vessel.stenoses)
    loss += 8 * math.pi * 0.04 * flow * healthy / HEALTHY**2
    drop = cases.pressure[0, -1, 0] - cases.pressure[0, -1, -1]
    assert drop == pytest.approx(loss, rel=1e-3)


@pytest.mark.parametrize("loss", ["paper", "effective_length"])
def test_friction_of_a_stenosis_follows_the_velocity_profile(loss):
    """A stenosis that blocks nothing drops the pressure as the healthy wall does."""
    z, area = straight(4.0, 41, n_cases=2)
    drops = {}
    for exponent in (2.0, 9.0):
        tube = Tube1D(
            wall=STIFF, stenosis_loss=loss, profile_exponent=exponent, n_times=4, steps=20
        )
        stenoses = [[], [Stenosis(0.0, position=2.0, length=1.0)]]
        cases = tube.solve(area, [Waveform(2.0)] * 2, Windkessel(1e5), z=z, stenoses=stenoses)
        drops[exponent] = cases.pressure[:, -1, 0] - cases.pressure[:, -1, -1]
    np.testing.assert_allclose(drops[9.0] / drops[2.0], 11 / 4, rtol=1e-4)
    if loss == "paper":
        assert drops[9.0][1] == pytest.approx(drops[9.0][0], rel=1e-4)


def test_outlet_keeps_resistance_and_distal_pressure():
    outlet = Windkessel(np.array([5e4, 2e5]), distal_pressure=[0.0, 2e4])
    tube = Tube1D(n_times=20, steps=100)
    cases = tube.solve([Vessel()] * 2, coronary().family([1.0, 0.5]), outlet, n_points=41)
    expected = outlet.resistance[:, None] * cases.flow[:, :, -1]
    expected += np.array([0.0, 2e4])[:, None]
    np.testing.assert_allclose(cases.pressure[:, :, -1], expected, rtol=1e-12)


def test_windkessel_has_its_impedance():
    proximal, distal, capacitance, period = 2e4, 9e4, 2e-6, 1.0
    waveform = Waveform(1.2, (0.5,), (0.0,), period)
    tube = Tube1D(wall=STIFF, n_times=20, steps=400, cycles=6)
    outlet = Windkessel(proximal, distal, capacitance, 1e3)
    z, area = straight(1.0, 41)
    pressure = tube.solve(area, [waveform], outlet, z=z).pressure[0, :, -1]
    omega = 2 * math.pi / period
    impedance = proximal + distal / (1 + 1j * omega * distal * capacitance)
    wave = np.exp(1j * omega * np.arange(20) * period / 20)
    expected = 1e3 + 1.2 * (proximal + distal) + (0.5 * impedance * wave).real
    np.testing.assert_allclose(pressure, expected, rtol=1e-4)


# A short pulse in a long tube of nearly no viscosity, so small that all is linear.
PULSE_PERIOD, PULSE_LENGTH = 0.05, 40.0
WAVE_SPEED = math.sqrt(5e6 / 2 / 1.06)
IMPEDANCE = 1.06 * WAVE_SPEED / HEALTHY
REFLECTIONS = {1.0: 0.0, 3.0: 0.5, 1 / 3: -0.5}  # outlet over impedance: (m − 1)/(m + 1)


@pytest.fixture(scope="module")
def pulses():
    time = np.arange(200) * (PULSE_PERIOD / 200)
    pulse = 0.01 * np.exp(-(((time - 0.005) / 0.0012) ** 2) / 2)
    waveform = Waveform.from_samples(pulse, period=PULSE_PERIOD, n_terms=24)
    z, area = straight(PULSE_LENGTH, 401, n_cases=len(REFLECTIONS))
    tube = Tube1D(viscosity=1e-8, n_times=1000, steps=1000, cycles=1)
    outlet = Windkessel(IMPEDANCE * np.array(list(REFLECTIONS)))
    return tube.solve(area, [waveform] * len(REFLECTIONS), outlet, z=z)


def peak(time, values):
    """Time and height of the largest value, by a parabola through three samples."""
    k = int(np.argmax(np.abs(values)))
    a, b, _ = np.polyfit(time[k - 1 : k + 2] - time[k], values[k - 1 : k + 2], 2)
    return time[k] - b / (2 * a), values[k] - b**2 / (4 * a)


def test_pulse_travels_at_the_wave_speed(pulses):
    arrivals = [peak(pulses.time[:500], pulses.pressure[0, :500, i])[0] for i in (50, 300)]
    assert 25.0 / (arrivals[1] - arrivals[0]) == pytest.approx(WAVE_SPEED, rel=2e-3)


def test_pulse_has_the_characteristic_impedance(pulses):
    _, height = peak(pulses.time[:500], pulses.pressure[0, :500, 100])
    assert height == pytest.approx(0.01 * IMPEDANCE, rel=1e-2)


def test_outlet_reflects_by_its_mismatch(pulses):
    # At 20 cm the pulse passes at 18 ms, and comes back from the outlet at 44 ms.
    middle, later = 200, pulses.time > 0.031
    for pressure, expected in zip(pulses.pressure[:, :, middle], REFLECTIONS.values(), strict=True):
        _, incident = peak(pulses.time[~later], pressure[~later])
        _, reflected = peak(pulses.time[later][1:-1], pressure[later][1:-1])
        assert reflected / incident == pytest.approx(expected, abs=5e-3)


# ---- accuracy and conservation -------------------------------------------------------


def order(solutions):
    """Observed order from three solutions, each with half the step of the one before."""
    coarse, middle, fine = solutions
    return math.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))


@pytest.mark.parametrize("field", ["flow", "area", "pressure"])
@pytest.mark.parametrize("runs", ["in_time", "in_space"])
def test_second_order(runs, field, request):
    solutions = [getattr(cases, field) for cases in request.getfixturevalue(runs)]
    stride = [(s.shape[2] - 1) // 40 for s in solutions]
    on_common_points = [s[:, :, ::k] for s, k in zip(solutions, stride, strict=True)]
    assert order(on_common_points) == pytest.approx(2.0, abs=0.15)


def order_study(steps, n_points):
    vessel = Vessel((Stenosis(0.6, length=1.0),))
    waveforms = coronary().family([1.0, 1.75])
    tube = Tube1D(steps=steps, n_times=20)
    return tube.solve([vessel] * 2, waveforms, Windkessel(RESISTANCE), n_points=n_points)


@pytest.fixture(scope="module")
def in_time():
    return [order_study(steps, 41) for steps in (100, 200, 400)]


@pytest.fixture(scope="module")
def in_space():
    return [order_study(100, n_points) for n_points in (41, 81, 161)]


def test_volume_is_conserved_and_the_cycle_is_periodic(in_time, in_space):
    for cases in (*in_time, *in_space):
        assert cases.labels["volume_balance"].max() < 1e-12
        assert cases.labels["periodicity"].max() < 1e-10


def test_volume_of_the_returned_cycle_balances(in_time):
    """The data set obeys dV/dt = Q(0) − Q(L), within what 20 time points resolve."""
    cases = in_time[-1]
    volume = trapezoid(cases.area, cases.z, axis=2)
    frequency = 2j * np.pi * np.arange(11)
    rate = np.fft.irfft(frequency * np.fft.rfft(volume, axis=1), n=20, axis=1)
    net = cases.flow[:, :, 0] - cases.flow[:, :, -1]
    assert relative(rate, net) < 0.02


def test_area_and_pressure_obey_the_wall_law(in_time):
    cases = in_time[0]
    expected = LinearWall().pressure(cases.area, cases.area_undeformed[:, None])
    np.testing.assert_allclose(cases.pressure, expected, rtol=1e-9)
    np.testing.assert_allclose(cases.inflow[0], coronary().samples(20), atol=1e-9)


def test_batch_does_not_change_a_case(in_time):
    vessels = [Vessel((Stenosis(0.6, length=1.0),)), Vessel()]
    waveforms = [coronary(), Waveform(0.3)]
    tube = Tube1D(steps=100, n_times=20)
    cases = tube.solve(vessels, waveforms, Windkessel([RESISTANCE, 1e4]), n_points=41)
    np.testing.assert_allclose(cases.flow[0], in_time[0].flow[0], rtol=1e-7)


def test_groups_of_cases_are_computed_side_by_side():
    z, area = straight(4.0, 41, n_cases=33)
    waveforms = [Waveform(0.5 + 0.05 * k) for k in range(33)]
    cases = Tube1D(n_times=4, steps=20, cycles=1).solve(area, waveforms, Windkessel(1e5), z=z)
    np.testing.assert_allclose(cases.inflow[:, -1], [w.mean for w in waveforms])
    alone = Tube1D(n_times=4, steps=20, cycles=1).solve(
        area[:1], waveforms[:1], Windkessel(1e5), z=z
    )
    np.testing.assert_allclose(cases.pressure[0], alone.pressure[0], rtol=1e-9)


# ---- published examples --------------------------------------------------------------

# Cases and expected pressures at the inlet from the tests of svOneDSolver
# (SimVascular/svOneDSolver, tests/): 100 mL/s through a nearly rigid tube.
SV_TUBE = Tube1D(
    wall=OlufsenWall(1e15, -20.0, 1e9), stenosis_loss="effective_length", n_times=4, steps=100
)


@pytest.mark.parametrize(
    ("name", "outlet", "inlet_pressure", "outlet_pressure"),
    [
        ("tube_r", Windkessel(100.0), 11005.30965, 10000.0),
        ("tube_r_Pd", Windkessel(100.0, distal_pressure=1000.0), 12005.30965, 11000.0),
        ("tube_rcr", Windkessel(50.0, 50.0, 0.001), 11005.30965, 10000.0),
        ("tube_rcr_Pd", Windkessel(50.0, 50.0, 0.001, 1000.0), 12005.30965, 11000.0),
    ],
)
def test_svonedsolver_straight_tube(name, outlet, inlet_pressure, outlet_pressure):
    z, area = straight(10.0, 51, area=1.0)
    cases = SV_TUBE.solve(area, [Waveform(100.0)], outlet, z=z)
    pressure = cases.pressure[0, -1]
    assert pressure[0] - pressure[-1] == pytest.approx(inlet_pressure - outlet_pressure, rel=1e-3)
    assert pressure[0] == pytest.approx(inlet_pressure, rel=1e-6)
    assert pressure[-1] == pytest.approx(outlet_pressure, rel=1e-6)


def test_svonedsolver_tube_with_stenosis():
    """tube_stenosis_r: 10 cm each of 10, 5 and 10 cm²; 10150.68211 dyn/cm² at the inlet."""
    z = np.linspace(0.0, 30.0, 151)
    area = np.where((z > 10.0) & (z < 20.0), 5.0, 10.0)[None]
    stenosis = Stenosis(0.5, position=15.0, length=10.0)
    cases = SV_TUBE.solve(area, [Waveform(100.0)], Windkessel(100.0), z=z, stenoses=[[stenosis]])
    pressure = cases.pressure[0, -1]
    assert pressure[0] == pytest.approx(10150.68211, rel=1e-4)
    assert pressure[0] - pressure[-1] == pytest.approx(150.68211, rel=1e-2)


# ---- the baseline --------------------------------------------------------------------


def test_solve_like_finds_outlet_and_stenosis():
    vessels = [Vessel((Stenosis(0.7, position=1.8, length=1.0),)), Vessel()]
    tube = Tube1D(n_times=20, steps=100)
    truth = tube.solve(vessels, coronary().family([1.0, 1.5]), Windkessel(9e4), n_points=41)
    assert outlet_resistance(truth) == pytest.approx(9e4, rel=1e-9)
    again = tube.solve_like(truth, stenosis_length=1.0)
    for name in ("flow", "area", "pressure"):
        assert relative(getattr(again, name), getattr(truth, name)) < 1e-4
    assert list(again.labels) == list(truth.labels)


@pytest.mark.parametrize(
    "shape",
    [
        1 - 0.2 * np.linspace(0, 1, 101),
        1 + np.linspace(0, 1, 101),
        (1 - np.linspace(0, 0.4, 101)) ** 2,
    ],
)
def test_a_taper_is_no_stenosis(shape):
    z = np.linspace(0.0, 4.0, 101)
    tube = Tube1D(n_times=20, steps=100)
    cases = tube.solve([HEALTHY * shape], [coronary()], OUTLET, z=z)
    again = tube.solve_like(cases, OUTLET)
    np.testing.assert_allclose(again.pressure, cases.pressure, rtol=1e-9)


def test_stenosis_of_a_tapering_vessel_is_found():
    z = np.linspace(0.0, 4.0, 101)
    narrow = Vessel((Stenosis(0.6, position=1.2),)).area_undeformed(z) * (1 - 0.5 * z / 4)
    tube = Tube1D(n_times=20, steps=100)
    stenosis = Stenosis(1 - narrow[30] / narrow[23], position=1.2)
    cases = tube.solve([narrow], [coronary()], OUTLET, z=z, stenoses=[[stenosis]])
    again = tube.solve_like(cases, OUTLET)
    np.testing.assert_allclose(again.pressure, cases.pressure, rtol=1e-9)


@pytest.mark.data
def test_the_papers_test_cases(published_cases):
    """The paper's 1D FEM column is met by its own wall law less the factor 4/3."""
    data = published_cases.split("paper").test
    wall = LinearWall(0.75 * 1.5e7, reference_pressure=PAPER_REFERENCE_PRESSURE)
    ours = Tube1D(wall=wall).solve_like(data)
    errors = [
        relative(ours.flow, data.flow),
        relative(ours.area[:, :, 5:-5], data.area[:, :, 5:-5]),
        relative(ours.pressure, data.pressure),
    ]
    np.testing.assert_allclose(errors, [0.0204, 0.0498, 0.0365], rtol=0.04)
    assert ours.labels["periodicity"].max() < 1e-10
    assert ours.labels["volume_balance"].max() < 1e-12


# ---- walls, outlets and inlets -------------------------------------------------------

SHORT = {"n_times": 20, "steps": 100}


def test_new_walls_and_grids_compile_nothing():
    from pcnde_bridge.hemodynamics import tr_bdf2

    def solve(modulus, length, n_cases):
        z, area = straight(length, 41, n_cases=n_cases)
        wall = LinearWall(modulus, reference_pressure=modulus / 1e3)
        tube = Tube1D(wall, n_times=20, steps=100, cycles=2, viscosity=modulus / 1e9)
        return tube.solve(area, [coronary()] * n_cases, Windkessel(modulus / 1e2), z=z)

    before = tr_bdf2.cycle._cache_size()
    solve(1.0e7, 4.0, 7)
    compiled = tr_bdf2.cycle._cache_size()
    assert compiled <= before + 1  # of both cycles
    for k in range(20):
        solve(1.0e7 + 1e5 * k, 4.0 + 0.1 * k, 5 + k % 4)
    assert tr_bdf2.cycle._cache_size() == compiled


def test_stiffness_along_z_and_for_each_case():
    z, area = straight(4.0, 41, n_cases=2)
    plaque = np.where(np.abs(z - 2.0) < 0.5, 1.5e8, 1.5e7)
    wall = LinearWall(np.stack([plaque, np.full(41, 3.0e7)]))
    tube = Tube1D(wall, **SHORT)
    cases = tube.solve(area, [coronary()] * 2, OUTLET, z=z)
    strain = np.sqrt(cases.area / HEALTHY) - 1.0
    expected = wall.young_modulus[:, None] / 3.0 * strain
    # Young's moduli of the cells on both sides of a jump are averaged.
    inside = np.r_[1:14, 17:24, 27:40]
    np.testing.assert_allclose(cases.pressure[..., inside], expected[..., inside], rtol=1e-9)
    alone = Tube1D(LinearWall(3.0e7), **SHORT).solve(area[:1], [coronary()], OUTLET, z=z)
    np.testing.assert_allclose(cases.flow[1], alone.flow[0], rtol=1e-6)
    with pytest.raises(InputError, match=r"wall.young_modulus has the shape \(3,\)"):
        Tube1D(LinearWall([1e7] * 3)).solve(area, [coronary()] * 2, OUTLET, z=z)


def test_viscoelastic_wall_attenuates_as_the_dispersion_relation_says():
    """A small wave exp(i(ωt − kz)) with ω² = k²·c²·(1 + iωτ), and its reflection at the outlet."""
    period, tau, length = 0.02, 4e-4, 20.0
    z, area = straight(length, 401)
    tube = Tube1D(LinearWall(retardation_time=tau), viscosity=0.0, n_times=100, steps=400, cycles=8)
    cases = tube.solve(area, [Waveform(0.0, (0.001,), (0.0,), period)], Reflection(), z=z)
    omega = 2 * np.pi / period
    damped = np.sqrt(1 + 1j * omega * tau)
    number = omega / WAVE_SPEED / damped
    # The outlet has the impedance of the elastic vessel, that of this one is damped·ρ·c/S.
    mismatch = (1 - damped) / (1 + damped)
    wave = np.exp(-1j * number * z) - mismatch * np.exp(-1j * number * (2 * length - z))
    found = np.fft.fft(cases.flow[0], axis=0)[1]
    assert relative(found / found[0], wave / wave[0]) < 5e-3
    assert abs(wave[-1] / wave[0]) < 0.85


def test_pressure_inlet_is_the_flow_inlets_counterpart():
    given = coronary()
    tube = Tube1D(n_times=100, steps=500)
    first = tube.solve([Vessel()], [given], OUTLET, n_points=41)
    pressure = Waveform.from_samples(first.pressure[0, :, 0], n_terms=None)
    again = tube.solve([Vessel()], [pressure], OUTLET, n_points=41, inlet="pressure")
    assert relative(again.flow, first.flow) < 2e-3
    np.testing.assert_allclose(again.pressure[0, :, 0], first.pressure[0, :, 0], rtol=1e-12)
    assert again.labels["volume_balance"].max() < 1e-12


def test_coronary_outlet_in_a_rigid_tube():
    from scipy.integrate import solve_ivp

    muscle = Waveform(4e4, (-3e4, 5e3), (2e4, 0.0))
    r_a, r_am, r_v, c_a, c_im = 3e4, 5e4, 2e4, 4e-7, 3e-6
    outlet = CoronaryOutlet(r_a, r_am, r_v, c_a, c_im, muscle, 5e3)
    inflow = coronary()
    z, area = straight(0.4, 5)
    tube = Tube1D(STIFF, n_times=20, steps=8000, cycles=4)
    cases = tube.solve(area, [inflow], outlet, z=z)

    def slopes(t, y):  # y holds p₁ and p₂ − p_im
        p_2 = y[1] + muscle.flow(t)
        through = (y[0] - p_2) / r_am
        return [(inflow.flow(t) - through) / c_a, (through - (p_2 - 5e3) / r_v) / c_im]

    times = 3.0 + cases.time
    found = solve_ivp(slopes, (0, 4), [0, 0], "DOP853", t_eval=times, rtol=1e-11, atol=1e-6)
    expected = found.y[0] + r_a * inflow.flow(times)
    np.testing.assert_allclose(cases.pressure[0, :, -1], expected, rtol=1e-6)


def test_distal_pressure_may_vary_in_time():
    distal = Waveform(2e4, (5e3,), (0.0,))
    outlet = Windkessel(1e5, distal_pressure=distal)
    cases = Tube1D(**SHORT).solve([Vessel()], [coronary()], outlet, n_points=41)
    expected = 1e5 * cases.flow[0, :, -1] + distal.samples(20)
    np.testing.assert_allclose(cases.pressure[0, :, -1], expected, rtol=1e-12)


def test_flat_profile_without_friction():
    z, area = straight(4.0, 41)
    area[:, 20:] *= 0.8
    # A stiffer wall has more round-off in the pressure.
    wall = LinearWall(young_modulus=1e11)
    tube = Tube1D(wall, viscosity=0.0, momentum_correction=1.0, n_times=4, steps=20)
    cases = tube.solve(area, [Waveform(2.0)], OUTLET, z=z)
    pressure, (first, *_, last) = cases.pressure[0, -1], cases.area[0, -1]
    bernoulli = 1.06 / 2 * 4.0 * (last**-2 - first**-2)
    assert pressure[0] - pressure[-1] == pytest.approx(bernoulli, rel=5e-7)


# ---- runs ----------------------------------------------------------------------------


def test_a_run_goes_on_from_a_state_and_stops_when_it_is_periodic():
    slow = Windkessel(1e4, 1e5, 3e-6)  # a time constant of 0.3 s
    z, area = straight(4.0, 41)
    given = z, area, [coronary()], slow
    whole = Tube1D(cycles=4, **SHORT)
    problem = discretize(whole, *given)
    half = Tube1D(cycles=2, **SHORT)
    again = half.run(problem, half.run(problem).state)
    np.testing.assert_array_equal(again.cases.pressure, whole.run(problem).cases.pressure)
    stopped = Tube1D(cycles=50, tolerance=1e-6, **SHORT).run(problem)
    assert 1e-9 < stopped.cases.labels["periodicity"][0] <= 1e-6
    stress = 4 * 0.04 * again.cases.velocity() / np.sqrt(again.cases.area / np.pi)
    np.testing.assert_allclose(again.cases.wall_shear_stress, stress, rtol=1e-12)
    with pytest.raises(InputError, match="another number of cases"):
        half.run(discretize(half, z[:-1], area[:, :-1], *given[2:]), again.state)


def test_other_cases_are_returned_when_one_diverges():
    waveforms = [Waveform(0.5), Waveform(-5.0), Waveform(0.6)]
    z, area = straight(4.0, 41, n_cases=3)
    tube = Tube1D(**SHORT)
    rest = [2e5, 0.0, 1e5]
    problem = discretize(tube, z, area, waveforms, Windkessel(1e7), initial_pressure=rest)
    solution = tube.run(problem)
    assert list(solution.failures) == [1]
    assert "Case 1" in solution.failures[1]
    assert solution.cases.labels["geometry"].tolist() == [1, 3]
    np.testing.assert_array_equal(solution.cases.inflow[:, 0], [0.5, 0.6])
    with pytest.raises(SolveError, match="Case 1"):
        solution.check()


def test_a_choked_throat_is_recognized():
    """The vessel empties until the flow, slower than the pulse wave at S_u, chokes the throat."""
    wall = LinearWall(5e5, reference_pressure=1e5)
    tube = Tube1D(wall, stenosis_loss="none", n_times=20, steps=100)
    vessel = Vessel((Stenosis(0.8, length=1.0),))
    with pytest.raises(SolveError, match=r"choked at z = [12]\.\d* cm.*More steps do not help"):
        tube.solve([vessel], [Waveform(3.0)], Windkessel(2e3, 1e3, 1e-3), n_points=41)


def test_grid_that_is_too_coarse_for_a_pulse():
    z, area = straight(400.0, 15)
    with pytest.raises(InputError, match=r"waves of 1\d\d cm, which need at least"):
        Tube1D().solve(area, [coronary()], OUTLET, z=z)


def test_gradients_of_the_jax_function():
    import jax

    z, area = straight(4.0, 11)
    tube = Tube1D(n_times=4, steps=80, cycles=1)
    outlet = Windkessel(2e4, 8e4, 1e-6)
    stenoses = [[Stenosis(0.4, length=2.0)]]
    problem = discretize(tube, z, area, [coronary()], outlet, stenoses=stenoses)
    function, inputs = tube.jax_function(problem)
    weights = np.random.default_rng(0).standard_normal((2, 1, 4, 11))

    @compiled_quickly
    @partial(jax.value_and_grad, has_aux=True)
    def evaluate(inputs):
        flow, _, pressure = function(inputs)
        return (weights[0] * flow).sum() + (weights[1] * pressure).sum() / 1e5, pressure

    with double_precision():
        (_, pressure), slopes = evaluate(inputs)
        np.testing.assert_allclose(pressure, tube.run(problem).cases.pressure, rtol=1e-12)
        rng = np.random.default_rng(1)
        for name in ("area_undeformed", "wall", "inlet", "outlet"):
            direction = jax.tree.map(np.zeros_like, inputs)
            part = jax.tree.map(lambda v: v * rng.uniform(0.5, 1.5, v.shape), getattr(inputs, name))
            direction = direction._replace(**{name: part})
            slope = sum(
                float((a * b).sum())
                for a, b in zip(*map(jax.tree.leaves, (slopes, direction)), strict=True)
            )
            ahead, back = (
                float(evaluate(jax.tree.map(lambda v, d, h=h: v + h * d, inputs, direction))[0][0])
                for h in (1e-4, -1e-4)
            )
            assert slope == pytest.approx((ahead - back) / 2e-4, rel=1e-6), name


# ---- bad input -----------------------------------------------------------------------

Z, AREA = straight(4.0, 41, n_cases=2)
WAVEFORMS = [Waveform(1.0, (0.2,), (0.0,))] * 2
OUTLET = Windkessel(1e5)
NUMBERS = {"geometry": [1, 2], "waveform": [0, 0]}


def with_value(array, index, value):
    array = np.array(array)
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: Tube1D().solve(with_value(AREA, (1, 7), -0.1), WAVEFORMS, OUTLET, z=Z),
            r"\[1, 7\]",
        ),
        (
            lambda: Tube1D().solve(with_value(AREA, (1, 7), np.nan), WAVEFORMS, OUTLET, z=Z),
            r"\[1, 7\]",
        ),
        (
            lambda: Tube1D().solve(AREA[:, 1:], WAVEFORMS, OUTLET, z=Z),
            r"must have the shape \(case",
        ),
        (lambda: Tube1D().solve(AREA[:, :3], WAVEFORMS, OUTLET, z=Z[:3]), r"too coarse"),
        (lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z**2), r"equal steps"),
        (
            lambda: Tube1D().solve([Vessel((Stenosis(0.85),))], WAVEFORMS[:1], OUTLET, n_points=21),
            r"too coarse: area_undeformed of case 0",
        ),
        (
            lambda: Tube1D().solve([Vessel((Stenosis(0.3),))], WAVEFORMS[:1], OUTLET, n_points=21),
            r"too coarse: the stenosis of case 0",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS[:1], OUTLET, z=Z),
            r"waveforms must have an entry",
        ),
        (lambda: Tube1D().solve(AREA, [WAVEFORMS[0], 1.0], OUTLET, z=Z), r"waveforms\[1\]"),
        (
            lambda: Tube1D().solve(AREA, [WAVEFORMS[0], coronary(0.9)], OUTLET, z=Z),
            r"waveforms\[1\] has a period of 0.9 s",
        ),
        (
            lambda: Tube1D(n_times=10, steps=60).solve(
                AREA, [WAVEFORMS[0], coronary()], OUTLET, z=Z
            ),
            r"time step is too long: waveforms\[1\] has 8 harmonics",
        ),
        (
            lambda: Tube1D().solve(AREA, [WAVEFORMS[0], Waveform(250.0)], OUTLET, z=Z),
            r"faster than the pulse wave.*case 1",
        ),
        (lambda: Tube1D().solve(AREA, WAVEFORMS, Windkessel(-1.0), z=Z), r"resistance.*negative"),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, Windkessel(1e5, capacitance=1e-6), z=Z),
            r"capacitance needs a distal_resistance",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z, inlet="velocity"),
            r"inlet must be 'flow' or 'pressure'",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, Reflection(-1.0), z=Z),
            r"coefficient must be in \(−1, 1\)",
        ),
        (lambda: Tube1D().solve(AREA, WAVEFORMS, Windkessel([1e5] * 3), z=Z), r"each of 2 cases"),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, Windkessel([1e5, np.nan]), z=Z),
            r"resistance\[1\]",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z, initial_pressure=-6e6),
            r"initial_pressure.*collapse",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z, stenoses=[[Stenosis(0.5)]]),
            r"stenoses must have an entry for each of 2 cases, got 1",
        ),
        (
            lambda: Tube1D().solve(
                AREA, WAVEFORMS, OUTLET, z=Z, stenoses=[[], [Stenosis(0.5, 4.0)]]
            ),
            r"stenosis of case 1 .* too close to the ends",
        ),
        (
            lambda: Tube1D().solve(
                AREA, WAVEFORMS, OUTLET, z=Z, labels={"geometry": [1, 1], "waveform": [0, 0]}
            ),
            r"give each case its own pair",
        ),
        (lambda: Tube1D().solve([], [], OUTLET), r"no vessel"),
        (
            lambda: Tube1D().solve(
                AREA, WAVEFORMS, OUTLET, z=Z, labels={**NUMBERS, "periodicity": [0.0, 0.0]}
            ),
            r"'periodicity', which is the name of a column that the solver",
        ),
        (
            lambda: Tube1D().solve(
                [Vessel()] * 2, WAVEFORMS, OUTLET, labels={**NUMBERS, "volume_balance": [0, 0]}
            ),
            r"'volume_balance', which is the name of a column that the solver",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, Windkessel(np.nan), z=Z),
            r"outlet.resistance is nan",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, Windkessel("1"), z=Z),
            r"resistance must hold real",
        ),
        (lambda: Tube1D().solve(AREA, WAVEFORMS, 1e5, z=Z), r"outlet must be an outlet"),
        (lambda: Tube1D().solve([Vessel()] * 2, WAVEFORMS, 1e5), r"outlet must be an outlet"),
        (
            lambda: Tube1D().solve(AREA + 1j, WAVEFORMS, OUTLET, z=Z),
            r"area_undeformed must hold real",
        ),
        (
            lambda: Tube1D().solve(np.ma.masked_greater(AREA, 0.1), WAVEFORMS, OUTLET, z=Z),
            r"area_undeformed has masked values",
        ),
        (lambda: Tube1D().solve(Vessel(), WAVEFORMS, OUTLET), r"sequence of Vessel, got Vessel"),
        (lambda: Tube1D().solve([1.0] * 2, WAVEFORMS, OUTLET), r"vessels\[0\] must be a Vessel"),
        (lambda: Tube1D().solve(AREA, coronary(), OUTLET, z=Z), r"sequence of Waveform"),
        (
            lambda: Tube1D().solve([Vessel()] * 2, WAVEFORMS, OUTLET, n_points=101.0),
            r"n_points must be a whole number",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z, stenoses=[[], [0.5]]),
            r"stenoses\[1\]\[0\] must be a Stenosis",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z, stenoses=0.5),
            r"stenoses must be a seq",
        ),
        (
            lambda: Tube1D().solve(AREA, WAVEFORMS, OUTLET, z=Z, initial_pressure="1"),
            r"initial_pressure must be a number",
        ),
        (lambda: Tube1D(density="1"), r"density must be a number \(g/cm³\)"),
        (
            lambda: Tube1D().solve([Vessel(), Vessel(length=5.0)], WAVEFORMS, OUTLET),
            r"Vessel 1 is 5 cm",
        ),
        (lambda: Tube1D(steps=150), r"not a multiple of n_times"),
        (lambda: Tube1D(steps=0), r"steps must be a whole number"),
        (lambda: Tube1D(cycles=True), r"cycles must be a whole number"),
        (lambda: Tube1D(cycles=2.5), r"cycles must be a whole number"),
        (lambda: Tube1D(density=-1.0), r"density must be positive"),
        (lambda: Tube1D(viscosity=math.nan), r"viscosity must be finite"),
        (lambda: Tube1D(wall=5e6), r"must be a wall law"),
        (lambda: Tube1D(stenosis_loss="young"), r"stenosis_loss"),
        (lambda: Tube1D(turbulent_coefficient=-1.0), r"turbulent_coefficient"),
    ],
)
def test_bad_input_is_refused_before_computing(make, words, monkeypatch):
    monkeypatch.setattr(
        "pcnde_bridge.hemodynamics.tr_bdf2.start", lambda *_: pytest.fail("it computed")
    )
    with pytest.raises(InputError, match=words):
        make()


def test_data_that_do_not_suit_the_solver(small_cases):
    with pytest.raises(InputError, match=r"20 time points per cycle, the solver 100"):
        Tube1D().solve_like(small_cases)


def test_divergence_names_case_time_and_place():
    """Blood is sucked out at 5 mL/s and cannot come back: 0.5 mL are gone after 0.1 s."""
    waveforms = [Waveform(0.5), Waveform(-5.0)]
    tube = Tube1D(n_times=20, steps=100)
    labels = {"geometry": [3, 4], "waveform": [7, 8]}
    with pytest.raises(
        SolveError, match=r"Case 1 \(geometry 4, waveform 8\) diverged at t = 0\.1 s, near z = "
    ):
        tube.solve(AREA, waveforms, Windkessel(1e7), z=Z, labels=labels)


def test_a_cycle_that_is_not_periodic_is_reported(caplog):
    tube = Tube1D(n_times=20, steps=100, cycles=2)
    outlet = Windkessel(1e4, 1e5, 1e-4)  # a time constant of 10 s
    cases = tube.solve(AREA, WAVEFORMS, outlet, z=Z)
    assert cases.labels["periodicity"][0] > 1e-2
    assert "use more cycles" in caplog.text


@pytest.mark.parametrize(
    ("wall", "outlet", "initial_pressure"),
    [
        (LinearWall(), Windkessel(1e3, 1e5, 5e-3), 1e5),  # a time constant of 500 s
        (LinearWall(5e5), Windkessel(1e6), None),  # 6 s, and more when it is wide
    ],
)
def test_periodicity_is_the_distance_of_slow_outlets_too(wall, outlet, initial_pressure, caplog):
    tube = Tube1D(wall=wall, n_times=20, steps=100)
    cases = tube.solve(
        [Vessel()], [coronary()], outlet, n_points=41, initial_pressure=initial_pressure
    )
    # What flows in flows out in the periodic cycle, whatever happens between.
    mean = (outlet.resistance + outlet.distal_resistance) * coronary().mean
    distance = mean / cases.pressure.mean() - 1
    assert 0.9 * distance < cases.labels["periodicity"][0] < 3 * distance
    assert "use more cycles" in caplog.text


@pytest.mark.parametrize("modulus", [2e5, 1e6])
def test_soft_vessels_start_from_rest(modulus):
    vessels = [Vessel(), Vessel((Stenosis(0.85),))]
    tube = Tube1D(LinearWall(modulus), n_times=20, steps=100, cycles=1)
    cases = tube.solve(vessels, [coronary()] * 2, OUTLET, n_points=81)
    assert cases.labels["volume_balance"].max() < 1e-12
    assert cases.pressure[:, 1:].min() > 0
    start = cases.pressure[:, :6].mean(axis=(1, 2))
    assert (cases.pressure[:, -1].mean(axis=1) > 2 * start).all()


@pytest.mark.parametrize(("wall", "pressure"), [(LinearWall(), -5.1e6), (OlufsenWall(), 1.8e6)])
def test_outlet_beyond_the_wall_law_is_reported_with_its_place(wall, pressure):
    outlet = Windkessel(0.0, distal_pressure=pressure)
    tube = Tube1D(wall, n_times=20, steps=100)
    with pytest.raises(SolveError, match=r"diverged at t = 0\.01 s, near z = 4 cm"):
        tube.solve([Vessel()], [coronary()], outlet, n_points=41)


def test_a_stenosis_without_loss_may_be_anywhere():
    tube = Tube1D(stenosis_loss="none", n_times=4, steps=20, cycles=1)
    stenoses = [[], [Stenosis(0.5, position=4.0)]]
    cases = tube.solve(AREA, [Waveform(1.0)] * 2, OUTLET, z=Z, stenoses=stenoses)
    np.testing.assert_array_equal(cases.pressure[0], cases.pressure[1])


def test_labels_that_are_not_given():
    tube = Tube1D(n_times=4, steps=20, cycles=1)
    narrow, wave = Vessel((Stenosis(0.3, length=1.0),)), Waveform(1.0)
    other = Waveform(0.5)
    cases = tube.solve(
        [narrow, narrow, Vessel()], [wave] * 3, Windkessel([1e5, 2e5, 1e5]), n_points=41
    )
    assert cases.labels["geometry"].tolist() == [1, 2, 3]
    assert cases.labels["waveform"].tolist() == [0, 0, 0]
    cases = tube.solve(
        [narrow] * 4, [wave, other] * 2, Windkessel([1e5, 1e5, 2e5, 2e5]), n_points=41
    )
    assert cases.labels["geometry"].tolist() == [1, 1, 2, 2]
    assert cases.labels["waveform"].tolist() == [0, 1, 0, 1]
    for labels in (NUMBERS, pd.DataFrame(NUMBERS, index=[5, 6])):
        cases = tube.solve([narrow] * 2, [wave] * 2, OUTLET, n_points=41, labels=labels)
        assert cases.labels["geometry"].tolist() == [1, 2]
        assert cases.labels["blockage"].tolist() == [0.3, 0.3]
