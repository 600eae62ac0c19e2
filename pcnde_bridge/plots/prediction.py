"""Figures of predictions beside the truth, over time and space."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import AREA_MARGIN
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots.style import (
    PREDICTED,
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


def time_and_space(
    prediction: Prediction,
    cases: Cases,
    case: int = 0,
    position: float = 0.9,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot one case over time near the outlet, and along the vessel at the peak of its inflow.

    Parameters
    ----------
    prediction : Prediction
        Of the cases.
    cases : Cases
        The truth.
    case : int
        Which case.
    position : float
        Where the left column is taken, as a part of the vessel's length; the
        paper's figures take 0.9.
    truth_label : str
        What the cases are, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each predicted variable, over time (left) and space (right).

    Raises
    ------
    InputError
        If prediction and cases differ in their number, or there is no such case.
    """
    if len(prediction) != len(cases) or not -len(cases) <= case < len(cases):
        raise InputError(
            f"case {case} must be one of the {len(cases)} cases, of which {len(prediction)} are "
            "predicted."
        )
    variables = prediction.variables()
    z_index, t_index = place(cases, position), int(cases.inflow[case].argmax())
    figure, axes = new_figure(8, 2.4 * len(variables), len(variables), 2)
    for (over_time, over_space), (name, values) in zip(axes, variables.items(), strict=True):
        truth = shown(name, getattr(cases, name)[case])
        predicted = shown(name, values[case])
        for axis, x, rows in (
            (over_time, cases.time, (truth[:, z_index], predicted[:, z_index])),
            (over_space, cases.z, (truth[t_index], predicted[t_index])),
        ):
            axis.plot(x, rows[0], "o", ms=3, mfc="none", color=TRUTH, label=truth_label)
            axis.plot(x, rows[1], "-", lw=1.6, color=PREDICTED, label="PCNDE")
            plain(axis)
        over_time.set_ylabel(label(name))
    headings(axes, cases, z_index, t_index)
    axes[0, 0].legend(frameon=False, fontsize=9)
    return figure


def results(
    predicted: Mapping[str, Array],
    cases: Cases,
    *,
    other: Mapping[str, Array] | None = None,
    other_label: str = "1D solver",
    truth_label: str = "3D, averaged",
    area_case: int = -1,
    position: float = 0.9,
    instant: float = 0.25,
) -> Figure:
    """Plot many cases over time and space: figure 4 a–c of the paper.

    Parameters
    ----------
    predicted : mapping of str to array of shape (case, time, z)
        Flow, area and pressure, or some of them, of a model.
    cases : Cases
        The truth; the paper shows its narrowest geometry under all waveforms.
    other : mapping of str to array of shape (case, time, z), optional
        Of another method, such as :class:`pcnde_bridge.evaluation.baselines.Solver1D`.
    other_label, truth_label : str
        What the other method and the cases are, for the legend.
    area_case : int
        The only case whose area is shown, as the areas hardly differ.
    position : float
        Where the left column is taken, as a part of the vessel's length.
    instant : float
        When the right column is taken, as a part of the cycle.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each variable, over time (left) and space (right).  Black lines in
        the area enclose the points that its error counts.

    Raises
    ------
    InputError
        If the numbers of cases differ, or there is no such case, place or instant.
    """
    of_all = [predicted, *([] if other is None else [other])]
    if any(len(values) != len(cases) for arrays in of_all for values in arrays.values()):
        raise InputError(f"The predictions are not of the {len(cases)} cases of the truth.")
    if not -len(cases) <= area_case < len(cases):
        raise InputError(f"area_case is {area_case}; there are {len(cases)} cases.")
    names = [name for name in VARIABLES if name in predicted]
    z_index, t_index = place(cases, position), moment(cases, instant)
    truth = {name: getattr(cases, name) for name in names}
    # The prediction is drawn last, above the others.
    methods = [(truth, "truth", truth_label)]
    methods += [] if other is None else [(dict(other), "other", other_label)]
    methods += [(dict(predicted), "model", "PCNDE")]
    figure, axes = new_figure(7.2, 2.35 * len(names) + 0.3, len(names), 2)
    for (over_time, over_space), name in zip(axes, names, strict=True):
        chosen = [area_case % len(cases)] if name == "area" else list(range(len(cases)))
        for arrays, look, text in methods:
            if name in arrays:
                values = shown(name, arrays[name][chosen])
                bundle(over_time, cases.time, values[:, :, z_index], look, text)
                bundle(over_space, cases.z, values[:, t_index], look, text)
        over_time.set_ylabel(label(name))
        plain(over_time)
        plain(over_space)
        if name == "area":
            over_time.set_title(case_name(cases, chosen[0]), fontsize=8, loc="right")
            if cases.n_points > 2 * AREA_MARGIN:
                for edge in (cases.z[AREA_MARGIN], cases.z[-1 - AREA_MARGIN]):
                    over_space.axvline(edge, color="black", lw=0.8)
    letters(axes[:, 0])
    headings(axes, cases, z_index, t_index)
    legend_above(figure, axes[0, 0])
    return figure
