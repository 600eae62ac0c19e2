"""Figures of the paper's studies: pressure drop, Fourier stage, noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcnde_bridge.errors import InputError
from pcnde_bridge.plots.style import (
    MMHG,
    PREDICTED,
    TIME,
    TRUTH,
    bundle,
    case_name,
    headings,
    label,
    legend_above,
    letters,
    moment,
    new_figure,
    place,
    plain,
    shown,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pcnde_bridge.studies import (
        FourierEffect,
        NoiseStudy,
        PressureDrops,
    )


def pressure_drops(drops: PressureDrops, *, truth_label: str = "3D, averaged") -> Figure:
    """Plot pressure drops over time beside the empirical formula: figure 5 of the paper.

    Parameters
    ----------
    drops : PressureDrops
        Of :func:`pcnde_bridge.studies.pressure_drops`, on test cases.
    truth_label : str
        What the cases are, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        All waveforms in the largest geometry label (a), and all geometries under the
        largest waveform label (b).
    """
    labels = drops.cases.labels
    figure, axes = new_figure(7.2, 3.3, 1, 2)
    for axis, fixed, varied in (
        (axes[0, 0], "geometry", "waveforms"),
        (axes[0, 1], "waveform", "geometries"),
    ):
        largest = labels[fixed].max()
        rows = (labels[fixed] == largest).to_numpy()
        for values, look, name in (
            (drops.truth, "truth", truth_label),
            (drops.empirical, "empirical", "Seeley and Young"),
            (drops.predicted, "model", "PCNDE"),
        ):
            bundle(axis, drops.cases.time, values[rows] / MMHG, look, name)
        axis.set_title(f"{fixed} {largest}, {rows.sum()} {varied}", loc="left")
        axis.set_xlabel(TIME)
        plain(axis)
    axes[0, 0].set_ylabel("pressure drop Δp (mmHg)")
    letters(axes[0])
    legend_above(figure, axes[0, 0])
    return figure


def fourier_effect(
    effect: FourierEffect,
    case: int = 0,
    position: float = 0.9,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot the area with and without the Fourier stage: figure 7 b of the paper.

    Parameters
    ----------
    effect : FourierEffect
        Of :func:`pcnde_bridge.studies.fourier_effect`.
    case : int
        Which case.
    position : float
        Where, as a part of the vessel's length.
    truth_label : str
        What the cases are, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        Area over two cycles: the area of the Fourier stage repeats, the other goes on
        from the last cycle to where it would be in the next.

    Raises
    ------
    InputError
        If there is no such case or place.
    """
    cases = effect.cases
    if not -len(cases) <= case < len(cases):
        raise InputError(f"case is {case}; there are {len(cases)} cases.")
    z_index = place(cases, position)
    time = np.concatenate([cases.time, cases.time + cases.period])
    first = effect.intermediate[case, :, z_index]
    figure, axes = new_figure(5.8, 3.3)
    axis = axes[0, 0]
    axis.axvline(cases.time[0] + cases.period, color="black", lw=0.8)
    for values, look, name in (
        (np.tile(cases.area[case, :, z_index], 2), "truth", truth_label),
        (
            np.concatenate([first, first + effect.drift[case, z_index]]),
            "other",
            "continuity equation Ŝ",
        ),
        (np.tile(effect.final[case, :, z_index], 2), "model", "Fourier stage S"),
    ):
        bundle(axis, time, shown("area", values[None]), look, name)
    axis.set_xlabel(TIME)
    axis.set_ylabel(label("area"))
    axis.set_title(f"{case_name(cases, case)}, z = {cases.z[z_index]:.2f} cm", fontsize=9)
    plain(axis)
    legend_above(figure, axis)
    return figure


def noise(
    study: NoiseStudy,
    position: float = 0.9,
    instant: float = 0.25,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot mean and standard deviation of noisy predictions: figures 8 and 10 of the paper.

    Parameters
    ----------
    study : NoiseStudy
        Of :func:`pcnde_bridge.studies.noise_study`.
    position : float
        Where the left column is taken, as a part of the vessel's length.
    instant : float
        When the right column is taken, as a part of the cycle.
    truth_label : str
        What the case is, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each variable, over time (left) and space (right), with axes of their
        own; the band is one standard deviation to either side of the mean.

    Raises
    ------
    InputError
        If there is no such place or instant.
    """
    case = study.case
    z_index, t_index = place(case, position), moment(case, instant)
    figure, axes = new_figure(7.2, 2.2 * len(study.mean) + 0.3, len(study.mean), 2)
    for row, (name, mean) in zip(axes, study.mean.items(), strict=True):
        truth = getattr(case, name)[0]
        deviation = study.deviation[name]
        for axis, x, cut in (
            (row[0], case.time, (slice(None), z_index)),
            (row[1], case.z, (t_index, slice(None))),
        ):
            middle, width = shown(name, mean[cut]), shown(name, deviation[cut])
            axis.fill_between(
                x,
                middle - width,
                middle + width,
                color=PREDICTED,
                alpha=0.25,
                lw=0,
                label="± standard deviation",
            )
            axis.plot(x, shown(name, truth[cut]), "-", lw=1.4, color=TRUTH, label=truth_label)
            axis.plot(x, middle, "--", lw=1.4, color=PREDICTED, label="mean of PCNDE")
            plain(axis)
        row[0].set_ylabel(label(name))
    headings(axes, case, z_index, t_index)
    letters(axes[:, 0])
    legend_above(figure, axes[0, 0])
    return figure
