"""Figures of cases: a data set, and predictions beside the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import FIELDS
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import AREA_MARGIN
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SUBSETS: dict[str, dict[str, Any]] = {
    "training": {"color": style.PREDICTED, "marker": "s", "mfc": style.PREDICTED, "lw": 1.0},
    "test": {"color": style.TRUTH, "marker": "D", "mfc": "none", "ls": "--", "lw": 1.8},
}
"""Look of lines and markers of training and test cases."""


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
                axis.plot(x, curves[row], gid=key, **_SUBSETS[subset] | {"marker": ""})
            drawn[kind] |= set(cases.labels[kind])
        places = cases.labels["waveform"], cases.labels["geometry"]
        matrix.plot(*places, ms=6, label=subset, **_SUBSETS[subset] | {"ls": "none"})
    for axis, kind in ((over_time, "waveform"), (along, "geometry")):
        keys = sorted(drawn[kind])
        shown = {line.get_gid(): np.asarray(line.get_ydata()) for line in axis.lines}
        abscissa = np.asarray(axis.lines[0].get_xdata())
        style.label_curves(axis, abscissa, np.array([shown[key] for key in keys]), keys)
        axis.set_title(f"numbers: {kind}", fontsize=8)
    over_time.set(xlabel=style.TIME_LABEL, ylabel="inflow $Q_{in}$ (mL/s)")
    along.set(xlabel=style.SPACE_LABEL, ylabel="undeformed radius (mm)")
    along.set_ylim(bottom=0)
    matrix.set(xlabel="waveform", ylabel="geometry")
    matrix.set(xticks=sorted(drawn["waveform"]), yticks=sorted(drawn["geometry"]))
    matrix.invert_yaxis()
    matrix.grid(False)
    style.add_legend(figure, matrix)
    return figure


def time_and_space(
    prediction: Prediction,
    cases: Cases | None = None,
    case: int = 0,
    position: float = style.POSITION,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot one case over time near the outlet, and along the vessel at its peak inflow.

    Parameters
    ----------
    prediction : Prediction
        Prediction of the cases.
    cases : Cases, optional
        The truth.
    case : int
        Position of the case that is shown.
    position : float
        Position of the left column, as a fraction of the vessel length; the paper's
        figures use 0.9.
    truth_label : str
        Name of the truth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each predicted variable, over time (left) and space (right), with 90 %
        intervals if the prediction has samples.

    Raises
    ------
    InputError
        If prediction and cases differ in number, or there is no such case or position.
    """
    if cases is not None and len(prediction) != len(cases):
        raise InputError(f"There are {len(cases)} cases, but {len(prediction)} are predicted.")
    shown = style.locate(prediction, case, position)
    predicted = {name: values[case] for name, values in prediction.variables().items()}
    size = 8, 2.4 * len(predicted)
    figure, rows = style.time_and_space_figure(*size, list(predicted), prediction, *shown)
    if cases is not None:
        truth = {name: values[case] for name, values in cases.variables().items()}
        markers = {"ls": "none", "marker": "o", "ms": 3, "mfc": "none", "color": style.TRUTH}
        style.plot_rows(rows, truth, truth_label, markers)
    style.plot_rows(rows, predicted, "PCNDE", {"ls": "-", "lw": 1.6, "color": style.PREDICTED})
    limits = {} if prediction.samples is None else prediction.interval(0.9)
    for name, (low, high) in limits.items():
        for axis, x, cut in rows[name]:
            band = (style.QUANTITIES[name].factor * limit[case][cut] for limit in (low, high))
            axis.fill_between(
                x, *band, color=style.PREDICTED, alpha=0.2, lw=0, label="90 % interval"
            )
    figure.axes[0].legend(frameon=False, fontsize=9)
    return figure


def results(
    predicted: Mapping[str, Array],
    cases: Cases,
    *,
    other: Mapping[str, Array] | None = None,
    truth_label: str = "3D, averaged",
    area_case: int = -1,
    position: float = style.POSITION,
    time_point: float = style.TIME_POINT,
) -> Figure:
    """Plot many cases over time and space (figure 4 a–c).

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Variables that a model predicts, or some of them.
    cases : Cases
        The truth; the paper shows its narrowest geometry with all waveforms.
    other : mapping of str to array of shape (case, time, z), optional
        Results of the 1D solver, see
        :class:`pcnde_bridge.evaluation.baselines.Solver1D`.
    truth_label : str
        Name of the truth, for the legend.
    area_case : int
        The only case whose area is shown, because the areas hardly differ.
    position : float
        Position of the left column, as a fraction of the vessel length.
    time_point : float
        Time point of the right column, as a fraction of the cycle.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each variable, over time (left) and space (right).  Black lines in
        the area enclose the points that its error includes; numbers at the flow are waveforms.

    Raises
    ------
    InputError
        If the numbers of cases differ, or there is no such case, position or time point.
    """
    names = [name for name in FIELDS if name in predicted]
    # The prediction is drawn last, above the others.
    methods = [
        (cases.variables(), truth_label, style.TRUTH_LINE),
        (other or {}, "1D solver", style.OTHER_LINE),
        (predicted, "PCNDE", style.MODEL_LINE),
    ]
    if any(len(array) != len(cases) for arrays, *_ in methods for array in arrays.values()):
        raise InputError(f"predicted and other must have the {len(cases)} cases of the truth.")
    shown = style.locate(cases, area_case, position, time_point)
    figure, rows = style.time_and_space_figure(7.2, 2.35 * len(names) + 0.3, names, cases, *shown)
    for arrays, label, look in methods:
        one_area = {name: arrays[name][[area_case]] for name in arrays if name == "area"}
        style.plot_rows(rows, {**arrays, **one_area}, label, look)
    if "area" in rows:
        (over_time, *_), (over_space, *_) = rows["area"]
        over_time.set_title(style.case_name(cases, area_case), fontsize=8, loc="right")
        if cases.n_points > 2 * AREA_MARGIN:
            for edge in (cases.z[AREA_MARGIN], cases.z[-1 - AREA_MARGIN]):
                over_space.axvline(edge, color="black", lw=0.8)
    if "flow" in rows:
        (axis, x, cut), _ = rows["flow"]
        style.label_curves(axis, x, cases.flow[cut], cases.labels["waveform"])
    style.letter_panels(figure.axes[::2])
    style.add_legend(figure, figure.axes[0])
    return figure
