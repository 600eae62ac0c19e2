"""Checks of one vessel over one cycle: flow along it, damaged samples, missing parts, shifts."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import artery
from scipy.special import jve

from pcnde_bridge.data.balances import lag
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.single_vessel import check_flow, check_samples, check_vessel
from pcnde_bridge.errors import InputError


def along(change):
    flow = (1.2 + np.sin(2 * np.pi * np.arange(12) / 12))[:, None] * np.ones(12)
    area = np.full((12, 12), 0.1) * (1 - 0.5 * np.exp(-((np.arange(12) - 6.0) ** 2)))
    return change(flow, area), area, np.arange(12.0)


def half(flow, area):
    return np.where(np.arange(12) > 7, 0.5, 1.0) * flow


def caps(flow, area):
    return np.where(np.isin(np.arange(12), (0, 11)), 0.0, flow)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (half, r"but 0\\.6 mL/s at z = 8 cm \\(point 8\\).*Leave out branches"),
        (caps, "but 0 mL/s at z = 0 cm.*ends alone: leave out the end points"),
        (lambda flow, area: flow / area, "these are velocities: flow × area is constant"),
        (
            lambda flow, area: np.where(np.arange(12) > 7, -flow, flow),
            "Its sign seems to change",
        ),
        (lambda flow, area: -flow, "runs against z.*turn it"),
    ],
)
def test_flow_that_is_not_that_of_one_vessel(change, message):
    with pytest.raises(InputError, match=message.replace("\\\\", "\\")):
        check_flow(*along(change), "Please turn it.")


def test_flow_that_averaging_leaves():
    check_flow(*along(lambda flow, area: np.linspace(1, 0.97, 12) * flow), "")
    check_flow(*along(lambda flow, area: 0 * flow), "")


@pytest.mark.parametrize("name", ["area", "pressure"])
@pytest.mark.parametrize("points", [[0], [6], [3], [5, 6], [0, 1, 6]])
def test_points_without_results_are_refused(name, points):
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    variables = {n: np.array(fields[n][0]) for n in ("flow", "area", "pressure")}
    variables[name][:, points] = 1e-9
    at = max(points) - 1 if points == [5, 6] else {0: 0, 6: 6, 3: 3}[points[0]]
    at = 1 if points == [0, 1, 6] else at
    with pytest.raises(InputError, match=rf"the mean {name} is 1e-09 at z = .* \(point {at}\)"):
        check_vessel(variables, fields["z"], fields["time"], "")
    # A pressure that falls to zero at the outlet is one.
    falls = np.linspace(1, 0, 7) * np.ones((16, 1))
    check_vessel(
        {**variables, "area": fields["area"][0], "pressure": falls}, fields["z"], fields["time"], ""
    )


def test_a_wall_shear_stress_against_the_flow_is_refused():
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    variables = {name: fields[name][0] for name in ("flow", "area", "pressure")}
    one = variables, fields["z"], fields["time"], ""
    check_vessel(*one)
    variables["wall_shear_stress"] = -fields["wall_shear_stress"][0]
    with pytest.raises(InputError, match="wall shear stress points against the flow"):
        check_vessel(*one)


@pytest.mark.parametrize("steps", [-12, -4, 4, 12])
@pytest.mark.parametrize("name", ["flow", "area", "pressure"])
def test_variables_that_are_shifted_in_time_are_refused(name, steps):
    """By 10 or 30 % of the cycle; by 2.5 % they may be."""
    fields = artery(0.4, 10.0, 10.0, 0.8, 1.3e5, n_times=40, shear=None)
    fields[name] = np.roll(fields[name], 1, axis=1)
    one = fields["z"], fields["time"], ""
    check_vessel({n: fields[n][0] for n in ("flow", "area", "pressure")}, *one)
    fields[name] = np.roll(fields[name], steps, axis=1)
    late = (steps > 0) != (name == "area")
    shifted = "flow" if name == "flow" else "pressure"
    message = rf"the {shifted} is 0\.\d+ s too {'late' if late else 'early'} for the area"
    with pytest.raises(InputError, match=message):
        check_vessel({n: fields[n][0] for n in ("flow", "area", "pressure")}, *one)


@pytest.mark.data
@pytest.mark.parametrize("name", ["flow", "area", "pressure"])
def test_published_cases_that_are_shifted_in_time_are_refused(published_cases, name):
    pulsatile = published_cases.select(published_cases.labels["waveform"].to_numpy() != 1)
    for case in range(0, len(pulsatile), 7):
        variables = {n: np.array(getattr(pulsatile, n)[case]) for n in ("flow", "area", "pressure")}
        variables[name] = np.roll(variables[name], 10, axis=0)
        with pytest.raises(InputError, match=r"is 0\.1 s too (late|early) for the area"):
            check_vessel(variables, published_cases.z, published_cases.time, "")


@pytest.mark.data
@pytest.mark.parametrize(("steps", "message"), [(10, r"0\.(08|09|1) s too late"), (-25, "early")])
def test_published_stress_that_is_shifted_in_time_is_refused(published_cases, steps, message):
    pulsatile = published_cases.select(published_cases.labels["waveform"].to_numpy() != 1)
    for case in range(0, len(pulsatile), 7):
        variables = {name: values[case] for name, values in pulsatile.variables().items()}
        check_vessel(variables, published_cases.z, published_cases.time, "")
        variables["wall_shear_stress"] = np.roll(variables["wall_shear_stress"], steps, axis=0)
        with pytest.raises(InputError, match=rf"wall shear stress is .*{message}.* for the flow"):
            check_vessel(variables, published_cases.z, published_cases.time, "")


@pytest.mark.parametrize("diameter", [0.2, 0.4, 1.0, 2.5])
def test_stress_of_womersleys_flow_may_lead(diameter):
    """α at the heart rate is 1.3 to 16."""
    fields = artery(diameter, 10.0, 10.0, 1.0, 1.3e5, n_times=100, shear=None)
    variables = {name: fields[name][0] for name in ("flow", "area", "pressure")}
    radius, omega = diameter / 2, 2 * np.pi * np.arange(1, 51)
    number = radius * np.sqrt(omega * 1.06 / 0.04) * np.exp(0.75j * np.pi)
    ratio = jve(1, number) / jve(0, number)
    impedance = 0.04 * number * ratio / (2 * ratio / number - 1)
    harmonics = np.fft.rfft(variables["flow"], axis=0)
    harmonics *= np.append(4 * 0.04, impedance)[:, None] / (np.pi * radius**3)
    stress = np.fft.irfft(harmonics, 100, axis=0)
    assert 0 <= lag(variables["flow"].mean(axis=1), stress.mean(axis=1)) <= 13
    check_vessel({**variables, "wall_shear_stress": stress}, fields["z"], fields["time"], "")
    late = {**variables, "wall_shear_stress": np.roll(stress, 25, axis=0)}
    with pytest.raises(InputError, match=r"wall shear stress is .* s too late for the flow"):
        check_vessel(late, fields["z"], fields["time"], "")


def waveform(n=100):
    """Mean, and three harmonics with the amplitudes of an artery's, (time, 2)."""
    angle = 2 * np.pi * np.arange(n)[:, None] / n + [0.0, 1.0]
    return 1.3 + 0.4 * np.cos(angle) + 0.2 * np.cos(2 * angle + 1) + 0.1 * np.cos(5 * angle)


