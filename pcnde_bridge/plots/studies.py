"""Figures of the studies of pressure drop, Fourier stage, noise, formulations and landscapes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pcnde_bridge import studies
from pcnde_bridge.data.variables import MMHG
from pcnde_bridge.errors import InputError
from pcnde_bridge.plots import style
from pcnde_bridge.studies.landscapes import Moment

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DOTS = {"color": style.TRUTH, "ls": "none", "marker": ".", "ms": 5, "mfc": "none", "mew": 0.6}
_FORMULATIONS: dict[str, dict[str, Any]] = {
    "truth": _DOTS,
    "spatial": {"color": style.PREDICTED, "ls": "-", "label": "in space, $f(Q, S)$"},
    "temporal": {"color": style.OTHER, "ls": "-", "label": "in time, $f(Q)$"},
    "temporal_with_time": {"color": "#CC79A7", "ls": "--", "label": "in time, $f(Q, t)$"},
}

_EQUATIONS = {
    "network": r"$f_\theta$",
    "friction": r"$f_\theta + \frac{N}{2(1+\delta)}$",
    "convection": r"$f_\theta + \frac{1}{2}\frac{Q}{S}\frac{\partial S}{\partial z}$",
    "inertia": r"$f_\theta - \frac{1}{2(1+\delta)}\frac{S}{Q}\frac{\partial Q}{\partial t}$",
}

_MOMENTS: dict[Moment, str] = {
    "initial": "after the first batch",
    "coupled": "after the first coupling",
}


def pressure_drops(drops: studies.PressureDrops, *, truth_label: str = "3D, averaged") -> Figure:
    """Plot pressure drops over time, with the empirical formula (figure 5).

    Parameters
    ----------
    drops : PressureDrops
        Result of :func:`pcnde_bridge.studies.pressure_drops`, for test cases.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        All waveforms in the largest geometry label (a), and all geometries with the
        largest waveform label (b); numbers are the labels of the truth.
    """
    labels = drops.cases.labels
    figure, axes = style.new_figure(7.2, 3.3, 1, 2)
    varied = {"geometry": "waveforms", "waveform": "geometries"}
    for axis, fixed in zip(axes[0], varied, strict=True):
        largest = labels[fixed].max()
        rows = (labels[fixed] == largest).to_numpy()
        for values, label, look in (
            (drops.truth, truth_label, style.TRUTH_LINE),
            (drops.empirical, "Seeley and Young", style.EMPIRICAL_LINE),
            (drops.predicted, "PCNDE", style.MODEL_LINE),
        ):
            style.plot_curves(axis, drops.cases.time, values[rows] / MMHG, label, look)
        names = labels["waveform" if fixed == "geometry" else "geometry"][rows]
        style.label_curves(axis, drops.cases.time, drops.truth[rows] / MMHG, names)
        axis.set_title(f"{fixed} {largest}, {rows.sum()} {varied[fixed]}", loc="left")
        axis.set_xlabel(style.TIME_LABEL)
    axes[0, 0].set_ylabel("pressure drop Δp (mmHg)")
    style.letter_panels(axes[0])
    style.add_legend(figure, axes[0, 0])
    return figure


def fourier_effect(
    effect: studies.FourierEffect, case: int = 0, truth_label: str = "3D, averaged"
) -> Figure:
    """Plot the area with and without the Fourier stage (figure 7 b).

    Parameters
    ----------
    effect : FourierEffect
        Result of :func:`pcnde_bridge.studies.fourier_effect`.
    case : int
        Position of the case that is shown.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        Area over two cycles, at 90 % of the length: the area of the Fourier stage repeats;
        the intermediate area continues from the last cycle, with its drift over a cycle.

    Raises
    ------
    InputError
        If there is no such case.
    """
    cases = effect.cases
    z_index, _ = style.locate(cases, case, style.POSITION)
    time = np.concatenate([cases.time, cases.time + cases.period])
    first = effect.intermediate[case, :, z_index]
    intermediate = np.concatenate([first, first + effect.drift[case, z_index]])
    figure, [[axis]] = style.new_figure(5.8, 3.3)
    axis.axvline(cases.time[0] + cases.period, color="black", lw=0.8)
    area = style.QUANTITIES["area"]
    for values, label, look in (
        (np.tile(cases.area[case, :, z_index], 2), truth_label, style.TRUTH_LINE),
        (intermediate, "continuity equation Ŝ", style.OTHER_LINE),
        (np.tile(effect.final[case, :, z_index], 2), "Fourier stage S", style.MODEL_LINE),
    ):
        style.plot_curves(axis, time, area.factor * values, label, look)
    axis.set(xlabel=style.TIME_LABEL, ylabel=area.label)
    axis.set_title(f"{style.case_name(cases, case)}, z = {cases.z[z_index]:.2f} cm", fontsize=9)
    style.add_legend(figure, axis)
    return figure


def noise(study: studies.NoiseStudy, truth_label: str = "3D, averaged") -> Figure:
    """Plot mean and standard deviation of noisy predictions (figures 8 and 10).

    Parameters
    ----------
    study : NoiseStudy
        Result of :func:`pcnde_bridge.studies.noise_study`.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each variable, over time at 90 % of the length (left) and over space after
        a quarter of the cycle (right), with axes of their own; the band is one standard
        deviation on either side of the mean.
    """
    case, names = study.case, list(study.mean)
    shown = style.locate(case, 0, style.POSITION, style.TIME_POINT)
    figure, rows = style.time_and_space_figure(7.2, 2.2 * len(names) + 0.3, names, case, *shown)
    band: dict[str, Any] = {"color": style.PREDICTED, "alpha": 0.25, "lw": 0}
    for name, panels in rows.items():
        factor = style.QUANTITIES[name].factor
        mean, width = factor * study.mean[name], factor * study.standard_deviation[name]
        for axis, x, cut in panels:
            limits = mean[cut] - width[cut], mean[cut] + width[cut]
            axis.fill_between(x, *limits, label="± standard deviation", **band)
    truth = {name: values[0] for name, values in case.variables().items()}
    style.plot_rows(rows, truth, truth_label, {"ls": "-", "lw": 1.4, "color": style.TRUTH})
    look = {"ls": "--", "lw": 1.4, "color": style.PREDICTED}
    style.plot_rows(rows, study.mean, "mean of PCNDE", look)
    style.letter_panels(figure.axes[::2])
    style.add_legend(figure, figure.axes[0])
    return figure


def smoothness(
    study: studies.FormulationStudy,
    subset: str = "train",
    case: int = 0,
    position: float = style.POSITION,
    *,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot flow, its slope and the area from continuity for each formulation (figure 3).

    Parameters
    ----------
    study : FormulationStudy
        Result of :func:`pcnde_bridge.studies.compare_formulations`.
    subset : {'train', 'test'}
        Training or test cases.
    case : int
        Position of the case that is shown.
    position : float
        Position of the lower row, as a fraction of the vessel length.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        Values along the vessel at the peak of the inflow (top), and over time (bottom).

    Raises
    ------
    InputError
        If there is no such subset, case or position.
    """
    if subset not in study.cases:
        raise InputError(f"The study has no subset {subset!r}.")
    cases = study.cases[subset]
    z_index, time_index = style.locate(cases, case, position)
    figure, axes = style.new_figure(10, 5.4, 2, 3)
    for (name, which), found in study.results.items():
        if which != subset:
            continue
        look = {"label": truth_label, "lw": 1.5} | _FORMULATIONS[name]
        # The true area is the measured one, not what continuity gives for the true flow.
        area = cases.area if name == "truth" else found.continuity_area
        for column, values in enumerate((found.flow, found.slope, 100 * area)):
            axes[0, column].plot(cases.z, values[case, time_index], **look)
            axes[1, column].plot(cases.time, values[case, :, z_index], **look)
    titles = "flow Q (mL/s)", "slope ∂Q/∂z (mL/s/cm)", "area S from continuity (mm²)"
    for (top, bottom), title in zip(axes.T, titles, strict=True):
        top.set_title(title, fontsize=10)
        top.set_xlabel(style.SPACE_LABEL)
        bottom.set_xlabel(style.TIME_LABEL)
    for column, truth in ((1, study.results["truth", subset].slope), (2, 100 * cases.area)):
        largest = np.abs(truth[case]).max()
        for axis in axes[:, column]:
            if np.abs(axis.get_ylim()).max() > 10 * largest:  # would hide the truth
                axis.set_yscale("symlog", linthresh=2 * largest)
    axes[0, 0].set_ylabel(f"t = {cases.time[time_index]:.2f} s")
    axes[1, 0].set_ylabel(f"z = {cases.z[z_index]:.1f} cm")
    style.add_legend(figure, axes[0, 0], below=True)
    return figure


