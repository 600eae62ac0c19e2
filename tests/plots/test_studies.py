"""Figures of the studies: curves, units and labels."""

from __future__ import annotations

import numpy as np
import pytest
from plot_helpers import MMHG, MODEL, OTHER, TRUTH, drawn, fits, texts

from pcnde_bridge import InputError, plots
from pcnde_bridge.plots import style
from pcnde_bridge.studies import (
    FourierEffect,
    NoiseStudy,
    pressure_drops,
)


def test_pressure_drops(small_cases, predicted):
    drops = pressure_drops(predicted["pressure"] * 1.1, small_cases)
    figure = fits(plots.pressure_drops(drops, truth_label="data"))
    left, right = figure.axes
    assert texts(figure.legends[0]) == ["data", "Seeley and Young", "PCNDE"]
    assert left.get_ylabel() == "pressure drop Δp (mmHg)"
    assert left.get_title("left") == "a)  geometry 3, 4 waveforms"
    assert right.get_title("left") == "b)  waveform 3, 3 geometries"
    np.testing.assert_allclose(drawn(left, TRUTH), drops.truth[8:] / MMHG)
    empirical = drawn(right, style.EMPIRICAL.lower())
    np.testing.assert_allclose(empirical, drops.empirical[3::4] / MMHG)


def test_fourier_effect(small_cases, predicted):
    drift = np.full(small_cases.area_undeformed.shape, 1e-3)
    effect = FourierEffect(small_cases, small_cases.area * 1.02, predicted["area"], drift)
    figure = fits(plots.fourier_effect(effect, 4))
    axis = figure.axes[0]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("time t (s)", "area S (mm²)")
    assert texts(figure.legends[0]) == [
        "3D, averaged",
        "continuity equation Ŝ",
        "Fourier stage S",
    ]
    final, intermediate = drawn(axis, MODEL)[0], drawn(axis, OTHER)[0]
    np.testing.assert_allclose(final[:20], final[20:])
    np.testing.assert_allclose(intermediate[20:] - intermediate[:20], 0.1)
    assert "geometry 2, waveform 0, z = 3.60 cm" in axis.get_title()
    with pytest.raises(InputError, match="case 12"):
        plots.fourier_effect(effect, 12)


def test_noise(small_cases, predicted):
    case = small_cases.select([10])
    mean = {name: values[10] for name, values in predicted.items()}
    standard_deviation = {name: 0.1 * values for name, values in mean.items()}
    study = NoiseStudy("inflow", 0.05, 90, case, mean, mean, standard_deviation)
    figure = fits(plots.noise(study))
    rows = np.array(figure.axes).reshape(3, 2)
    assert texts(figure.legends[0]) == ["± standard deviation", "3D, averaged", "mean of PCNDE"]
    assert rows[1, 0].get_ylabel() == "area S (mm²)"
    np.testing.assert_allclose(drawn(rows[2, 1], MODEL)[0], mean["pressure"][5] / MMHG)
    band = rows[0, 0].collections[0].get_paths()[0].vertices[:, 1]
    middle = mean["flow"][:, 18]
    assert band.max() == pytest.approx(1.1 * middle.max())
    assert band.min() == pytest.approx(0.9 * middle.min())
    # Time and space have separate axes.
    assert rows[0, 0].get_ylim() != rows[0, 1].get_ylim()
