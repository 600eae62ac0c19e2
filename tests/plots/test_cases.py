"""Figures of cases: curves, units and labels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plot_helpers import MMHG, MODEL, OTHER, TRUTH, drawn, fits, texts

from pcnde_bridge import InputError, plots


def test_data_set(small_cases):
    train, test = small_cases.split("paper")
    figure = fits(plots.data_set(train, test))
    inflow, area, matrix = figure.axes
    np.testing.assert_allclose(drawn(inflow, MODEL), train.inflow[:3])
    np.testing.assert_allclose(drawn(inflow, TRUTH), small_cases.inflow[3:4])
    radius = 10 * np.sqrt(small_cases.area_undeformed[-1] / np.pi)
    np.testing.assert_allclose(drawn(area, TRUTH)[0], radius)
    assert area.get_ylabel() == "undeformed radius (mm)"
    assert texts(figure.legends[0]) == ["training", "test"]
    points = [np.column_stack(line.get_data()) for line in matrix.lines]
    assert [len(p) for p in points] == [len(train), len(test)]
    assert [3, 3] in points[1].tolist()
    assert len(fits(plots.data_set(train)).axes[0].lines) == 3


def test_time_and_space(prediction, small_cases):
    figure = fits(plots.time_and_space(prediction, small_cases, 7))
    flow, area, pressure = np.array(figure.axes).reshape(3, 2)
    assert flow[0].get_ylabel() == "flow Q (mL/s)"
    assert area[0].get_ylabel() == "area S (mm²)"
    assert pressure[0].get_ylabel() == "pressure p (mmHg)"
    assert [axis.get_xlabel() for axis in pressure] == ["time t (s)", "position z (cm)"]
    assert texts(flow[0].get_legend()) == ["3D, averaged", "PCNDE"]
    np.testing.assert_allclose(drawn(area[0], TRUTH)[0], 100 * small_cases.area[7, :, 18])
    peak = small_cases.inflow[7].argmax()
    expected = prediction.pressure[7, peak] / MMHG
    np.testing.assert_allclose(drawn(pressure[1], MODEL)[0], expected)
    with pytest.raises(InputError, match="case 12 must be one of the 12"):
        plots.time_and_space(prediction, small_cases, 12)


def test_results(predicted, small_cases):
    other = {"flow": small_cases.flow * 1.1, "area": small_cases.area * 1.1}
    figure = fits(plots.results(predicted, small_cases, other=other, area_case=2))
    flow, area, pressure = np.array(figure.axes).reshape(3, 2)
    assert texts(figure.legends[0]) == ["3D, averaged", "1D solver", "PCNDE"]
    np.testing.assert_allclose(drawn(flow[0], MODEL), predicted["flow"][:, :, 18])
    np.testing.assert_allclose(drawn(flow[1], TRUTH), small_cases.flow[:, 5])
    np.testing.assert_allclose(drawn(flow[1], OTHER), other["flow"][:, 5])
    np.testing.assert_allclose(drawn(pressure[0], MODEL), predicted["pressure"][:, :, 18] / MMHG)
    # There is one area only, with the limits of its error.
    np.testing.assert_allclose(drawn(area[0], TRUTH), [100 * small_cases.area[2, :, 18]])
    edges = [line.get_xdata()[0] for line in area[1].lines if line.get_color() == "black"]
    assert edges == [small_cases.z[5], small_cases.z[-6]]
    assert "40 % blockage, geometry 1, waveform 2" in area[0].get_title("right")
    assert drawn(pressure[0], OTHER).size == 0
    for bad, words in (
        ({"area_case": 12}, "case 12 must be one of the 12"),
        ({"position": 1.2}, "position must be"),
        ({"time_point": -0.1}, "time_point must be"),
        ({"other": {"flow": small_cases.flow[1:]}}, "must have the 12 cases"),
    ):
        with pytest.raises(InputError, match=words):
            plots.results(predicted, small_cases, **bad)


def test_results_without_pressure_or_other_method(predicted, small_cases):
    figure = fits(plots.results({"flow": predicted["flow"]}, small_cases))
    assert len(figure.axes) == 2
    assert texts(figure.legends[0]) == ["3D, averaged", "PCNDE"]


def test_a_row_of_wall_shear_stress(prediction, predicted, sheared_cases, small_cases):
    stress = {"wall_shear_stress": 1.1 * sheared_cases.wall_shear_stress}
    figure = fits(plots.results(predicted | stress, sheared_cases))
    over_time, along = figure.axes[6:]
    assert over_time.get_ylabel() == "wall shear stress τ (dyn/cm²)"
    np.testing.assert_allclose(drawn(along, MODEL), stress["wall_shear_stress"][:, 5])
    np.testing.assert_allclose(drawn(along, TRUTH), sheared_cases.wall_shear_stress[:, 5])
    sheared = dataclasses.replace(prediction, **stress)
    for cases, curves in ((sheared_cases, 1), (small_cases, 0)):
        figure = fits(plots.time_and_space(sheared, cases, 7))
        assert len(figure.axes) == 8
        assert len(drawn(figure.axes[6], TRUTH)) == curves
    # A row for what is predicted only.
    assert len(plots.time_and_space(prediction, sheared_cases, 7).axes) == 6
