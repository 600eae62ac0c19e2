"""Figures of data sets, predictions, training and studies.

Each function takes results and returns a matplotlib Figure; :mod:`pcnde_bridge.plots.figures`
writes the paper's figures into files.
"""

from pcnde_bridge.plots.cases import data_set, results, time_and_space
from pcnde_bridge.plots.errors import box_plots, error_matrix, learning_curve, pointwise_errors
from pcnde_bridge.plots.studies import (
    fourier_effect,
    landscapes,
    noise,
    pressure_drops,
    smoothness,
)
from pcnde_bridge.plots.training import activations, loss_history

__all__ = [
    "activations",
    "box_plots",
    "data_set",
    "error_matrix",
    "fourier_effect",
    "landscapes",
    "learning_curve",
    "loss_history",
    "noise",
    "pointwise_errors",
    "pressure_drops",
    "results",
    "smoothness",
    "time_and_space",
]