def landscapes(study: studies.LandscapeStudy) -> Figure:
    """Plot the loss over the two amplitudes for every right-hand side (figure 9).

    Parameters
    ----------
    study : LandscapeStudy
        Result of :func:`pcnde_bridge.studies.explore_landscapes`.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each right-hand side, a row for each moment of training.  Each panel
        has a logarithmic color scale of its own; the equation diverges in gray areas, and
        the cross is the trained network.
    """
    names = list(study.outcomes)
    width, shape = 2.9 * len(names) + 0.4, (len(_MOMENTS), len(names))
    figure, axes = style.new_figure(width, 5.6, *shape, grid=None, sharex=True, sharey=True)
    for (moment, description), row in zip(_MOMENTS.items(), axes, strict=True):
        for name, axis in zip(names, row, strict=True):
            _plot_landscape(figure, axis, study, name, moment)
        row[0].set_ylabel(f"{description}\n" + r"amplitude $\alpha_2$")
    for name, column in zip(names, axes.T, strict=True):
        column[0].set_title(_EQUATIONS.get(name, name), fontsize=12, pad=12)
        column[-1].set_xlabel(r"amplitude $\alpha_1$")
    return figure


def _plot_landscape(
    figure: Figure, axis: Axes, study: studies.LandscapeStudy, name: str, moment: Moment
) -> None:
    """Plot one landscape, or write why there is none."""
    from matplotlib.colors import LogNorm

    axis.set_facecolor("0.8")
    axis.set_box_aspect(1)
    landscape = study.landscape(name, moment)
    if landscape is None or landscape.diverged.all():
        text = "diverges at all points" if landscape is not None else study.outcomes[name]
        for before, after in ((" at ", "\nat "), (" after ", "\nafter "), (", ", ",\n")):
            text = text.replace(before, after)
        axis.text(0.5, 0.5, text, ha="center", va="center", transform=axis.transAxes, fontsize=9)
        return
    x = landscape.amplitudes
    losses = landscape.losses.T  # matplotlib has x along the columns, the first index is α₁
    low, high = (limit(losses[np.isfinite(losses)]) for limit in (np.min, np.max))
    scale: dict[str, Any] = {"norm": LogNorm(low, max(high, 1.001 * low)), "cmap": "cividis"}
    mesh = axis.pcolormesh(x, x, np.ma.masked_invalid(losses), shading="nearest", **scale)
    if not landscape.diverged.any():
        levels = np.geomspace(low, high, 9)[1:-1]
        axis.contour(x, x, losses, levels=levels, colors="white", linewidths=0.6)
    axis.plot(0, 0, "+", ms=9, color=style.TRUTH)
    figure.colorbar(mesh, ax=axis, shrink=0.75, label="loss (mL²/s²)")
