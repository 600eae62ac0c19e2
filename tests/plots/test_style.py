"""Shared style: color-blind readers can distinguish the curves."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from pcnde_bridge.plots import style

# Machado, Oliveira and Fernandes (2009): how dichromats see linear RGB.
PROTANOPIA = [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]]


DEUTERANOPIA = [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]


@pytest.mark.parametrize("seen", [PROTANOPIA, DEUTERANOPIA], ids=["protanopia", "deuteranopia"])
def test_color_blind_readers_can_distinguish_the_curves_of_a_figure(seen):
    def linear(color):
        rgb = np.array(to_rgb(color))
        return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)

    for third in (style.OTHER_LINE, style.EMPIRICAL_LINE):
        looks = [style.TRUTH_LINE, style.MODEL_LINE, third]
        colors = [np.cbrt(np.clip(np.array(seen) @ linear(k["color"]), 0, 1)) for k in looks]
        for i, j in combinations(range(3), 2):
            assert np.linalg.norm(colors[i] - colors[j]) > 0.2
        # Line styles differ, too.
        assert len({look["ls"] for look in looks}) == 3


def test_curves_are_named_where_there_is_space():
    _, [[axis]] = style.new_figure(3, 3)
    x = np.linspace(0, 1, 11)
    curves = np.outer([0.0, 1.0, 1.001, 2.0], np.sin(np.pi * x))
    style.label_curves(axis, x, curves, [1, 2, 3, 4])
    assert [text.get_text() for text in axis.texts] == ["1", "2", "4"]
    assert axis.texts[2].xy == (0.5, pytest.approx(2.0))
