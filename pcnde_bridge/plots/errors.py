"""Figures of errors: case by case, point by point, and as box plots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.plots.style import (
    ERRORS,
    OTHER,
    PREDICTED,
    QUANTITIES,
    SPACE,
    TIME,
    TRUTH,
    VALUES,
    label,
    new_figure,
    shown,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pcnde_bridge.studies import PointwiseErrors


def error_matrix(matrices: Mapping[str, pd.DataFrame], training: Cases | None = None) -> Figure:
    """Plot the relative error of every case: figure 4 d of the paper.

    Parameters
    ----------
    matrices : mapping of str to DataFrame
        Of :func:`pcnde_bridge.studies.error_matrix`.
    training : Cases, optional
        The training cases, which get a frame.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each variable with the errors in percent; geometries down,
        waveforms across.

    Raises
    ------
    InputError
        If there is nothing to plot.
    """
    if not matrices:
        raise InputError("There is no error matrix to plot.")
    shape = next(iter(matrices.values())).shape
    size = 0.34
    # At least wide enough for the titles.
    width = max(size * shape[1] + 0.5, 2.6)
    figure, axes = new_figure(len(matrices) * width + 0.3, size * shape[0] + 0.85, 1, len(matrices))
    for axis, (name, matrix) in zip(axes[0], matrices.items(), strict=True):
        percent = 100 * matrix.to_numpy()
        largest = np.nanmax(percent)
        axis.imshow(percent, cmap=ERRORS, vmin=0, vmax=largest, aspect="equal")
        for (row, column), value in np.ndenumerate(percent):
            if np.isfinite(value):
                colour = "white" if value > 0.62 * largest else "black"
                axis.text(
                    column, row, f"{value:.2f}", ha="center", va="center", color=colour, fontsize=6
                )
        axis.set_xticks(range(matrix.shape[1]), [str(key) for key in matrix.columns])
        axis.set_yticks(range(matrix.shape[0]), [str(key) for key in matrix.index])
        axis.tick_params(labelsize=8)
        axis.set_xlabel("waveform")
        axis.set_title(f"{QUANTITIES[name][0]}: relative error (%)", fontsize=10)
        if training is not None:
            _frame(axis, matrix, training)
    axes[0, 0].set_ylabel("geometry")
    return figure


def _frame(axis: Any, matrix: pd.DataFrame, training: Cases) -> None:
    """Draw a line between training cases and others, and around the training cases."""
    keys = set(training.labels[["geometry", "waveform"]].itertuples(index=False, name=None))
    inside = np.array([[(g, w) in keys for w in matrix.columns] for g in matrix.index])
    padded = np.pad(inside, 1)
    look = {"color": TRUTH, "lw": 2.0, "solid_capstyle": "projecting", "clip_on": False}
    for row, column in np.argwhere(padded[:, 1:] != padded[:, :-1]):
        axis.plot([column - 0.5] * 2, [row - 1.5, row - 0.5], **look)
    for row, column in np.argwhere(padded[1:] != padded[:-1]):
        axis.plot([column - 1.5, column - 0.5], [row - 0.5] * 2, **look)


def pointwise_errors(errors: PointwiseErrors, truth_label: str = "3D, averaged") -> Figure:
    """Plot truth, prediction and error over time and space: figure 6 of the paper.

    Parameters
    ----------
    errors : PointwiseErrors
        Of :func:`pcnde_bridge.studies.pointwise_errors`.
    truth_label : str
        What the case is, for the titles.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each variable: truth (top), prediction on the same colours, and
        absolute error (bottom), of the area relative to the area at the first instant.
    """
    case, names = errors.case, list(errors.predicted)
    figure, axes = new_figure(2.9 * len(names), 6.6, 3, len(names), sharex=True, sharey=True)
    for column, name in zip(axes.T, names, strict=True):
        truth = shown(name, getattr(case, name)[0])
        predicted = shown(name, errors.predicted[name])
        low, high = min(truth.min(), predicted.min()), max(truth.max(), predicted.max())
        distance = errors.distance[name]
        wrong = distance if name == "area" else shown(name, distance)
        for axis, values, colours, limits in (
            (column[0], truth, VALUES, (low, high)),
            (column[1], predicted, VALUES, (low, high)),
            (column[2], wrong, ERRORS, (0.0, wrong.max())),
        ):
            mesh = axis.pcolormesh(
                case.z,
                case.time,
                values,
                cmap=colours,
                vmin=limits[0],
                vmax=limits[1],
                shading="nearest",
                rasterized=True,
            )
            axis.tick_params(labelsize=8)
            if axis is not column[0]:
                both = axis is column[1]
                bar = figure.colorbar(
                    mesh, ax=column[:2] if both else axis, aspect=30 if both else 15
                )
                bar.set_label(label(name) if both else _distance(name), fontsize=8)
                bar.ax.tick_params(labelsize=7)
        column[0].set_title(QUANTITIES[name][0], fontsize=10)
        column[2].set_xlabel(SPACE)
    for axis, text in zip(axes[:, 0], (truth_label, "PCNDE", "absolute error"), strict=True):
        axis.set_ylabel(f"{text}\n{TIME}")
    return figure


def _distance(name: str) -> str:
    """Label of an error's colours."""
    symbol = QUANTITIES[name][0].split()[-1]
    return (
        f"|Δ{symbol}| / {symbol}(t = 0)"
        if name == "area"
        else f"|Δ{symbol}| ({QUANTITIES[name][1]})"
    )


def box_plots(statistics: pd.DataFrame) -> Figure:
    """Plot medians, quartiles, whiskers and the largest error: figure 7 a of the paper.

    Parameters
    ----------
    statistics : DataFrame
        Of :func:`pcnde_bridge.studies.box_statistics`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each variable, a box for each method: the line is the median, the
        whiskers reach to the outermost values within 1.5 quartile distances, the
        dotted line and the cross to the largest value.

    Raises
    ------
    InputError
        If there is nothing to plot.
    """
    if statistics.empty:
        raise InputError("There are no errors to plot.")
    names = list(statistics.index.get_level_values("variable").unique())
    methods = list(statistics.index.get_level_values("method").unique())
    figure, axes = new_figure(2.4 * len(names), 3.2, 1, len(names), sharey=True)
    for axis, name in zip(axes[0], names, strict=True):
        rows = statistics.loc[name].reindex(methods).dropna() * 100
        boxes = [
            {
                "label": method,
                "med": row["median"],
                "q1": row["lower"],
                "q3": row["upper"],
                "whislo": row["low"],
                "whishi": row["high"],
                "fliers": [],
            }
            for method, row in rows.iterrows()
        ]
        drawn = axis.bxp(
            boxes,
            widths=0.55,
            showfliers=False,
            patch_artist=True,
            medianprops={"color": TRUTH, "lw": 2},
        )
        for number, (patch, largest) in enumerate(
            zip(drawn["boxes"], rows["largest"], strict=True)
        ):
            colour = (PREDICTED, OTHER)[number % 2]
            patch.set(facecolor=colour, alpha=0.45)
            high = boxes[number]["whishi"]
            axis.plot([number + 1] * 2, [high, largest], ":", lw=1, color="black")
            axis.plot(number + 1, largest, "x", ms=6, color="black")
        axis.set_title(QUANTITIES[name][0], fontsize=10)
        axis.grid(axis="y", alpha=0.3)
        axis.tick_params(labelsize=8)
        axis.set_ylim(bottom=0)
    axes[0, 0].set_ylabel("pointwise relative error (%)")
    return figure
