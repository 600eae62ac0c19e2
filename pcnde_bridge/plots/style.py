"""Colors, units, labels and layout that all figures share.

The colors are Okabe and Ito's, which color-blind readers can tell apart; each method also
has a line style of its own, for print without colors.  Figures use mL/s, mm², mmHg and
dyn/cm² (wall shear stress), whatever the units of the arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.indices import VesselQuantities
from pcnde_bridge.data.variables import MMHG
from pcnde_bridge.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUTH, PREDICTED, OTHER, EMPIRICAL = "#D55E00", "#0072B2", "#009E73", "#000000"
"""Colors of the truth, PCNDE, another method, and an empirical formula."""

TRUTH_LINE: dict[str, Any] = {"ls": "-", "lw": 2.6, "alpha": 0.55, "color": TRUTH}
MODEL_LINE: dict[str, Any] = {"ls": "--", "lw": 1.1, "color": PREDICTED}
OTHER_LINE: dict[str, Any] = {"ls": ":", "lw": 1.4, "color": OTHER}
EMPIRICAL_LINE: dict[str, Any] = {"ls": ":", "lw": 1.4, "color": EMPIRICAL}
"""Line style of each method in panels with many curves."""

VALUE_COLORS, ERROR_COLORS = "viridis", "Blues"
"""Color maps of values and of errors; their lightness changes evenly."""

POSITION, TIME_POINT = 0.9, 0.25
"""Place and time of the paper's curves, as fractions of the length and of the cycle."""

TIME_LABEL, SPACE_LABEL = "time t (s)", "position z (cm)"
"""Axis labels."""


class Quantity(NamedTuple):
    """Name and figure unit of a variable, with the factor from CGS units."""

    name: str
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """Name and unit, for an axis."""
        return f"{self.name} ({self.unit})"


QUANTITIES = {
    "flow": Quantity("flow Q", "mL/s", 1.0),
    "area": Quantity("area S", "mm²", 100.0),
    "pressure": Quantity("pressure p", "mmHg", 1 / MMHG),
    "wall_shear_stress": Quantity("wall shear stress τ", "dyn/cm²", 1.0),
}
"""Quantity of each variable."""


