"""Figures of training: loss history and activation functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pcnde_bridge.errors import InputError
from pcnde_bridge.plots import style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STAGES = {
    "flow": ("flow", "mL²/s²"),
    "intermediate_area": ("intermediate area", "cm⁴"),
    "fourier_area": ("Fourier area", "cm⁴"),
    "temporal_pressure": ("temporal pressure", "$p_{ref}^2$"),
    "spatial_pressure": ("spatial pressure", "$p_{ref}^2$"),
    "losses": ("losses", "relative"),
    "wall": ("wall", "relative"),
    "correction": ("correction", "scaled"),
}
"""Title and loss unit of each stage."""

_LONG_FIT = 20
"""Iterations from which each fit has a line of its own."""


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
        the batches of each epoch as a line; long fits, such as those of preset
        ``fast``, have a line each.

    Raises
    ------
    InputError
        If the history is empty.
    """
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    stages = [stage for stage in _STAGES if (history["stage"] == stage).any()]
    if not stages:
        raise InputError("There is no history to plot: this model has no record of a fit.")
    rows = -(-len(stages) // 3)
    figure, axes = style.new_figure(9.5, 2.6 * rows, rows, 3)
    for spare in axes.flat[len(stages) :]:
        spare.set_axis_off()
    for axis, stage in zip(axes.flat, stages, strict=False):
        fits = history[history["stage"] == stage]
        _plot_losses(axis, fits.assign(number=np.arange(1, len(fits) + 1)))
        loss = fits["loss"]
        if len(fits) == 1:
            axis.set_xlim(0, 2)
        if (loss > 0).all() and loss.max() > 10 * loss.min():
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axis.yaxis.set_minor_formatter(NullFormatter())
        else:
            axis.ticklabel_format(axis="y", useOffset=False, scilimits=(-2, 3))
            axis.yaxis.set_major_locator(MaxNLocator(4))
        axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        title, unit = _STAGES[stage]
        axis.set_title(title, fontsize=10)
        axis.set(xlabel="iteration", ylabel=f"loss ({unit})")
    return figure


def _plot_losses(axis: Axes, fits: pd.DataFrame) -> None:
    """Plot the losses of one stage: a line per fit, or the mean over the batches."""
    batches = fits.groupby(["epoch", "batch"], sort=False)
    lines, color = [fits], style.PREDICTED
    if fits["batch"].nunique() > 1 and len(fits) >= _LONG_FIT * batches.ngroups:
        lines = [fit for _, fit in batches]
    elif fits["batch"].nunique() > 1:
        look: dict[str, Any] = {"ms": 4, "alpha": 0.4, "mec": "none", "label": "iteration"}
        axis.plot(fits["number"], fits["loss"], ".", color=color, **look)
        # Mean over the batches of the last loss in each epoch.
        ends = batches.last().groupby("epoch")
        lines, color = [ends.agg({"number": "max", "loss": "mean"})], style.TRUTH
    for line in lines:
        # A line would not show a single loss.
        mark = "o" if len(line) == 1 else "-"
        axis.plot(line["number"], line["loss"], mark, lw=1.6, ms=4, color=color)
    if color == style.TRUTH:
        axis.lines[-1].set_label("mean of the batches at the end of an epoch")
        axis.legend(frameon=False, fontsize=7)


def activations(study: pd.DataFrame) -> Figure:
    """Plot the pressure errors with each activation function (section 3.2).

    Parameters
    ----------
    study : DataFrame
        Result of :func:`pcnde_bridge.studies.activation_study`.

    Returns
    -------
    matplotlib.figure.Figure
        Relative errors (left) and the unexplained fraction of the variance over time
        (right), both on logarithmic axes; a mark for each seed.

    Raises
    ------
    InputError
        If the study is empty.
    """
    if study.empty:
        raise InputError("There is no activation function to plot.")
    names = study.index.get_level_values("activation")
    known = list(names.unique())
    place = np.array([known.index(name) for name in names])
    figure, axes = style.new_figure(7.2, 3.0, 1, 2)
    errors, unexplained = axes[0]
    for subset, label, shift, color, marker in (
        ("train", "training", -0.12, style.OTHER, "o"),
        ("test", "test", 0.12, style.PREDICTED, "s"),
    ):
        if subset in study:
            look = {"ms": 5, "color": color, "label": label}
            errors.plot(place + shift, study[subset], marker, **look)
            unexplained.plot(place + shift, 1 - study[f"{subset}_explained"], marker, **look)
    errors.set_ylabel("relative error of the pressure")
    unexplained.set_ylabel("variance over time not explained")
    for axis in axes[0]:
        axis.set(yscale="log", xlabel="activation function", xlim=(-0.6, len(known) - 0.4))
        axis.set_xticks(range(len(known)), known)
    errors.legend(frameon=False, fontsize=8)
    return figure
