"""Colors, units, labels and layout that all figures share.

The colors are Okabe and Ito's, which color-blind readers can tell apart; each method also
has a line style of its own, for print without colors.  Figures use mL/s, mm² and mmHg,
whatever the units of the arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
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

    def convert(self, values: Array) -> Array:
        """Convert values from CGS units to the figure unit."""
        return values * self.factor


QUANTITIES = {
    "flow": Quantity("flow Q", "mL/s", 1.0),
    "area": Quantity("area S", "mm²", 100.0),
    "pressure": Quantity("pressure p", "mmHg", 1 / MMHG),
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


class Panel(NamedTuple):
    """Panel of one variable, over time or space.

    Attributes
    ----------
    axis : Axes
        The panel.
    x : array of shape (time,) or (z,)
        Time points or points.
    cut : tuple
        Index that takes the values at x from an array of shape (..., time, z).
    """

    axis: Axes
    x: Array
    cut: Any


def time_and_space_figure(
    width: float, height: float, variables: Sequence[str], cases: Cases, z: int, time: int
) -> tuple[Figure, dict[str, tuple[Panel, Panel]]]:
    """Create a figure with a row per variable, over time (left) and space (right).

    Parameters
    ----------
    width, height : float
        Size in inches.
    variables : sequence of str
        Variables of the rows.
    cases : Cases
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
        over_time = Panel(left, cases.time, np.s_[..., z])
        rows[name] = over_time, Panel(right, cases.z, np.s_[..., time, :])
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
            values = QUANTITIES[name].convert(variables[name])
            for axis, x, cut in panels:
                plot_curves(axis, x, values[cut], label, look)


def plot_curves(axis: Axes, x: Array, curves: Array, label: str, look: Mapping[str, Any]) -> None:
    """Plot curves (..., x) of a method, with one entry in the legend."""
    lines = axis.plot(x, curves.T, **look)
    lines[0].set_label(label)


def add_legend(
    figure: Figure,
    axis: Axes,
    loc: Literal["outside upper center", "outside lower center"] = "outside upper center",
) -> None:
    """Add the legend of one panel outside all panels of a figure."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc=loc, ncols=len(labels), frameon=False, fontsize=9, handlelength=3
    )


def letter_panels(axes: Iterable[Axes]) -> None:
    """Mark panels a, b, c, … outside their upper left corner."""
    for letter, axis in zip("abcdefgh", axes, strict=False):
        title = axis.get_title("left")
        axis.set_title(f"{letter})  {title}".rstrip(), loc="left", fontsize=10)


def z_index_at(cases: Cases, position: float) -> int:
    """Return the grid point at a fraction of the vessel length.

    Raises
    ------
    InputError
        If the fraction is not in [0, 1].
    """
    length = cases.z[-1] - cases.z[0]
    return _nearest("position", position, "vessel length", cases.z, length)


def time_index_at(cases: Cases, time_point: float) -> int:
    """Return the time point at a fraction of the cycle.

    Raises
    ------
    InputError
        If the fraction is not in [0, 1].
    """
    return _nearest("time_point", time_point, "cycle", cases.time, cases.period)


def _nearest(name: str, fraction: float, whole: str, x: Array, length: float) -> int:
    """Return the index of the value of x at a fraction of the length from its start."""
    if not 0 <= fraction <= 1:
        raise InputError(
            f"{name} must be a fraction of the {whole}, from 0 to 1, got {fraction!r}."
        )
    return int(np.abs(x - x[0] - fraction * length).argmin())


def check_case(name: str, case: int, cases: Cases) -> None:
    """Raise InputError if there is no case with this position."""
    if not -len(cases) <= case < len(cases):
        raise InputError(f"{name} {case} must be one of the {len(cases)} cases.")


def case_name(cases: Cases, case: int) -> str:
    """Describe a case by its blockage, if known, and its labels."""
    geometry, waveform, blockage = (
        cases.labels[name].iloc[case] for name in ("geometry", "waveform", "blockage")
    )
    known = "" if np.isnan(blockage) else f"{100 * blockage:.0f} % blockage, "
    return f"{known}geometry {geometry}, waveform {waveform}"
