"""Loss history and activation functions: lines, points and labels."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from plot_helpers import fits, texts

from pcnde_bridge import InputError, plots


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
    """Fits of many iterations have a line each, because a mean over starts would be meaningless."""
    rows = [("flow", 1, start, i, start / i, 0.1) for start in (1, 2, 3) for i in range(1, 31)]
    rows += [("flow", 2, 1, i, 0.03 / i, 0.1) for i in range(1, 21)]
    history = pd.DataFrame(
        rows, columns=["stage", "epoch", "batch", "iteration", "loss", "seconds"]
    )
    (axis, *_) = fits(plots.loss_history(history)).axes
    assert [len(line.get_xdata()) for line in axis.lines] == [30, 30, 30, 20]
    assert [line.get_xdata()[0] for line in axis.lines] == [1, 31, 61, 91]


COLUMNS = ["stage", "epoch", "batch", "iteration", "loss", "seconds"]


def axis_of(rows):
    (axis, *_) = plots.loss_history(pd.DataFrame(rows, columns=COLUMNS)).axes
    return axis


def assert_seen(axis, x, y):
    line = axis.lines[-1]
    assert (list(line.get_xdata()), list(line.get_ydata())) == ([x], [y])
    assert line.get_marker() == "o"
    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    assert left < x < right
    assert low < y < high


@pytest.mark.parametrize("loss", [2e-5, 0.3, 0.0])
def test_a_single_iteration_is_a_point(loss):
    axis = axis_of([("wall", 1, 1, 1, loss, 0.1)])
    assert_seen(axis, 1, loss)
    ticks = [tick for tick in axis.get_xticks() if 0 <= tick <= 2]
    assert 1 in ticks
    assert all(tick == int(tick) for tick in ticks)


def test_dots_and_their_mean_have_a_legend():
    rows = [("flow", e, batch, 1, batch / e, 0.1) for e in (1, 2, 3) for batch in (1, 3)]
    assert texts(axis_of(rows).get_legend()) == [
        "iteration",
        "mean of the batches at the end of an epoch",
    ]


def test_the_mean_of_a_single_epoch_is_a_point():
    axis = axis_of([("flow", 1, batch, 1, float(batch), 0.1) for batch in (1, 3)])
    assert_seen(axis, 2, 2.0)


def test_several_iterations_are_a_line():
    axis = axis_of([("wall", 1, 1, i, 1 / i, 0.1) for i in (1, 2, 3)])
    assert axis.lines[0].get_linestyle() == "-"
    assert axis.lines[0].get_marker() == "None"