def new_figure(
    width: float,
    height: float,
    rows: int = 1,
    columns: int = 1,
    grid: Literal["both", "y"] | None = "both",
    **options: Any,
) -> tuple[Figure, npt.NDArray[Any]]:
    """Create a figure with space for all labels, and the grid and tick labels of all figures.

    Parameters
    ----------
    width, height : float
        Size in inches.
    rows, columns : int
        Number of panels.
    grid : {'both', 'y'} or None
        Axes with grid lines.
    **options
        Further arguments of :meth:`matplotlib.figure.Figure.subplots`.

    Returns
    -------
    Figure, array of Axes of shape (rows, columns)
        The figure and its panels.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat:
        axis.tick_params(which="both", labelsize=8)
        if grid:
            axis.grid(axis=grid, alpha=0.3)
    return figure, axes


Panel = tuple["Axes", Array, Any]
"""Panel over time or space, its abscissa, and the index of its values in (..., time, z)."""


def time_and_space_figure(
    width: float,
    height: float,
    variables: Sequence[str],
    cases: VesselQuantities,
    z: int,
    time: int,
) -> tuple[Figure, dict[str, tuple[Panel, Panel]]]:
    """Create a figure with a row per variable, over time (left) and space (right).

    Parameters
    ----------
    width, height : float
        Size in inches.
    variables : sequence of str
        Variables of the rows.
    cases : Cases or Prediction
        Cases that are drawn; they give the titles of the columns.
    z, time : int
        Grid point of the left column, and time point of the right one.

    Returns
    -------
    Figure, dict of (Panel, Panel)
        The figure and the panels of each variable.
    """
    figure, axes = new_figure(width, height, len(variables), 2)
    axes[0, 0].set_title(f"z = {cases.z[z]:.2f} cm", fontsize=10)
    axes[0, 1].set_title(f"t = {cases.time[time]:.2f} s", fontsize=10)
    axes[-1, 0].set_xlabel(TIME_LABEL)
    axes[-1, 1].set_xlabel(SPACE_LABEL)
    rows = {}
    for (left, right), name in zip(axes, variables, strict=True):
        left.set_ylabel(QUANTITIES[name].label)
        rows[name] = (left, cases.time, np.s_[..., z]), (right, cases.z, np.s_[..., time, :])
    return figure, rows


def plot_rows(
    rows: Mapping[str, Iterable[Panel]],
    variables: Mapping[str, Array],
    label: str,
    look: Mapping[str, Any],
) -> None:
    """Plot arrays (..., time, z) of a method in the panels of their variables."""
    for name, panels in rows.items():
        if name in variables:
            values = QUANTITIES[name].factor * variables[name]
            for axis, x, cut in panels:
                plot_curves(axis, x, values[cut], label, look)


def plot_curves(axis: Axes, x: Array, curves: Array, label: str, look: Mapping[str, Any]) -> None:
    """Plot curves (..., x) of a method, with one entry in the legend."""
    lines = axis.plot(x, curves.T, **look)
    lines[0].set_label(label)


def label_curves(axis: Axes, x: Array, curves: Array, names: Iterable[Any]) -> None:
    """Write the names of curves (curve, x) where they differ most, as far as there is space."""
    at = int(np.ptp(curves, axis=0).argmax())
    space, taken = 0.045 * float(np.ptp(curves)), np.empty(0)
    for value, name in zip(curves[:, at], names, strict=True):
        if (np.abs(taken - value) >= space).all():
            taken = np.append(taken, value)
            look: dict[str, Any] = {"xytext": (4, 0), "fontsize": 7, "va": "center"}
            axis.annotate(str(name), (x[at], value), textcoords="offset points", **look)


def add_legend(figure: Figure, axis: Axes, *, below: bool = False) -> None:
    """Add the legend of one panel above or below all panels of a figure."""
    handles, labels = axis.get_legend_handles_labels()
    look: dict[str, Any] = {"frameon": False, "fontsize": 9, "handlelength": 3}
    look["loc"] = "outside lower center" if below else "outside upper center"
    figure.legend(handles, labels, ncols=len(labels), **look)


def letter_panels(axes: Iterable[Axes]) -> None:
    """Mark panels a, b, c, … outside their upper left corner."""
    for letter, axis in zip("abcdefgh", axes, strict=False):
        title = axis.get_title("left")
        axis.set_title(f"{letter})  {title}".rstrip(), loc="left", fontsize=10)


def locate(
    cases: VesselQuantities, case: int, position: float, time_point: float | None = None
) -> tuple[int, int]:
    """Return the grid point and the time point that a figure of a case shows.

    Parameters
    ----------
    cases : Cases or Prediction
        Cases that are drawn.
    case : int
        Position of the case.
    position : float
        Fraction of the vessel length.
    time_point : float, optional
        Fraction of the cycle; by default, the peak of the case's inflow.

    Raises
    ------
    InputError
        If there is no such case, or a fraction is not in [0, 1].
    """
    if not -len(cases) <= case < len(cases):
        raise InputError(f"case {case} must be one of the {len(cases)} cases.")
    z, time = cases.z - cases.z[0], cases.time - cases.time[0]
    for name, fraction in (("position", position), ("time_point", time_point or 0.0)):
        if not 0 <= fraction <= 1:
            raise InputError(f"{name} must be a fraction from 0 to 1, got {fraction!r}.")
    z_index = int(np.abs(z - position * z[-1]).argmin())
    if time_point is None:
        return z_index, int(cases.flow[case, :, 0].argmax())
    return z_index, int(np.abs(time - time_point * cases.period).argmin())


def case_name(cases: Cases, case: int) -> str:
    """Describe a case by its blockage, if known, and its labels."""
    geometry, waveform, blockage = (
        cases.labels[name].iloc[case] for name in ("geometry", "waveform", "blockage")
    )
    known = "" if np.isnan(blockage) else f"{100 * blockage:.0f} % blockage, "
    return f"{known}geometry {geometry}, waveform {waveform}"
