"""Outlets in a periodic cycle, and their files."""

import json

import numpy as np
import pytest

from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics import CoronaryOutlet, Reflection, Waveform, Windkessel, coronary
from pcnde_bridge.hemodynamics.outlet import outlet_from

PERIOD, N = 0.8, 33
TIME = PERIOD * np.arange(N) / N
MUSCLE = Waveform(4e4, (-3e4, 5e3), (2e4, 0.0), PERIOD)
VEINS = (Waveform(5e3, (1e3,), (0.0,), PERIOD),) * 2
CORONARY = CoronaryOutlet(3e4, [5e4, 8e4], 2e4, 4e-7, 3e-6, MUSCLE, VEINS)
THREE_ELEMENTS = Windkessel([2e4, 3e4], 8e4, 1e-6, MUSCLE)
OUTLETS = [Windkessel(8e4), THREE_ELEMENTS, CORONARY, Reflection(0.3, 5e3)]
FLOW = coronary(PERIOD).samples(N)
IMPEDANCE = np.array([1e4, 2e4])


def rate(signal):
    i_omega = 2j * np.pi * np.arange(N // 2 + 1) / PERIOD
    return np.fft.irfft(i_omega * np.fft.rfft(signal), n=N)


def pressure(outlet):
    """Pressure of both cases."""
    impedance, own = np.moveaxis(outlet.response(2, TIME, PERIOD, IMPEDANCE), 1, 0)
    return np.fft.irfft(impedance * np.fft.rfft(FLOW) + own, n=N)


def test_windkessel_and_reflection():
    np.testing.assert_allclose(pressure(OUTLETS[0]), np.tile(8e4 * FLOW, (2, 1)))
    for p, proximal in zip(pressure(OUTLETS[1]), (2e4, 3e4), strict=True):
        stored = p - proximal * FLOW
        out = (stored - MUSCLE.flow(TIME)) / 8e4
        np.testing.assert_allclose(1e-6 * rate(stored) + out, FLOW, atol=1e-10)
    expected = 5e3 + IMPEDANCE[:, None] * 1.3 / 0.7 * FLOW
    np.testing.assert_allclose(pressure(OUTLETS[3]), expected)


def test_coronary():
    vein = VEINS[0].flow(TIME)
    for p, micro in zip(pressure(CORONARY), (5e4, 8e4), strict=True):
        p_1 = p - 3e4 * FLOW
        through = FLOW - 4e-7 * rate(p_1)
        p_2 = p_1 - micro * through
        out = through - 3e-6 * rate(p_2 - MUSCLE.flow(TIME))
        np.testing.assert_allclose((p_2 - vein) / 2e4, out, atol=1e-8)


@pytest.mark.parametrize("outlet", OUTLETS)
def test_files_keep_outlets(outlet):
    stored = json.loads(json.dumps(outlet.to_dict()))
    assert outlet_from(stored) == outlet
    assert outlet.is_common == (outlet in (OUTLETS[0], OUTLETS[3]))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (None, "An outlet needs a kind"),
        ({"kind": "Pump"}, "An outlet needs a kind"),
        (
            {"kind": "Windkessel"},
            r"Windkessel has the fields \['resistance', .*\], got \[\]: 'resistance' is missing",
        ),
        (
            {"kind": "Reflection", "gamma": 1.0},
            r"Reflection has the fields \['coefficient', .*\], got \['gamma'\]: 'gamma' is none",
        ),
        (
            {"kind": "Windkessel", "resistance": 1.0, "distal_pressure": {"average": 1.0}},
            r"Waveform has the fields \['mean', .*\], got \['average'\]",
        ),
    ],
)
def test_other_content_is_an_error(values, message):
    with pytest.raises(InputError, match=message):
        outlet_from(values)
