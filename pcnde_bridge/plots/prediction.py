"""Figures of predictions and the truth, over time and space."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import AREA_MARGIN
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def time_and_space(
    prediction: Prediction,
    cases: Cases,
    case: int = 0,
    position: float = 0.9,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot one case over time near the outlet, and along the vessel at its peak inflow.

    Parameters
    ----------
    prediction : Prediction
        Prediction of the cases.
    cases : Cases
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
        A row for each predicted variable, over time (left) and space (right).

    Raises
    ------
    InputError
        If prediction and cases differ in number, or there is no such case or position.
    """
    if len(prediction) != len(cases):
        raise InputError(f"There are {len(cases)} cases, but {len(prediction)} are predicted.")
    style.check_case("case", case, cases)
    predicted = {name: values[case] for name, values in prediction.variables().items()}
    truth = {name: getattr(cases, name)[case] for name in predicted}
    shown = style.z_index_at(cases, position), int(cases.inflow[case].argmax())
    size = 8, 2.4 * len(predicted)
    figure, rows = style.time_and_space_figure(*size, list(predicted), cases, *shown)
    markers = {"ls": "none", "marker": "o", "ms": 3, "mfc": "none", "color": style.TRUTH}
    style.plot_rows(rows, truth, truth_label, markers)
    style.plot_rows(rows, predicted, "PCNDE", {"ls": "-", "lw": 1.6, "color": style.PREDICTED})
    figure.axes[0].legend(frameon=False, fontsize=9)
    return figure


def results(
    predicted: Mapping[str, Array],
    cases: Cases,
    *,
    other: Mapping[str, Array] | None = None,
    truth_label: str = "3D, averaged",
    area_case: int = -1,
    position: float = 0.9,
    time_point: float = 0.25,
) -> Figure:
    """Plot many cases over time and space (figure 4 a–c).

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Flow, area and pressure that a model predicts, or some of them.
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
        the area enclose the points that its error includes.

    Raises
    ------
    InputError
        If the numbers of cases differ, or there is no such case, position or time point.
    """
    names = [name for name in VARIABLES if name in predicted]
    truth = {name: getattr(cases, name) for name in names}
    # The prediction is drawn last, above the others.
    methods = [
        (truth, truth_label, style.TRUTH_LINE),
        (other or {}, "1D solver", style.OTHER_LINE),
        (predicted, "PCNDE", style.MODEL_LINE),
    ]
    if any(len(array) != len(cases) for arrays, *_ in methods for array in arrays.values()):
        raise InputError(f"predicted and other must have the {len(cases)} cases of the truth.")
    style.check_case("area_case", area_case, cases)
    shown = style.z_index_at(cases, position), style.time_index_at(cases, time_point)
    figure, rows = style.time_and_space_figure(7.2, 2.35 * len(names) + 0.3, names, cases, *shown)
    for arrays, label, look in methods:
        one_area = {name: arrays[name][[area_case]] for name in arrays if name == "area"}
        style.plot_rows(rows, {**arrays, **one_area}, label, look)
    if "area" in rows:
        over_time, over_space = (panel.axis for panel in rows["area"])
        over_time.set_title(style.case_name(cases, area_case), fontsize=8, loc="right")
        if cases.n_points > 2 * AREA_MARGIN:
            for edge in (cases.z[AREA_MARGIN], cases.z[-1 - AREA_MARGIN]):
                over_space.axvline(edge, color="black", lw=0.8)
    style.letter_panels(figure.axes[::2])
    style.add_legend(figure, figure.axes[0])
    return figure
