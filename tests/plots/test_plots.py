"""Figures: what is drawn, in which units, under which names, and that nothing is cut off."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex, to_rgb

from pcnde_bridge import InputError, plots
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots import style
from pcnde_bridge.studies import (
    FourierEffect,
    NoiseStudy,
    box_statistics,
    error_matrix,
    pointwise_errors,
    pressure_drops,
)

MMHG = 1333.22


@pytest.fixture(scope="module")
def predicted(small_cases):
    """Near the truth, but no variable equal to it."""
    return {
        "flow": small_cases.flow * 1.01,
        "area": small_cases.area * 0.99,
        "pressure": small_cases.pressure + 2e3,
    }


@pytest.fixture(scope="module")
def prediction(small_cases, predicted):
    return Prediction(
        **predicted,
        area_undeformed=small_cases.area_undeformed,
        time=small_cases.time,
        z=small_cases.z,
        period=1.0,
        labels=small_cases.labels,
    )


def fits(figure):
    """Draw the figure; everything drawn must lie on its canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    box = figure.get_tightbbox(canvas.get_renderer())
    width, height = figure.get_size_inches()
    assert box.x0 >= -0.01, box
    assert box.y0 >= -0.01, box
    assert box.x1 <= width + 0.01, box
    assert box.y1 <= height + 0.01, box
    return figure


def texts(legend):
    return [text.get_text() for text in legend.get_texts()]


def drawn(axis, color):
    """The lines of one color, as (line, x)."""
    return np.array([line.get_ydata() for line in axis.lines if to_hex(line.get_color()) == color])


TRUTH, MODEL, OTHER = style.TRUTH.lower(), style.PREDICTED.lower(), style.OTHER.lower()


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
    # One area only, with the margins of its error.
    np.testing.assert_allclose(drawn(area[0], TRUTH), [100 * small_cases.area[2, :, 18]])
    edges = [line.get_xdata()[0] for line in area[1].lines if line.get_color() == "black"]
    assert edges == [small_cases.z[5], small_cases.z[-6]]
    assert "40 % blockage, geometry 1, waveform 2" in area[0].get_title("right")
    assert drawn(pressure[0], OTHER).size == 0
    for bad, words in (
        ({"area_case": 12}, "area_case is 12"),
        ({"position": 1.2}, "position must be"),
        ({"time_point": -0.1}, "time_point must be"),
        ({"other": {"flow": small_cases.flow[1:]}}, "not of the 12 cases"),
    ):
        with pytest.raises(InputError, match=words):
            plots.results(predicted, small_cases, **bad)


def test_results_without_pressure_or_other_method(predicted, small_cases):
    figure = fits(plots.results({"flow": predicted["flow"]}, small_cases))
    assert len(figure.axes) == 2
    assert texts(figure.legends[0]) == ["3D, averaged", "PCNDE"]


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


def test_error_matrix(small_cases, predicted):
    train = small_cases.split("paper").train
    matrices = error_matrix(predicted, small_cases)
    figure = fits(plots.error_matrix(matrices, train))
    assert len(figure.axes) == 3
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
    with pytest.raises(InputError, match="no errors"):
        plots.box_plots(statistics.iloc[:0])


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
    with pytest.raises(InputError, match="case is 12"):
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
    # Time and space have axes of their own.
    assert rows[0, 0].get_ylim() != rows[0, 1].get_ylim()


def test_activations():
    index = pd.MultiIndex.from_product([["gelu", "relu"], [0, 1]], names=["activation", "seed"])
    columns = {
        "train": [0.004, 0.005, 0.2, 0.21],
        "train_explained": [0.999, 0.998, 0.01, 0.02],
        "test": [0.01, 0.012, 0.3, 0.31],
        "test_explained": [0.99, 0.98, 0.0, 0.01],
    }
    study = pd.DataFrame(columns, index=index)
    figure = fits(plots.activations(study))
    errors, variation = figure.axes
    assert texts(errors.get_legend()) == ["training", "test"]
    assert [tick.get_text() for tick in errors.get_xticklabels()] == ["gelu", "relu"]
    np.testing.assert_allclose(errors.lines[1].get_ydata(), study["test"])
    np.testing.assert_allclose(variation.lines[0].get_ydata(), 1 - study["train_explained"])
    with pytest.raises(InputError, match="no activation"):
        plots.activations(study.iloc[:0])


def test_loss_history_of_all_kinds_of_stages():
    rows = [("flow", 1, batch, 1, 0.5 / batch, 0.1) for batch in (1, 2)]
    rows += [("wall", 1, 1, i, 1e-3 / i, 0.1) for i in (1, 2, 3)]
    history = pd.DataFrame(
        rows, columns=["stage", "epoch", "batch", "iteration", "loss", "seconds"]
    )
    figure = fits(plots.loss_history(history))
    flow, wall, spare = figure.axes
    assert (flow.get_title(), flow.get_ylabel()) == ("flow", "loss (mL²/s²)")
    assert (wall.get_title(), wall.get_ylabel()) == ("wall", "loss (relative)")
    assert not spare.axison
    np.testing.assert_allclose(wall.lines[0].get_ydata(), [1e-3, 5e-4, 1e-3 / 3])
    with pytest.raises(InputError, match="no history"):
        plots.loss_history(history.iloc[:0])


def test_loss_history_of_several_starts():
    """Fits of many iterations have a line each: a mean over starts would say nothing."""
    rows = [("flow", 1, start, i, start / i, 0.1) for start in (1, 2, 3) for i in range(1, 31)]
    rows += [("flow", 2, 1, i, 0.03 / i, 0.1) for i in range(1, 21)]
    history = pd.DataFrame(
        rows, columns=["stage", "epoch", "batch", "iteration", "loss", "seconds"]
    )
    (axis, *_) = fits(plots.loss_history(history)).axes
    assert [len(line.get_xdata()) for line in axis.lines] == [30, 30, 30, 20]
    assert [line.get_xdata()[0] for line in axis.lines] == [1, 31, 61, 91]


# Machado, Oliveira and Fernandes (2009): how dichromats see linear RGB.
PROTANOPIA = [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]]
DEUTERANOPIA = [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]


@pytest.mark.parametrize("seen", [PROTANOPIA, DEUTERANOPIA], ids=["protanopia", "deuteranopia"])
def test_color_blind_readers_tell_the_curves_of_a_figure_apart(seen):
    def linear(color):
        rgb = np.array(to_rgb(color))
        return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)

    for names in (("truth", "model", "other"), ("truth", "model", "empirical")):
        looks = [style.LINE_STYLES[name] for name in names]
        colors = [np.cbrt(np.clip(np.array(seen) @ linear(k["color"]), 0, 1)) for k in looks]
        for i, j in combinations(range(3), 2):
            assert np.linalg.norm(colors[i] - colors[j]) > 0.2
        # And without any color, by the line.
        assert len({look["ls"] for look in looks}) == 3
