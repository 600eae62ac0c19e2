"""Figures of predictions beside the truth.

Colours are Okabe and Ito's, which colour-blind readers tell apart.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcnde_bridge.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.prediction import Prediction

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

TRUTH, PREDICTED = "#D55E00", "#0072B2"

_STAGE_UNITS = {
    "flow": ("flow", "mL²/s²"),
    "intermediate_area": ("intermediate area", "cm⁴"),
    "fourier_area": ("Fourier area", "cm⁴"),
    "temporal_pressure": ("temporal pressure", "p_ref²"),
    "spatial_pressure": ("spatial pressure", "p_ref²"),
}

LABELS: dict[str, tuple[str, float]] = {
    "flow": ("flow Q (mL/s)", 1.0),
    "area": ("area S (mm²)", 100.0),
    "pressure": ("pressure p (mmHg)", 1 / 1333.22),
}
"""Axis title of each variable, and the factor from CGS to its unit."""


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
    from matplotlib.figure import Figure

    if len(prediction) != len(cases) or not -len(cases) <= case < len(cases):
        raise InputError(
            f"case {case} must be one of the {len(cases)} cases, of which {len(prediction)} are "
            "predicted."
        )
    variables = prediction.variables()
    z_index = int(np.abs(cases.z - cases.z[0] - position * (cases.z[-1] - cases.z[0])).argmin())
    t_index = int(cases.inflow[case].argmax())
    figure = Figure(figsize=(8, 2.4 * len(variables)), layout="constrained")
    axes = figure.subplots(len(variables), 2, squeeze=False)
    for (over_time, over_space), (name, values) in zip(axes, variables.items(), strict=True):
        label, factor = LABELS[name]
        truth = getattr(cases, name)[case] * factor
        predicted = values[case] * factor
        for axis, x, rows in (
            (over_time, cases.time, (truth[:, z_index], predicted[:, z_index])),
            (over_space, cases.z, (truth[t_index], predicted[t_index])),
        ):
            axis.plot(x, rows[0], "o", ms=3, mfc="none", color=TRUTH, label=truth_label)
            axis.plot(x, rows[1], "-", lw=1.6, color=PREDICTED, label="PCNDE")
            axis.grid(alpha=0.3)
        over_time.set_ylabel(label)
    axes[0, 0].set_title(f"z = {cases.z[z_index]:.1f} cm", fontsize=10)
    axes[0, 1].set_title(f"t = {cases.time[t_index]:.2f} s", fontsize=10)
    axes[-1, 0].set_xlabel("time t (s)")
    axes[-1, 1].set_xlabel("position z (cm)")
    axes[0, 0].legend(frameon=False, fontsize=9)
    return figure


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
        batch show every iteration as a pale dot, and the mean over the batches of
        each epoch as a line.

    Raises
    ------
    InputError
        If the history is empty.
    """
    from matplotlib.figure import Figure

    stages = [stage for stage in _STAGE_UNITS if (history["stage"] == stage).any()]
    if not stages:
        raise InputError("There is no history to plot: the model was not fitted here.")
    figure = Figure(figsize=(9.5, 2.6 * -(-len(stages) // 3)), layout="constrained")
    axes = figure.subplots(-(-len(stages) // 3), 3, squeeze=False).ravel()
    for spare in axes[len(stages) :]:
        spare.set_axis_off()
    for axis, stage in zip(axes, stages, strict=False):
        rows = history[history["stage"] == stage]
        name, unit = _STAGE_UNITS[stage]
        number = np.arange(1, len(rows) + 1)
        loss = rows["loss"].to_numpy()
        if rows["batch"].nunique() == 1:
            axis.plot(number, loss, "-", lw=1.6, color=PREDICTED)
        else:
            axis.plot(number, loss, ".", ms=4, alpha=0.4, mec="none", color=PREDICTED)
            # Each batch's last loss in each epoch, in the mean.
            ends = rows.assign(number=number).groupby(["epoch", "batch"], sort=False).last()
            means = ends.groupby("epoch")[["number", "loss"]].agg({"number": "max", "loss": "mean"})
            axis.plot(means["number"], means["loss"], "-", lw=1.6, color=TRUTH)
        if (loss > 0).all() and loss.max() > 10 * loss.min():
            axis.set_yscale("log")
        axis.set_title(name, fontsize=10)
        axis.set_xlabel("iteration")
        axis.set_ylabel(f"loss ({unit})")
        axis.grid(alpha=0.3)
    return figure
