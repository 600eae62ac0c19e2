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
    for axis, fixed, varied in (
        (axes[0, 0], "geometry", "waveforms"),
        (axes[0, 1], "waveform", "geometries"),
    ):
        largest = labels[fixed].max()
        rows = (labels[fixed] == largest).to_numpy()
        for method, label, values in (
            ("truth", truth_label, drops.truth),
            ("empirical", "Seeley and Young", drops.empirical),
            ("model", "PCNDE", drops.predicted),
        ):
            style.plot_curves(axis, drops.cases.time, values[rows] / MMHG, method, label)
        axis.set_title(f"{fixed} {largest}, {rows.sum()} {varied}", loc="left")
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
    for method, label, values in (
        ("truth", truth_label, np.tile(cases.area[case, :, z_index], 2)),
        ("other", "continuity equation Ŝ", intermediate),
        ("model", "Fourier stage S", np.tile(effect.final[case, :, z_index], 2)),
    ):
        style.plot_curves(axis, time, style.QUANTITIES["area"].convert(values[None]), method, label)
    axis.set(xlabel=style.TIME_LABEL, ylabel=style.QUANTITIES["area"].label)
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
    band: dict[str, Any] = {
        "color": style.PREDICTED,
        "alpha": 0.25,
        "lw": 0,
        "label": "± standard deviation",
    }
    for panels, name in zip(rows, names, strict=True):
        values = getattr(case, name)[0], study.mean[name], study.standard_deviation[name]
        truth, mean, width = map(style.QUANTITIES[name].convert, values)
        for axis, x, cut in panels:
            axis.fill_between(x, mean[cut] - width[cut], mean[cut] + width[cut], **band)
            axis.plot(x, truth[cut], "-", lw=1.4, color=style.TRUTH, label=truth_label)
            axis.plot(x, mean[cut], "--", lw=1.4, color=style.PREDICTED, label="mean of PCNDE")
    style.letter_panels([over_time.axis for over_time, _ in rows])
    style.add_legend(figure, rows[0][0].axis)
    return figure