@pytest.mark.parametrize("at", [0, 1, 50, 99])
@pytest.mark.parametrize("factor", [0.0, 0.9, 1.1, -1.0, 100.0])
def test_a_single_damaged_sample_is_found(at, factor):
    values = waveform()
    values[at, 1] *= factor
    message = rf"flow is .* at {at / 100:g} s \(time point {at}, point 1\).*sample is damaged"
    with pytest.raises(InputError, match=message):
        check_samples("flow", values, np.arange(100) / 100)
    steady = np.full((20, 1), 2.0)
    check_samples("flow", steady, np.arange(20) / 20)
    steady[3] = 2.1
    with pytest.raises(InputError, match="time point 3, case 0"):
        check_samples("flow", steady, np.arange(20) / 20, "case")


def test_sharp_but_whole_waveforms_have_no_damaged_sample():
    """Jumps, corners and noise; few time points; unequal steps."""
    rng = np.random.default_rng(0)
    for n in (8, 20, 50, 100, 1000):
        t = (np.arange(n) / n)[:, None]
        sharp = (np.where(t < 0.4, 2.0, 1.0), np.abs(t - 0.5), np.abs(np.sin(np.pi * t)))
        ejection = np.maximum(np.sin(2 * np.pi * t / 0.7), 0) * (t < 0.35)
        noisy = waveform(n) + rng.normal(0, 0.05, (n, 2))
        for values in (*sharp, ejection, noisy, waveform(n)):
            check_samples("flow", values, t[:, 0])
        time = np.sort(rng.uniform(size=n))
        spread = np.interp(time, t[:, 0], t[:, 0] + 0.2 / n * rng.uniform(size=n))
        check_samples("flow", np.cos(2 * np.pi * spread)[:, None], spread)


