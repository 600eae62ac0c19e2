"""Figures of the studies of pressure drop, Fourier stage and noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pcnde_bridge.data.variables import MMHG
from pcnde_bridge.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pcnde_bridge.studies import FourierEffect, NoiseStudy, PressureDrops


def pressure_drops(drops: PressureDrops, *, truth_label: str = "3D, averaged") -> Figure:
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
        largest waveform label (b).
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
        axis.set_title(f"{fixed} {largest}, {rows.sum()} {varied[fixed]}", loc="left")
        axis.set_xlabel(style.TIME_LABEL)
    axes[0, 0].set_ylabel("pressure drop Δp (mmHg)")
    style.letter_panels(axes[0])
    style.add_legend(figure, axes[0, 0])
    return figure


def fourier_effect(
    effect: FourierEffect, case: int = 0, position: float = 0.9, truth_label: str = "3D, averaged"
) -> Figure:
    """Plot the area with and without the Fourier stage (figure 7 b).

    Parameters
    ----------
    effect : FourierEffect
        Result of :func:`pcnde_bridge.studies.fourier_effect`.
    case : int
        Position of the case that is shown.
    position : float
        Position in the vessel, as a fraction of its length.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        Area over two cycles: the area of the Fourier stage repeats; the intermediate
        area continues from the last cycle, with its drift over a cycle.

    Raises
    ------
    InputError
        If there is no such case or position.
    """
    cases = effect.cases
    style.check_case("case", case, cases)
    z_index = style.z_index_at(cases, position)
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
        style.plot_curves(axis, time, area.convert(values), label, look)
    axis.set(xlabel=style.TIME_LABEL, ylabel=area.label)
    axis.set_title(f"{style.case_name(cases, case)}, z = {cases.z[z_index]:.2f} cm", fontsize=9)
    style.add_legend(figure, axis)
    return figure


def noise(
    study: NoiseStudy,
    position: float = 0.9,
    time_point: float = 0.25,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot mean and standard deviation of noisy predictions (figures 8 and 10).

    Parameters
    ----------
    study : NoiseStudy
        Result of :func:`pcnde_bridge.studies.noise_study`.
    position : float
        Position of the left column, as a fraction of the vessel length.
    time_point : float
        Time point of the right column, as a fraction of the cycle.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each variable, over time (left) and space (right), with axes of their
        own; the band is one standard deviation on either side of the mean.

    Raises
    ------
    InputError
        If there is no such position or time point.
    """
    case, names = study.case, list(study.mean)
    shown = style.z_index_at(case, position), style.time_index_at(case, time_point)
    figure, rows = style.time_and_space_figure(7.2, 2.2 * len(names) + 0.3, names, case, *shown)
    band: dict[str, Any] = {"color": style.PREDICTED, "alpha": 0.25, "lw": 0}
    for name, panels in rows.items():
        values = study.mean[name], study.standard_deviation[name]
        mean, width = map(style.QUANTITIES[name].convert, values)
        for axis, x, cut in panels:
            limits = mean[cut] - width[cut], mean[cut] + width[cut]
            axis.fill_between(x, *limits, label="± standard deviation", **band)
    truth = {name: getattr(case, name)[0] for name in names}
    style.plot_rows(rows, truth, truth_label, {"ls": "-", "lw": 1.4, "color": style.TRUTH})
    look = {"ls": "--", "lw": 1.4, "color": style.PREDICTED}
    style.plot_rows(rows, study.mean, "mean of PCNDE", look)
    style.letter_panels(figure.axes[::2])
    style.add_legend(figure, figure.axes[0])
    return figure
