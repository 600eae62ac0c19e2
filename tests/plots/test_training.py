"""Losses of trainings that end early are to be seen, too."""

from __future__ import annotations

import pandas as pd
import pytest

from pcnde_bridge import plots

COLUMNS = ["stage", "epoch", "batch", "iteration", "loss", "seconds"]


def drawn(rows):
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
    axis = drawn([("wall", 1, 1, 1, loss, 0.1)])
    assert_seen(axis, 1, loss)
    ticks = [tick for tick in axis.get_xticks() if 0 <= tick <= 2]
    assert 1 in ticks
    assert all(tick == int(tick) for tick in ticks)


def test_the_mean_of_a_single_epoch_is_a_point():
    axis = drawn([("flow", 1, batch, 1, float(batch), 0.1) for batch in (1, 3)])
    assert_seen(axis, 2, 2.0)


def test_several_iterations_are_a_line():
    axis = drawn([("wall", 1, 1, i, 1 / i, 0.1) for i in (1, 2, 3)])
    assert axis.lines[0].get_linestyle() == "-"
    assert axis.lines[0].get_marker() == "None"