def test_less_or_more_than_a_cycle_is_refused():
    values = waveform()
    for part in (values[:50], values[:80], values[:90], np.concatenate([values, values[:50]])):
        with pytest.raises(InputError, match=r"not one cycle: flow ends at .* \(point \d\)"):
            check_samples("flow", part, np.arange(len(part)) / 100)
    check_samples("flow", np.concatenate([values, values]), np.arange(200) / 100)


@pytest.mark.parametrize("start", [2, 16, 20, 33, 42, 61, 70])
def test_a_part_of_a_smooth_cycle_is_no_cycle(start):
    """Also where its ends are close to each other."""
    values = np.roll(waveform()[:, :1], -start, axis=0)
    check_samples("flow", values, np.arange(100) / 100)
    for count in (90, 95):
        with pytest.raises(InputError, match="the recording is not one cycle"):
            check_samples("flow", values[:count], np.arange(count) / 100)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("count", [20, 32, 100, 1000])
def test_time_points_in_the_order_of_text_are_refused(first, count):
    """As files of names without leading zeros."""
    order = np.array(sorted(range(first, first + count), key=str)) - first
    time = np.arange(count) / count
    check_samples("flow", waveform(count), time)
    with pytest.raises(InputError, match=r"order of text, 1, 10, 11, …: sort them"):
        check_samples("flow", waveform(count)[order], time)


def test_pressures_that_drop_out_are_refused():
    fields = artery(0.4, 10.0, 10.0, 1.0, 1.3e5)
    variables = {n: np.array(fields[n][0]) for n in ("flow", "area", "pressure")}
    check_vessel(variables, fields["z"], fields["time"], "")
    variables["pressure"][3:5] = 0
    with pytest.raises(
        InputError, match=r"pressure is 0 at 0\.1875 s \(time point 3, point 0\), .* are missing"
    ):
        check_vessel(variables, fields["z"], fields["time"], "")


@pytest.mark.parametrize("change", ["flow", "time"])
def test_a_reversed_flow_or_time_is_refused(change):
    fields = artery(0.4, 20.0, 10.0, 0.9, 1.2e5, n_times=32, drop=False)
    Cases(**fields, units="cgs,area=cm^2")
    if change == "flow":
        fields["flow"] = fields["flow"][..., ::-1]
    else:
        fields |= {name: fields[name][:, ::-1] for name in ("flow", "area", "pressure")}
    with pytest.raises(InputError, match="more flows out than in while the volume grows"):
        Cases(**fields, units="cgs,area=cm^2")


@pytest.mark.data
def test_cycles_that_are_one_percent_short(published_cases):
    """The last of 100 time points is missing; the published cycles are smooth."""
    refused = 0
    for case in published_cases:
        fields = {n: getattr(case, n)[:, :-1] for n in ("flow", "area", "pressure")}
        fields |= {"area_undeformed": case.area_undeformed, "time": case.time[:-1], "z": case.z}
        try:
            Cases(**fields)
        except InputError as error:
            assert "not one cycle" in str(error)
            refused += 1
    assert refused == 52


def test_several_cycles_are_refused():
    fields = artery(0.4, 20.0, 10.0, 0.9, 1.2e5, shear=None)
    for name in ("flow", "area", "pressure"):
        fields[name] = np.tile(fields[name], (1, 2, 1))
    fields["time"] = np.arange(32) / 32 * 1.8
    with pytest.raises(InputError, match="2 equal cycles: give one, the first 16 time points"):
        Cases(**fields)


def test_a_reversed_pressure_is_refused_in_stated_units():
    fields = artery(0.4, 20.0, 10.0, 0.9, 1.2e5, rigid=True)
    fields["pressure"] = fields["pressure"][..., ::-1]
    with pytest.raises(InputError, match=r"stated units the .* possible are"):
        Cases(**fields, units="cgs")
