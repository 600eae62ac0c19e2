"""Figure of a data set: its waveforms, its geometries, and how it is divided."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.plots.style import (
    PREDICTED,
    SPACE,
    TIME,
    TRUTH,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def data_set(train: Cases, test: Cases | None = None) -> Figure:
    """Plot waveforms, geometries, and which cases are for training: figure 2 of the paper.

    Parameters
    ----------
    train : Cases
        The training cases.
    test : Cases, optional
        The test cases.

    Returns
    -------
    matplotlib.figure.Figure
        Inflow of each waveform (left), radius of each geometry (middle), and the cases
        as a matrix of geometries and waveforms (right).  Waveforms and geometries that
        only test cases have are drawn as test cases are.
    """
    sets = {"training": train} | ({} if test is None else {"test": test})
    figure, axes = new_figure(9.6, 3.2, 1, 3, width_ratios=(1, 1, 1.05))
    over_time, along, matrix = axes[0]
    looks = {"training": (PREDICTED, "-", 1.0), "test": (TRUTH, "--", 1.8)}
    seen: dict[str, set[object]] = {"waveform": set(), "geometry": set()}
    for name, cases in sets.items():
        colour, style, width = looks[name]
        labels = cases.labels
        for axis, kind in ((over_time, "waveform"), (along, "geometry")):
            text: str | None = name
            for key in sorted(set(labels[kind]) - seen[kind]):
                first = int(np.flatnonzero(labels[kind] == key)[0])
                if kind == "waveform":
                    x, y = cases.time, cases.inflow[first]
                else:
                    x, y = cases.z, 10 * np.sqrt(cases.area_undeformed[first] / np.pi)
                axis.plot(x, y, ls=style, lw=width, color=colour, label=text)
                text = None
            seen[kind] |= set(labels[kind])
        matrix.plot(
            labels["waveform"],
            labels["geometry"],
            "s" if name == "training" else "D",
            ms=6,
            color=colour,
            mfc=colour if name == "training" else "none",
            label=name,
        )
    over_time.set_xlabel(TIME)
    over_time.set_ylabel("inflow Q_in (mL/s)")
    along.set_xlabel(SPACE)
    along.set_ylabel("undeformed radius (mm)")
    along.set_ylim(bottom=0)
    matrix.set_xlabel("waveform")
    matrix.set_ylabel("geometry")
    matrix.set_xticks(sorted(seen["waveform"]))  # type: ignore[type-var]
    matrix.set_yticks(sorted(seen["geometry"]))  # type: ignore[type-var]
    matrix.invert_yaxis()
    for axis in (over_time, along):
        plain(axis)
    matrix.tick_params(labelsize=8)
    figure.legend(
        *matrix.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=2,
        frameon=False,
        fontsize=9,
    )
    return figure
