import math

import numpy as np
import pytest

from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.waveform import (
    DATA_FACTORS,
    Waveform,
    coronary,
)

RNG = np.random.default_rng(4)


@pytest.mark.parametrize("n", [3, 4, 99, 100])
def test_series_passes_through_all_samples(n):
    flow = RNG.normal(size=n)
    waveform = Waveform.from_samples(flow, period=0.8, n_terms=None)
    np.testing.assert_allclose(waveform.samples(n), flow, atol=1e-12)
    np.testing.assert_allclose(waveform.flow([0.0, 0.8, -0.8]), flow[0], atol=1e-12)


def test_coefficients_of_a_known_series():
    t = np.arange(50) * (2.0 / 50)
    flow = 1.5 + 0.3 * np.cos(math.pi * t) - 0.2 * np.sin(3 * math.pi * t)
    waveform = Waveform.from_samples(flow, period=2.0, n_terms=4)
    assert waveform.n_terms == 4
    assert waveform.mean == pytest.approx(1.5)
    np.testing.assert_allclose(waveform.cosine, [0.3, 0, 0, 0], atol=1e-14)
    np.testing.assert_allclose(waveform.sine, [0, 0, -0.2, 0], atol=1e-14)


def test_the_family_scales_the_oscillation():
    waveform = Waveform(1.0, (0.2, 0.1), (-0.3, 0.05))
    t = np.linspace(0, 1, 30)
    scaled = waveform.scaled(-1.5)
    np.testing.assert_allclose(scaled.flow(t) - 1.0, -1.5 * (waveform.flow(t) - 1.0), atol=1e-14)
    assert waveform.scaled(1.0) == waveform
    np.testing.assert_allclose(waveform.scaled(0.0).flow(t), 1.0)
    assert [w.mean for w in waveform.family()] == [1.0] * len(DATA_FACTORS)
    assert waveform.family((2.0,)) == (Waveform(1.0, (0.4, 0.2), (-0.6, 0.1)),)


def test_uneven_samples_are_joined_linearly():
    time = [0.0, 0.1, 0.25, 0.6, 0.9]
    flow = [1.0, 2.0, 1.2, 0.8, 0.9]
    waveform = Waveform.from_samples(flow, time, period=1.0, n_terms=200)
    assert waveform.flow(0.4) == pytest.approx(np.interp(0.4, time, flow), abs=0.02)
    assert waveform.flow(0.95) == pytest.approx(0.95, abs=0.05)  # back to the start


def test_series_of_uneven_samples_is_that_of_the_lines():
    time, period = np.array([0.05, 0.3, 0.32, 0.6]), 0.8
    flow = np.array([1.0, 2.0, -1.2, 0.8])
    waveform = Waveform.from_samples(flow, time, period)
    assert waveform.n_terms == 60
    times = (np.arange(200_000) + 0.5) * (period / 200_000)
    lines = np.interp(times, time, flow, period=period)
    assert waveform.mean == pytest.approx(lines.mean(), rel=1e-8)
    for n in (1, 2, 7, 60):
        angle = 2 * math.pi * n / period * times
        assert waveform.cosine[n - 1] == pytest.approx(2 * (lines * np.cos(angle)).mean(), abs=1e-8)
        assert waveform.sine[n - 1] == pytest.approx(2 * (lines * np.sin(angle)).mean(), abs=1e-8)


def test_mean_of_few_uneven_samples_is_exact():
    time = [0.0, 0.3, 0.6]
    q = coronary().flow(time)
    exact = 0.3 * (q[0] + q[1]) / 2 + 0.3 * (q[1] + q[2]) / 2 + 0.4 * (q[2] + q[0]) / 2
    for n_terms in (0, 60, None):
        waveform = Waveform.from_samples(q, time, n_terms=n_terms)
        assert waveform.mean == pytest.approx(exact, rel=1e-14)
        assert waveform.n_terms == {0: 0, 60: 60, None: 4}[n_terms]


