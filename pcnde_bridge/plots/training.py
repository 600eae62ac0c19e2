"""Figures of training: losses, and activation functions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcnde_bridge.errors import InputError
from pcnde_bridge.plots.style import (
    OTHER,
    PREDICTED,
    TRUTH,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STAGE_UNITS = {
    "flow": ("flow", "mL²/s²"),
    "intermediate_area": ("intermediate area", "cm⁴"),
    "fourier_area": ("Fourier area", "cm⁴"),
    "temporal_pressure": ("temporal pressure", "p_ref²"),
    "spatial_pressure": ("spatial pressure", "p_ref²"),
    "losses": ("losses", "relative"),
    "wall": ("wall", "relative"),
    "correction": ("correction", "scaled"),
}


_LONG = 20  # iterations of a fit that is drawn by itself


def loss_history(history: pd.DataFrame) -> Figure:
    """Plot the loss of every stage over the iterations of its fit.

    Parameters
    ----------
    history : DataFrame
        :attr:`pcnde_bridge.PCNDE.history`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each stage that was fitted.  Stages that are fitted batch by
        batch in few iterations show every iteration as a pale dot, and the mean over
        the batches of each epoch as a line; long fits, such as the starts of preset
        ``fast``, have a line each.

    Raises
    ------
    InputError
        If the history is empty.
    """
    from matplotlib.ticker import MaxNLocator

    stages = [stage for stage in _STAGE_UNITS if (history["stage"] == stage).any()]
    if not stages:
        raise InputError("There is no history to plot: the model was not fitted here.")
    rows = -(-len(stages) // 3)
    figure, panels = new_figure(9.5, 2.6 * rows, rows, 3)
    axes = panels.ravel()
    for spare in axes[len(stages) :]:
        spare.set_axis_off()
    for axis, stage in zip(axes, stages, strict=False):
        fits = history[history["stage"] == stage]
        name, unit = _STAGE_UNITS[stage]
        number = np.arange(1, len(fits) + 1)
        loss = fits["loss"].to_numpy()
        fits = fits.assign(number=number)
        batches = fits.groupby(["epoch", "batch"], sort=False)
        if fits["batch"].nunique() == 1:
            _line(axis, number, loss, PREDICTED)
        elif len(fits) >= _LONG * batches.ngroups:
            for _, fit in batches:
                _line(axis, fit["number"], fit["loss"], PREDICTED)
        else:
            axis.plot(number, loss, ".", ms=4, alpha=0.4, mec="none", color=PREDICTED)
            # Each batch's last loss in each epoch, in the mean.
            ends = batches.last()
            means = ends.groupby("epoch")[["number", "loss"]].agg({"number": "max", "loss": "mean"})
            _line(axis, means["number"], means["loss"], TRUTH)
        if len(fits) == 1:
            axis.set_xlim(0, 2)
        if (loss > 0).all() and loss.max() > 10 * loss.min():
            axis.set_yscale("log")
        else:
            axis.ticklabel_format(axis="y", useOffset=False, scilimits=(-2, 3))
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_title(name, fontsize=10)
        axis.set_xlabel("iteration")
        axis.set_ylabel(f"loss ({unit})")
        plain(axis)
    return figure


def _line(axis: Axes, number: npt.ArrayLike, loss: npt.ArrayLike, colour: str) -> None:
    """Draw losses as a line, or a single one, which no line shows, as a point."""
    axis.plot(number, loss, "o" if np.size(loss) == 1 else "-", lw=1.6, ms=4, color=colour)


def activations(study: pd.DataFrame) -> Figure:
    """Plot the errors of the pressure with each activation function.

    Parameters
    ----------
    study : DataFrame
        Of :func:`pcnde_bridge.studies.activation_study`.

    Returns
    -------
    matplotlib.figure.Figure
        Relative errors (left) and the unexplained part of the variance over time
        (right), both on logarithmic axes; a mark for each seed.

    Raises
    ------
    InputError
        If there is nothing to plot.
    """
    if study.empty:
        raise InputError("There is no activation function to plot.")
    names = list(study.index.get_level_values("activation").unique())
    sets = [name for name in ("train", "test") if name in study]
    figure, panels = new_figure(7.2, 3.0, 1, 2)
    for axis, suffix, text in zip(
        panels[0],
        ("", "_explained"),
        ("relative error of the pressure", "variance over time not explained"),
        strict=True,
    ):
        for number, (name, colour, mark) in enumerate(
            zip(sets, (OTHER, PREDICTED), "os", strict=False)
        ):
            rows = study[name + suffix]
            where = [names.index(key) for key in study.index.get_level_values("activation")]
            values = (1 - rows if suffix else rows).to_numpy()
            shift = 0.12 * (2 * number - 1)
            label = {"train": "training", "test": "test"}[name]
            axis.plot(np.array(where) + shift, values, mark, ms=5, color=colour, label=label)
        axis.set_yscale("log")
        axis.set_xticks(range(len(names)), names)
        axis.set_xlim(-0.6, len(names) - 0.4)
        axis.set_ylabel(text)
        axis.set_xlabel("activation function")
        plain(axis)
    panels[0, 0].legend(frameon=False, fontsize=8)
    return figure
