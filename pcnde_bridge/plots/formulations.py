"""Figures of the studies of formulations and loss landscapes.

Colours are Okabe and Ito's, which colour-blind readers tell apart.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pcnde_bridge.errors import InputError
from pcnde_bridge.plots.style import (
    OTHER,
    PREDICTED,
    SPACE,
    TIME,
    TRUTH,
    label,
    new_figure,
    place,
    plain,
)
from pcnde_bridge.studies.formulations import FormulationStudy
from pcnde_bridge.studies.landscapes import LandscapeStudy, Moment

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STYLES = {
    "truth": (TRUTH, "o", ""),  # the caller names it
    "spatial": (PREDICTED, "-", "in space, $f(Q, S)$"),
    "temporal": (OTHER, "-", "in time, $f(Q)$"),
    "temporal_with_time": ("#CC79A7", "--", "in time, $f(Q, t)$"),
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


def smoothness(
    study: FormulationStudy,
    part: str = "train",
    case: int = 0,
    position: float = 0.9,
    *,
    truth_label: str = "3D, averaged",
) -> Figure:
    """Plot flow, its slope and the area from continuity, in space and in time.

    Parameters
    ----------
    study : FormulationStudy
        Of :func:`pcnde_bridge.studies.compare_formulations`.
    part : {'train', 'test'}
        Which cases.
    case : int
        Which of them.
    position : float
        Where the lower row is taken, as a part of the vessel's length.
    truth_label : str
        What the cases are.

    Returns
    -------
    matplotlib.figure.Figure
        Above along the vessel at the peak of the inflow, below over time.

    Raises
    ------
    InputError
        If there is no such case, or the position is not in the vessel.
    """
    if part not in study.cases or not -len(study.cases[part]) <= case < len(study.cases[part]):
        raise InputError(f"The study has no case {case} of the set {part!r}.")
    cases = study.cases[part]
    z_index = place(cases, position)
    t_index = int(cases.inflow[case].argmax())
    figure, axes = new_figure(10, 5.4, 2, 3)
    names = [name for name, which in study.results if which == part]
    for name in names:
        found = study.results[name, part]
        colour, style, words = _STYLES[name]
        # The truth of the area is the data's, not what continuity makes of the true flow.
        area = cases.area if name == "truth" else found.continuity_area
        for column, values in enumerate((found.flow, found.slope, 100 * area)):
            over: dict[str, Any] = {"color": colour, "label": words or truth_label, "lw": 1.5}
            over |= {"ms": 2.5, "mfc": "none", "mew": 0.6} if name == "truth" else {}
            axes[0, column].plot(cases.z, values[case, t_index], style, **over)
            axes[1, column].plot(cases.time, values[case, :, z_index], style, **over)
    titles = (label("flow"), "slope ∂Q/∂z (mL/s/cm)", "area S from continuity (mm²)")
    for column, title in enumerate(titles):
        axes[0, column].set_title(title, fontsize=10)
        axes[0, column].set_xlabel(SPACE)
        axes[1, column].set_xlabel(TIME)
    for axis in axes.ravel():
        plain(axis)
    axes[0, 0].set_ylabel(f"t = {cases.time[t_index]:.2f} s")
    axes[1, 0].set_ylabel(f"z = {cases.z[z_index]:.1f} cm")
    handles, texts = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower center", ncols=len(names), frameon=False)
    return figure


def landscapes(study: LandscapeStudy) -> Figure:
    """Plot the loss over the two amplitudes, for every right-hand side and both moments.

    Parameters
    ----------
    study : LandscapeStudy
        Of :func:`pcnde_bridge.studies.explore_landscapes`.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each right-hand side; each panel has its own, logarithmic scale of
        colours, grey is where the equation diverges, and the cross is the trained network.
    """
    names = list(study.outcomes)
    width = 2.9 * len(names) + 0.4
    figure, axes = new_figure(width, 5.6, len(_MOMENTS), len(names), sharex=True, sharey=True)
    for (moment, when), row in zip(_MOMENTS.items(), axes, strict=True):
        for name, axis in zip(names, row, strict=True):
            _panel(figure, axis, study, name, moment)
        row[0].set_ylabel(f"{when}\n" + r"amplitude $\alpha_2$")
    for name, axis in zip(names, axes[0], strict=True):
        axis.set_title(_EQUATIONS.get(name, name), fontsize=12, pad=12)
    for axis in axes[-1]:
        axis.set_xlabel(r"amplitude $\alpha_1$")
    return figure


def _panel(figure: Figure, axis: Axes, study: LandscapeStudy, name: str, moment: Moment) -> None:
    """One landscape, or why there is none."""
    from matplotlib.colors import LogNorm

    axis.set_facecolor("0.8")
    axis.set_box_aspect(1)
    landscape = study.landscape(name, moment)
    if landscape is None or landscape.diverged.all():
        words = "diverges at all points" if landscape is not None else study.outcomes[name]
        for before, after in ((" at ", "\nat "), (" after ", "\nafter "), (", ", ",\n")):
            words = words.replace(before, after)
        axis.text(0.5, 0.5, words, ha="center", va="center", transform=axis.transAxes, fontsize=9)
        return
    finite = landscape.losses[~landscape.diverged]
    # pcolormesh has columns along x: α₁ is the first index.
    mesh = axis.pcolormesh(
        landscape.amplitudes,
        landscape.amplitudes,
        np.ma.masked_where(landscape.diverged, landscape.losses).T,
        norm=LogNorm(finite.min(), max(finite.max(), 1.001 * finite.min())),
        cmap="cividis",
        shading="nearest",
    )
    if not landscape.diverged.any():
        axis.contour(
            landscape.amplitudes,
            landscape.amplitudes,
            landscape.losses.T,
            levels=np.geomspace(finite.min(), finite.max(), 9)[1:-1].tolist(),
            colors="white",
            linewidths=0.6,
        )
    axis.plot(0, 0, "+", ms=9, color=TRUTH)
    figure.colorbar(mesh, ax=axis, shrink=0.75, label="loss (mL²/s²)")