def test_numbers_may_be_numpys():
    waveform = Waveform(np.float32(0.5), (np.float32(0.25),), np.array([1]), np.int64(2))
    assert waveform == Waveform(0.5, (0.25,), (1.0,), 2.0)
    assert {type(v) for v in (waveform.mean, *waveform.cosine, *waveform.sine)} == {float}


@pytest.mark.parametrize("first", [1e-12, 0.005, 1.0, -0.3])
@pytest.mark.parametrize("n", [99, 100])
def test_equal_steps_may_begin_at_any_time(first, n):
    time = first + np.arange(n) * (0.8 / n)
    flow = RNG.normal(size=n)
    waveform = Waveform.from_samples(flow, time, period=0.8, n_terms=None)
    assert waveform.n_terms == n // 2
    np.testing.assert_allclose(waveform.flow(time), flow, atol=1e-12)


def test_repeated_end_of_the_cycle_is_not_counted_twice():
    time = np.linspace(0.0, 1.0, 21)
    waveform = Waveform.from_samples(np.cos(2 * math.pi * time), time, n_terms=None)
    np.testing.assert_allclose(waveform.flow(time), np.cos(2 * math.pi * time), atol=1e-12)


def test_coronary_is_positive_and_physiological():
    waveform = coronary()
    flow = waveform.samples(1000)
    assert waveform.n_terms == 9
    assert waveform.mean == pytest.approx(1.283)
    assert 0.4 < flow.argmax() / 1000 < 0.6
    assert all(w.samples(1000).min() > 0 for w in waveform.family())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Waveform(math.nan), r"mean must be finite"),
        (lambda: Waveform(1.0, (1.0, math.inf), (0.0, 0.0)), r"cosine\[1\]"),
        (lambda: Waveform(1.0, (1.0,), ()), r"1 terms and sine 0"),
        (lambda: Waveform(1.0, period=0.0), r"period must be positive"),
        (lambda: Waveform.from_samples([1.0, np.nan, 2.0]), r"flow\[1\] is nan"),
        (lambda: Waveform.from_samples([1.0, 2.0]), r"at least 3"),
        (lambda: Waveform.from_samples([[1.0, 2.0]]), r"one axis"),
        (lambda: Waveform.from_samples(["a", "b", "c"]), r"numbers"),
        (lambda: Waveform.from_samples([1, 2, 3], [0, 1]), r"as many of both"),
        (lambda: Waveform.from_samples([1, 2, 1], [0, 0.5, 0.4]), r"time\[2\]"),
        (lambda: Waveform.from_samples([1, 2, 1], [0, 0.5, 1.4]), "longer than the period"),
        (lambda: Waveform.from_samples([1, 2, 3], period=-1), r"period must be positive"),
        (lambda: Waveform.from_samples([1, 2, 3], n_terms=-1), r"n_terms"),
        (lambda: coronary().scaled(math.nan), r"factor must be finite"),
        (
            lambda: Waveform.from_samples(np.ma.array([1, 2, 1e9, 3.0], mask=[0, 0, 1, 0])),
            r"flow has masked values",
        ),
        (lambda: Waveform.from_samples([1, 2 + 1j, 3]), r"flow must hold real numbers.*complex"),
        (lambda: Waveform.from_samples([1, 2, 3], period=None), r"period must be a number \(s\)"),
        (lambda: Waveform.from_samples([1, 2, 3], n_terms=2.5), r"n_terms must be a whole number"),
        (lambda: Waveform.from_samples([1, 2, 3], n_terms=True), r"n_terms must be a whole number"),
        (lambda: Waveform("1"), r"mean must be a number \(mL/s\)"),
        (lambda: Waveform(None), r"mean must be a number"),
        (lambda: Waveform(1.0, period="1"), r"period must be a number \(s\)"),
        (lambda: Waveform(1.0, None, None), r"cosine must hold real numbers"),
        (lambda: Waveform(1.0, (1j,), (0.0,)), r"cosine must hold real numbers"),
        (lambda: coronary().scaled("2"), r"factor must be a number"),
        (lambda: coronary().samples(2.5), r"n_times must be a whole number"),
    ],
)
def test_bad_input(make, words):
    with pytest.raises(InputError, match=words):
        make()
