"""Figures of errors: per case, per grid point, as box plots, and over the number of cases."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pcnde_bridge import studies
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CELL = 0.34  # size of a matrix cell, inches
_NARROWEST = 2.6  # width that the titles need, inches
_LEARNED = {
    "pressure_drop": "pressure drop",
    "one_minus_ffr": "1 − FFR",
    "flow": "flow",
    "area": "area",
    "pressure": "pressure",
    "wall_shear_stress": "wall shear stress",
}
# Names that matplotlib gives the statistics of a box.
_BOX = {"median": "med", "lower": "q1", "upper": "q3", "low": "whislo", "high": "whishi"}


def error_matrix(matrices: Mapping[str, pd.DataFrame], training: Cases | None = None) -> Figure:
    """Plot the relative error of every case (figure 4 d).

    Parameters
    ----------
    matrices : mapping of str to DataFrame
        Result of :func:`pcnde_bridge.studies.error_matrix`.
    training : Cases, optional
        Training cases, which are framed.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each variable with the errors in percent, on one color scale; a row for
        each geometry, with its blockage, and a column for each waveform.

    Raises
    ------
    InputError
        If there is no matrix.
    """
    if not matrices:
        raise InputError("There is no error matrix to plot.")
    rows, columns = next(iter(matrices.values())).shape
    width = len(matrices) * max(_CELL * columns + 0.5, _NARROWEST) + 0.3
    figure, axes = style.new_figure(width, _CELL * rows + 0.85, 1, len(matrices), grid=None)
    largest = 100 * max(np.nanmax(matrix) for matrix in matrices.values())
    for axis, (name, matrix) in zip(axes[0], matrices.items(), strict=True):
        percent = 100 * matrix.to_numpy()
        look = {"cmap": style.ERROR_COLORS, "vmin": 0, "vmax": largest}
        image = axis.imshow(percent, aspect="equal", **look)
        for (row, column), value in np.ndenumerate(percent):
            if np.isfinite(value):
                color = "white" if value > 0.62 * largest else "black"
                center = {"ha": "center", "va": "center"}
                axis.text(column, row, f"{value:.2f}", color=color, fontsize=6, **center)
        axis.set_xticks(range(columns), [str(key) for key in matrix.columns])
        axis.set_yticks(range(rows), [str(key) for key in matrix.index])
        axis.set_xlabel("waveform")
        axis.set_title(f"{style.QUANTITIES[name].name}: relative error (%)", fontsize=10)
        if training is not None:
            _frame(axis, matrix, training)
    axes[0, 0].set_ylabel("geometry")
    blockage = matrix.attrs.get("blockage", {})
    percents = [f"{100 * blockage[key]:.0f} %" if key in blockage else "" for key in matrix.index]
    right = axes[0, -1].secondary_yaxis("right")
    right.set_yticks(range(rows), percents)
    right.tick_params(labelsize=8)
    figure.colorbar(image, ax=axes, pad=0.02).set_label("relative error (%)", fontsize=8)
    return figure


def _frame(axis: Axes, matrix: pd.DataFrame, training: Cases) -> None:
    """Draw the outline of the training cases."""
    keys = set(training.labels[["geometry", "waveform"]].itertuples(index=False, name=None))
    inside = np.array([[(g, w) in keys for w in matrix.columns] for g in matrix.index])
    padded = np.pad(inside, 1)
    line: dict[str, Any] = {"color": style.TRUTH, "lw": 2.0, "clip_on": False}
    line["solid_capstyle"] = "projecting"
    for row, column in np.argwhere(np.diff(padded, axis=1)):
        axis.plot([column - 0.5] * 2, [row - 1.5, row - 0.5], **line)
    for row, column in np.argwhere(np.diff(padded, axis=0)):
        axis.plot([column - 1.5, column - 0.5], [row - 0.5] * 2, **line)


def pointwise_errors(errors: studies.PointwiseErrors, truth_label: str = "3D, averaged") -> Figure:
    """Plot truth, prediction and error over time and space (figure 6).

    Parameters
    ----------
    errors : PointwiseErrors
        Result of :func:`pcnde_bridge.studies.pointwise_errors`.
    truth_label : str
        Name of the truth, for the titles.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each variable: truth (top), prediction on the same color scale, and
        absolute error (bottom); the area's is relative to the area at the first time point.
    """
    case, names = errors.case, list(errors.predicted)
    width, shape = 2.9 * len(names), (3, len(names))
    figure, axes = style.new_figure(width, 6.6, *shape, grid=None, sharex=True, sharey=True)
    for column, name in zip(axes.T, names, strict=True):
        quantity = style.QUANTITIES[name]
        symbol = quantity.name.split()[-1]
        if name == "area":
            error, error_label = errors.distance[name], f"|Δ{symbol}| / {symbol}(t = 0)"
        else:
            error = quantity.factor * errors.distance[name]
            error_label = f"|Δ{symbol}| ({quantity.unit})"
        values = quantity.factor * np.stack([getattr(case, name)[0], errors.predicted[name]])
        for panels, arrays, low, cmap, label in (
            (column[:2], values, values.min(), style.VALUE_COLORS, quantity.label),
            (column[2:], error[None], 0.0, style.ERROR_COLORS, error_label),
        ):
            look = {"cmap": cmap, "vmin": low, "vmax": arrays.max(), "rasterized": True}
            for axis, array in zip(panels, arrays, strict=True):
                mesh = axis.pcolormesh(case.z, case.time, array, shading="nearest", **look)
            bar = figure.colorbar(mesh, ax=panels, aspect=15 * len(panels))
            bar.set_label(label, fontsize=8)
            bar.ax.tick_params(labelsize=7)
        column[0].set_title(quantity.name, fontsize=10)
        column[2].set_xlabel(style.SPACE_LABEL)
    for axis, text in zip(axes[:, 0], (truth_label, "PCNDE", "absolute error"), strict=True):
        axis.set_ylabel(f"{text}\n{style.TIME_LABEL}")
    return figure


def box_plots(statistics: pd.DataFrame) -> Figure:
    """Plot medians, quartiles, whiskers and the largest error (figure 7 a).

    Parameters
    ----------
    statistics : DataFrame
        Result of :func:`pcnde_bridge.studies.box_statistics`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each variable, a box for each method: the line is the median, the
        whiskers end at the outermost values within 1.5 interquartile ranges of the box,
        the dotted line and the cross reach the largest value.

    Raises
    ------
    InputError
        If there are no errors.
    """
    if statistics.empty:
        raise InputError("There are no errors to plot.")
    names = list(statistics.index.get_level_values("variable").unique())
    methods = list(statistics.index.get_level_values("method").unique())
    figure, axes = style.new_figure(2.4 * len(names), 3.2, 1, len(names), grid="y", sharey=True)
    for axis, name in zip(axes[0], names, strict=True):
        rows = statistics.loc[name].reindex(methods).dropna() * 100
        boxes = rows.rename(columns=_BOX).assign(label=rows.index).to_dict("records")
        line = {"color": style.TRUTH, "lw": 2}
        look: dict[str, Any] = {"widths": 0.55, "patch_artist": True, "showfliers": False}
        drawn = axis.bxp(boxes, medianprops=line, **look)
        for number, (box, patch) in enumerate(zip(boxes, drawn["boxes"], strict=True)):
            patch.set(facecolor=(style.PREDICTED, style.OTHER)[number % 2], alpha=0.45)
            ends = [box["whishi"], box["largest"]]
            axis.plot([number + 1] * 2, ends, ":", lw=1, color="black")
            axis.plot(number + 1, box["largest"], "x", ms=6, color="black")
        axis.set_title(style.QUANTITIES[name].name, fontsize=10)
    axes[0, 0].set_ylim(bottom=0)  # of all panels
    axes[0, 0].set_ylabel("pointwise relative error (%)")
    note = "line: median; box: quartiles; whiskers: within 1.5 box heights; cross: largest"
    figure.supxlabel(note, fontsize=8)
    return figure


def learning_curve(table: pd.DataFrame) -> Figure:
    """Plot the errors over the number of training cases.

    Parameters
    ----------
    table : DataFrame
        Result of :func:`pcnde_bridge.evaluation.learning_curve`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each error: the designed subsets, and median and range of the random ones.

    Raises
    ------
    InputError
        If no fit succeeded.
    """
    names = [name for name in _LEARNED if name in table and table[name].notna().any()]
    if not names:
        raise InputError("There are no errors to plot: every fit of the learning curve failed.")
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure, axes = style.new_figure(2.8 * columns, 2.3 * rows, rows, columns, sharex=True)
    errors = 100 * table[names]
    random = errors.index.get_level_values("subset") != "designed"
    drawn = errors[random].groupby("size")
    for axis, name in zip(axes.flat, names, strict=False):
        designed = errors[~random][name].droplevel("subset")
        axis.plot(designed, color=style.PREDICTED, marker="o", ms=4, label="designed")
        if random.any():
            line = {"color": style.OTHER, "ls": "--", "marker": "s", "ms": 3}
            axis.plot(drawn[name].median(), label="random: median, range", **line)
            low, high = drawn[name].min(), drawn[name].max()
            axis.fill_between(low.index, low, high, color=style.OTHER, alpha=0.2, lw=0)
        axis.set_title(_LEARNED[name], fontsize=10)
        axis.set_ylim(bottom=0)
        axis.set_xscale("log")
        axis.set_xticks(designed.index, [str(size) for size in designed.index])
        axis.minorticks_off()
    for axis in axes.flat[len(names) :]:
        axis.set_visible(False)
    axes[0, 0].legend(frameon=False, fontsize=8)
    figure.supylabel("relative error (%)", fontsize=9)
    figure.supxlabel("training cases", fontsize=9)
    return figure
