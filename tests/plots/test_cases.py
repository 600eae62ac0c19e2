"""Figure of a data set."""

from __future__ import annotations

import numpy as np
from plot_helpers import MODEL, TRUTH, drawn, fits, texts

from pcnde_bridge import plots


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
