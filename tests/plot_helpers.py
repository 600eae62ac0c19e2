"""Helpers of the tests of figures: layout, legend texts and curves of a color."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex

from pcnde_bridge.plots import style

MMHG = 1333.22
TRUTH, MODEL, OTHER = style.TRUTH.lower(), style.PREDICTED.lower(), style.OTHER.lower()


def fits(figure):
    """Draw the figure; everything drawn must lie on its canvas."""
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
