"""Figure of a data set: its waveforms, its geometries, and its split."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINES: dict[str, dict[str, Any]] = {
    "training": {"color": style.PREDICTED, "ls": "-", "lw": 1.0},
    "test": {"color": style.TRUTH, "ls": "--", "lw": 1.8},
}
_MARKERS: dict[str, dict[str, Any]] = {
    "training": {"color": style.PREDICTED, "marker": "s", "mfc": style.PREDICTED},
    "test": {"color": style.TRUTH, "marker": "D", "mfc": "none"},
}


def data_set(train: Cases, test: Cases | None = None) -> Figure:
    """Plot waveforms, geometries, and the split into training and test cases (figure 2).

    Parameters
    ----------
    train : Cases
        Training cases.
    test : Cases, optional
        Test cases.

    Returns
    -------
    matplotlib.figure.Figure
        Inflow of each waveform (left), radius of each geometry (middle), and the cases
        as a matrix of geometries and waveforms (right).  Waveforms and geometries that
        only test cases have are drawn as test cases are.
    """
    subsets = {"training": train} | ({} if test is None else {"test": test})
    figure, axes = style.new_figure(9.6, 3.2, 1, 3, width_ratios=(1, 1, 1.05))
    over_time, along, matrix = axes[0]
    drawn: dict[str, set[Any]] = {"waveform": set(), "geometry": set()}
    for subset, cases in subsets.items():
        radius = 10 * np.sqrt(cases.area_undeformed / np.pi)
        for axis, kind, x, curves in (
            (over_time, "waveform", cases.time, cases.inflow),
            (along, "geometry", cases.z, radius),
        ):
            for key in sorted(set(cases.labels[kind]) - drawn[kind]):
                row = int(np.flatnonzero(cases.labels[kind] == key)[0])
                axis.plot(x, curves[row], **_LINES[subset])
            drawn[kind] |= set(cases.labels[kind])
        places = cases.labels["waveform"], cases.labels["geometry"]
        matrix.plot(*places, ls="none", ms=6, label=subset, **_MARKERS[subset])
    over_time.set(xlabel=style.TIME_LABEL, ylabel="inflow Q_in (mL/s)")
    along.set(xlabel=style.SPACE_LABEL, ylabel="undeformed radius (mm)")
    along.set_ylim(bottom=0)
    matrix.set(xlabel="waveform", ylabel="geometry")
    matrix.set(xticks=sorted(drawn["waveform"]), yticks=sorted(drawn["geometry"]))
    matrix.invert_yaxis()
    matrix.grid(False)
    style.add_legend(figure, matrix)
    return figure
