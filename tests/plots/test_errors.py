"""Figures of errors: values, labels and frames."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from plot_helpers import MMHG, TRUTH, drawn, fits

from pcnde_bridge import InputError, plots
from pcnde_bridge.studies import (
    box_statistics,
    error_matrix,
    pointwise_errors,
)


def test_error_matrix(small_cases, predicted):
    train = small_cases.split("paper").train
    matrices = error_matrix(predicted, small_cases)
    figure = fits(plots.error_matrix(matrices, train))
    assert len(figure.axes) == 4  # with the color bar
    assert figure.axes[3].get_ylabel() == "relative error (%)"
    limits = {axis.images[0].get_clim() for axis in figure.axes[:3]}
    assert limits == {(0, 100 * max(matrix.to_numpy().max() for matrix in matrices.values()))}
    [right] = figure.axes[2].child_axes
    assert [tick.get_text() for tick in right.get_yticklabels()] == ["40 %", "50 %", "60 %"]
    axis = figure.axes[1]
    assert axis.get_title() == "area S: relative error (%)"
    assert (axis.get_xlabel(), figure.axes[0].get_ylabel()) == ("waveform", "geometry")
    assert [text.get_text() for text in axis.texts] == ["1.00"] * 12
    assert [tick.get_text() for tick in axis.get_yticklabels()] == ["1", "2", "3"]
    # The frame encloses 2 × 3 training cases: as many sides as their outline has.
    assert len(axis.lines) == 10
    xs = np.concatenate([line.get_xdata() for line in axis.lines])
    ys = np.concatenate([line.get_ydata() for line in axis.lines])
    assert (xs.min(), xs.max(), ys.min(), ys.max()) == (-0.5, 2.5, -0.5, 1.5)
    with pytest.raises(InputError, match="no error matrix"):
        plots.error_matrix({})


def test_error_matrix_with_gaps(small_cases, predicted):
    chosen = small_cases.select([0, 5])
    matrices = error_matrix({"flow": predicted["flow"][[0, 5]]}, chosen)
    figure = fits(plots.error_matrix(matrices))
    assert len(figure.axes[0].texts) == 2


def test_pointwise_errors(small_cases, predicted):
    case = small_cases.select([11])
    errors = pointwise_errors({name: v[[11]] for name, v in predicted.items()}, case)
    figure = fits(plots.pointwise_errors(errors))
    panels, bars = figure.axes[:9], figure.axes[9:]
    assert [axis.get_ylabel() for axis in panels[::3]] == [
        "3D, averaged\ntime t (s)",
        "PCNDE\ntime t (s)",
        "absolute error\ntime t (s)",
    ]
    assert [axis.get_xlabel() for axis in panels[6:]] == ["position z (cm)"] * 3
    labels = {bar.get_ylabel() for bar in bars}
    assert labels == {
        "flow Q (mL/s)",
        "area S (mm²)",
        "pressure p (mmHg)",
        "|ΔQ| (mL/s)",
        "|ΔS| / S(t = 0)",
        "|Δp| (mmHg)",
    }
    truth, model, wrong = (panels[i].collections[0] for i in (2, 5, 8))
    np.testing.assert_allclose(truth.get_array(), case.pressure[0] / MMHG)
    np.testing.assert_allclose(wrong.get_array(), 2e3 / MMHG, rtol=1e-9)
    assert truth.get_clim() == model.get_clim()
    area = panels[7].collections[0].get_array()
    np.testing.assert_allclose(area, 0.01 * case.area[0] / case.area[0, 0])


def test_box_plots(small_cases, predicted):
    methods = {"PCNDE": predicted, "1D solver": {"flow": small_cases.flow * 0.9}}
    statistics = box_statistics(methods, small_cases)
    figure = fits(plots.box_plots(statistics))
    flow, _, pressure = figure.axes
    assert figure.axes[0].get_ylabel() == "pointwise relative error (%)"
    assert [tick.get_text() for tick in flow.get_xticklabels()] == ["PCNDE", "1D solver"]
    assert [tick.get_text() for tick in pressure.get_xticklabels()] == ["PCNDE"]
    medians = drawn(flow, TRUTH)
    np.testing.assert_allclose(medians[:, 0], [1.0, 10.0])
    crosses = [line.get_ydata()[0] for line in pressure.lines if line.get_marker() == "x"]
    assert crosses == pytest.approx([100 * statistics.loc[("pressure", "PCNDE"), "largest"]])
    assert "whiskers: within 1.5 box heights" in figure.get_supxlabel()
    with pytest.raises(InputError, match="no errors"):
        plots.box_plots(statistics.iloc[:0])


def test_learning_curve():
    subsets = "designed", "random 0", "random 1", "random 2"
    index = pd.MultiIndex.from_product([[4, 9], subsets], names=["size", "subset"])
    flow = [0.03, 0.01, 0.05, 0.02, 0.02, 0.04, 0.03, np.nan]  # the last fit failed
    table = pd.DataFrame({"flow": flow, "area": 0.1, "wall_shear_stress": np.nan}, index=index)
    figure = fits(plots.learning_curve(table))
    axis, area = figure.axes
    assert [a.get_title() for a in (axis, area)] == ["flow", "area"]
    designed, random = axis.lines
    np.testing.assert_allclose(designed.get_xydata(), [[4, 3], [9, 2]])
    np.testing.assert_allclose(random.get_xydata(), [[4, 2], [9, 3.5]])
    [band] = axis.collections
    assert band.get_paths()[0].get_extents().extents.tolist() == pytest.approx([4, 1, 9, 5])
    assert [text.get_text() for text in axis.get_xticklabels()] == ["4", "9"]
    only = fits(plots.learning_curve(table[table.index.get_level_values(1) == "designed"]))
    assert len(only.axes[0].lines) == 1
    with pytest.raises(InputError, match="every fit"):
        plots.learning_curve(table * np.nan)
