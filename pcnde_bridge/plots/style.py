"""What all figures share: colours, units, names of cases.

Colours are Okabe and Ito's, which colour-blind readers tell apart; each method has a
line style of its own too, for print without colours.  Figures use mL/s, mm² and mmHg,
whatever the arrays are in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUTH, PREDICTED, OTHER, EMPIRICAL = "#D55E00", "#0072B2", "#009E73", "#000000"
"""Truth, PCNDE, another method, an empirical formula."""

CURVES: dict[str, dict[str, Any]] = {
    "truth": {"ls": "-", "lw": 2.6, "alpha": 0.55, "color": TRUTH},
    "model": {"ls": "--", "lw": 1.1, "color": PREDICTED},
    "other": {"ls": ":", "lw": 1.4, "color": OTHER},
    "empirical": {"ls": ":", "lw": 1.4, "color": EMPIRICAL},
}
"""How a method's lines look where there are many of them."""

VALUES, ERRORS = "viridis", "Blues"
"""Colour maps of values and of errors; their lightness changes evenly."""

MMHG = 1333.22
"""dyn/cm² in a mmHg."""

QUANTITIES = {
    "flow": ("flow Q", "mL/s", 1.0),
    "area": ("area S", "mm²", 100.0),
    "pressure": ("pressure p", "mmHg", 1 / MMHG),
}
"""Name, unit, and factor from CGS units, of each variable."""

TIME, SPACE = "time t (s)", "position z (cm)"
"""Labels of the axes."""


def label(variable: str) -> str:
    """Name and unit of a variable, for an axis."""
    name, unit, _ = QUANTITIES[variable]
    return f"{name} ({unit})"


def shown(variable: str, values: Array) -> Array:
    """Values of a variable in the figures' unit."""
    return values * QUANTITIES[variable][2]


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, npt.NDArray[Any]]:
    """Figure (inches) that leaves room for all labels, and its axes, (rows, columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def bundle(axis: Axes, x: Array, rows: Array, look: str, name: str) -> None:
    """Draw the rows (line, x) of a method, with one entry in the legend."""
    lines = axis.plot(x, rows.T, **CURVES[look])
    lines[0].set_label(name)


def legend_above(figure: Figure, axis: Axes) -> None:
    """Legend of one panel above the whole figure."""
    handles, names = axis.get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside upper center",
        ncols=len(names),
        frameon=False,
        fontsize=9,
        handlelength=3,
    )


def headings(axes: npt.NDArray[Any], cases: Cases, z_index: int, t_index: int) -> None:
    """Place and instant above two columns of panels, quantities of their axes below."""
    axes[0, 0].set_title(f"z = {cases.z[z_index]:.2f} cm", fontsize=10)
    axes[0, 1].set_title(f"t = {cases.time[t_index]:.2f} s", fontsize=10)
    axes[-1, 0].set_xlabel(TIME)
    axes[-1, 1].set_xlabel(SPACE)


def letters(axes: npt.NDArray[Any]) -> None:
    """Mark panels a, b, c, … at their upper left, outside."""
    for number, axis in enumerate(axes):
        title = axis.get_title("left")
        mark = chr(ord("a") + number)
        axis.set_title(f"{mark})  {title}" if title else f"{mark})", loc="left", fontsize=10)


def plain(axis: Axes) -> None:
    """Grid and tick labels alike in all figures."""
    axis.grid(alpha=0.3)
    axis.tick_params(which="both", labelsize=8)


def nearest(values: Array, wanted: float) -> int:
    """Index of the value nearest to the wanted one."""
    return int(np.abs(values - wanted).argmin())


def place(cases: Cases, part: float) -> int:
    """Index of the point at a part of the vessel's length, 0 to 1.

    Raises
    ------
    InputError
        If the part is not in the vessel.
    """
    if not 0 <= part <= 1:
        raise InputError(f"position must be a part of the length, from 0 to 1, got {part!r}.")
    return nearest(cases.z, cases.z[0] + part * (cases.z[-1] - cases.z[0]))


def moment(cases: Cases, part: float) -> int:
    """Index of the instant at a part of the cycle, 0 to 1.

    Raises
    ------
    InputError
        If the part is not in the cycle.
    """
    if not 0 <= part <= 1:
        raise InputError(f"instant must be a part of the cycle, from 0 to 1, got {part!r}.")
    return nearest(cases.time, cases.time[0] + part * cases.period)


def case_name(cases: Cases, case: int) -> str:
    """Name a case: its blockage, if known, and its labels."""
    geometry, waveform, blockage = (
        cases.labels[name].iloc[case] for name in ("geometry", "waveform", "blockage")
    )
    known = "" if np.isnan(blockage) else f"{100 * blockage:.0f} % blockage, "
    return f"{known}geometry {geometry}, waveform {waveform}"
