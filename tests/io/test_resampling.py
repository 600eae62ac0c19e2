"""One cycle and one grid for the results of other programs."""

from __future__ import annotations

import numpy as np
import pytest
from io_helpers import at_times, replaced

from pcnde_bridge import InputError
from pcnde_bridge.io import to_cases


def test_a_repeated_end_point_needs_the_period(vessel):
    closed = at_times(vessel, np.arange(21) / 20)
    with pytest.raises(InputError, match=r"last time point repeats the first.*--period 1"):
        to_cases([closed])
    found = to_cases([closed], period=1.0)
    assert found.n_times == 20
    np.testing.assert_allclose(found.flow[0], vessel.flow, atol=1e-12)


def test_the_last_whole_cycle_is_taken_at_its_phase(vessel):
    """Two and a half cycles, with another start: what is taken begins at a multiple of T."""
    time = np.arange(3, 53) / 20
    found = to_cases([at_times(vessel, time)], period=1.0)
    assert found.time[0] == 0
    np.testing.assert_allclose(found.flow[0], vessel.flow, atol=1e-11)


def test_what_is_not_periodic_is_refused(vessel):
    time = np.arange(60) / 20
    long = at_times(vessel, time)
    rising = replaced(long, pressure=long.pressure * (1 + 0.2 * time[:, None]))
    with pytest.raises(InputError, match=r"is not periodic.*simulate more cycles"):
        to_cases([rising], period=1.0)
    half = at_times(vessel, np.arange(130) / 100)
    with pytest.raises(InputError, match=r"is not one cycle: .* begins at .*--period"):
        to_cases([half])
    assert to_cases([half], period=1.0).n_times == 100
    with pytest.raises(InputError, match=r"covers 0\.95 s, less than the period of 2 s"):
        to_cases([vessel], period=2.0)


def test_periodicity_where_saves_do_not_fall_on_the_period(vessel):
    """A period of 60/70 s saved every 8.571 ms, and every 10 ms."""
    period, step = 60 / 70, 0.008571

    def recorded(step, count, growth=0.0):
        long = at_times(vessel, step * np.arange(count) / period)
        time = step * np.arange(count)
        return replaced(long, time=time, pressure=long.pressure * (1 + growth * time[:, None]))

    for growth in (0.08, -0.08):
        for every in (step, 0.01):
            with pytest.raises(InputError, match="is not periodic"):
                to_cases([recorded(every, 300, growth)], period=period, time_points=100)
    for every, count in ((step, 300), (step, 101), (0.01, 300)):
        found = to_cases([recorded(every, count)], period=period, time_points=100)
        expected = at_times(vessel, found.time / period)
        np.testing.assert_allclose(found.pressure[0], expected.pressure, rtol=2e-3)


def test_too_few_time_points_after_cutting(vessel):
    coarse = at_times(vessel, np.arange(12) / 3)
    with pytest.raises(InputError, match=r"a cycle of 1 s has 3 time points only"):
        to_cases([coarse], period=1.0)


def test_resampling_never_overshoots_unnoticed(vessel):
    square = np.where(np.arange(40) < 15, 1.3, 0.7)[:, None]
    step = at_times(vessel, np.arange(40) / 40)
    fields = {"flow": square * np.ones(21), "pressure": 1e5 * square * np.ones(21)}
    step = replaced(step, **fields)
    stated = {"units": "cgs,area=cm^2"}  # without a pressure drop
    assert to_cases([step], **stated).n_times == 40
    with pytest.raises(InputError, match=r"resampling to 100 time points overshoots .*range"):
        to_cases([step], time_points=100, **stated)


def test_time_is_resampled_on_request_only(vessel):
    for n in (11, 20, 32):
        found = to_cases([vessel], time_points=n)
        assert found.period == 1.0
        expected = at_times(vessel, np.arange(n) / n)
        if n >= 20:
            np.testing.assert_allclose(found.flow[0], expected.flow, rtol=1e-9)
        assert found.n_times == n
    # The waveform has three harmonics, so eleven time points still hold all of it.
    np.testing.assert_allclose(
        to_cases([vessel], time_points=11).flow[0],
        at_times(vessel, np.arange(11) / 11).flow,
        rtol=1e-9,
    )
    rng = np.random.default_rng(0)
    uneven = at_times(vessel, np.sort((np.arange(200) + rng.uniform(0, 0.5, 200)) / 200))
    for options in ({}, {"period": 1.0}):
        with pytest.raises(InputError, match="--time-points"):
            to_cases([uneven], **options)
    found = to_cases([uneven], period=1.0, time_points=20)
    expected = at_times(vessel, found.time)
    np.testing.assert_allclose(found.flow[0], expected.flow, rtol=1e-5)


def test_points_are_resampled_on_request_only(vessel):
    found = to_cases([vessel], points=41)
    np.testing.assert_allclose(found.z, np.linspace(0, 4, 41))
    np.testing.assert_allclose(found.flow[0][:, ::2], vessel.flow, rtol=1e-12)
    assert found.area.min() >= vessel.area.min()
    assert found.area.max() <= vessel.area.max()
    some = to_cases([vessel], points=[0.5, 1.0, 1.1, 2.0])
    assert list(some.z) == [0.5, 1.0, 1.1, 2.0]
    for bad in (2, 2.5, True, [0.0, 1.0, 5.0], [[0.0, 1.0]]):
        with pytest.raises(InputError, match="points"):
            to_cases([vessel], points=bad)


def test_vessels_of_one_data_set_have_one_grid(vessel):
    other = replaced(vessel, name="other", z=1.0005 * vessel.z)
    with pytest.raises(InputError, match=r"vessel has 21 values of z .* other 21 .*--points"):
        to_cases([vessel, other])
    assert to_cases([vessel, other], points=21).n_cases == 2
    longer = replaced(vessel, name="other", z=1.2 * vessel.z)
    with pytest.raises(InputError, match="vessels of other lengths"):
        to_cases([vessel, longer], points=21)
    coarse = at_times(vessel, np.arange(16) / 16)
    with pytest.raises(InputError, match=r"20 values of time .*--time-points"):
        to_cases([vessel, coarse])
    assert to_cases([vessel, coarse], time_points=20).n_cases == 2


@pytest.mark.parametrize("option", ["time_points", "points"])
def test_resampling_to_more_than_memory_holds_is_refused(vessel, option):
    with pytest.raises(InputError, match=r"to 1000000000 values would need .* ask for fewer"):
        to_cases([vessel], **{option: 10**9})
