"""Results of one vessel as another program wrote them, and their way into a data set.

Every reader of this folder parses files into :class:`VesselResults`, and
:func:`to_cases` does the rest for all of them: units, direction of the flow, one whole
cycle, one grid.  What is doubtful is refused with the option that settles it; nothing
is flipped, cut or interpolated unasked.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.resampling import (
    check_grid,
    of_length,
    on_instants,
    on_points,
    one_cycle,
)
from pcnde_bridge.io.tables import read_labelled
from pcnde_bridge.io.units import (
    SYSTEMS,
    check_units,
    in_cgs,
    stated_units,
)

Flip = Literal["flow", "z"]


class CaseOptions(TypedDict, total=False):
    """The options of :func:`to_cases` that every reader passes on."""

    period: float | None
    units: str | Mapping[str, str] | None
    flip: Flip | None
    instants: int | None
    points: int | npt.ArrayLike | None
    labels: pd.DataFrame | Mapping[str, Any] | None


@dataclass(frozen=True)
class VesselResults:
    """What a file says of one vessel, in its own units, at its own instants and points.

    Attributes
    ----------
    name : str
        The file, for messages.
    flow, area, pressure : array of shape (time, z)
        Averages over the cross-sections.
    area_undeformed : array of shape (z,)
        S_u.
    time, z : array
        Instants; distances along the vessel from its inlet.
    labels : mapping
        Labels that the file holds.
    units : mapping of str to str
        Units that the file states, by ``flow``, ``area``, ``pressure``, ``z``, ``time``.
    period : float or None
        Of the cycle, if the file says.
    """

    name: str
    flow: Array
    area: Array
    pressure: Array
    area_undeformed: Array
    time: Array
    z: Array
    labels: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    period: float | None = None


def to_cases(
    results: Sequence[VesselResults],
    *,
    period: float | None = None,
    units: str | Mapping[str, str] | None = None,
    flip: Flip | None = None,
    instants: int | None = None,
    points: int | npt.ArrayLike | None = None,
    labels: pd.DataFrame | Mapping[str, Any] | None = None,
) -> Cases:
    """Check the results of some vessels and make a data set of them.

    Parameters
    ----------
    results : sequence of VesselResults
        One for each case.
    period : float, optional
        Length of the cycle (s).  Of a longer recording its last whole cycle is taken,
        and an end point that repeats the start is left out; the cycles begin at
        multiples of the period.  By default the recording is one cycle, without its
        end point.
    units : str or mapping, optional
        ``"cgs"``, ``"mm-g-s"`` or ``"si"``, or the units that differ from CGS, such as
        ``{"pressure": "mmHg"}``.  Units that neither you nor the file state are taken
        to be CGS, if the numbers are usual ones of arteries; else they are refused.
    flip : {'flow', 'z'}, optional
        Change the sign of the flow, or let z begin at the other end, where the flow of
        the file runs against its z.
    instants : int, optional
        Resample the cycle to so many equal steps: Fourier series; first, between
        instants of unequal steps, a periodic cubic spline.
    points : int or array of shape (z,), optional
        Resample to so many equally spaced points, or to these (cm): monotone cubic
        interpolation, which overshoots neither at a stenosis nor below zero.
    labels : DataFrame or mapping, optional
        One row for each case, as :class:`Cases` takes them.  By default those of the
        files; else ``geometry`` counts the cases.

    Returns
    -------
    Cases
        In CGS units.

    Raises
    ------
    InputError
        Naming the file, what is doubtful in it, and the option that settles it.
    """
    if not results:
        raise InputError("There are no results to make a data set of: name at least one file.")
    if flip not in (None, "flow", "z"):
        raise InputError(f"flip must be 'flow' or 'z', got {flip!r}.")
    if instants is not None:
        instants = whole("instants", instants, 4)
    stated = stated_units(units)
    known = set(SYSTEMS["cgs"]) if isinstance(units, str) else set(stated)
    vessels = []
    for given in results:
        _check(given)
        vessel = _flipped(in_cgs(given, stated), flip)
        check_units(vessel, known | set(given.units))
        _check_direction(vessel)
        vessels.append(on_points(on_instants(one_cycle(vessel, period), instants), points))
    first = vessels[0]
    if points is not None and np.ndim(points) == 0:
        vessels = [of_length(vessel, first) for vessel in vessels]
    for vessel in vessels[1:]:
        check_grid(first, vessel)
    if labels is None:
        for vessel in vessels[1:]:
            _check_columns(first, vessel)
        labels = _with_keys(pd.DataFrame([dict(v.labels) for v in vessels]))
    stacked = {name: np.stack([getattr(v, name) for v in vessels]) for name in VARIABLES}
    return Cases(
        **stacked,
        area_undeformed=np.stack([vessel.area_undeformed for vessel in vessels]),
        time=first.time,
        z=first.z,
        period=first.period,
        labels=labels,
    )


def _check_columns(first: VesselResults, other: VesselResults) -> None:
    """Refuse labels of which a part would be lost."""
    one, another = sorted(first.labels), sorted(other.labels)
    if one != another:
        raise InputError(
            f"{first.name} has the labels {one}, but {other.name} {another}: give all files the "
            "same, or say what they are, labels= (--labels)."
        )


def read_labels(
    path: str | os.PathLike[str], files: Sequence[str | os.PathLike[str]]
) -> pd.DataFrame:
    """Read the labels of files from a CSV table, in the order of the files.

    Parameters
    ----------
    path : path-like
        Table with the columns ``file``, ``geometry``, ``waveform`` and any others; one
        row for each file, named as in ``files`` or without its folder.
    files : sequence of path-like
        The files.

    Returns
    -------
    DataFrame
        The labels, without the column ``file``.

    Raises
    ------
    FileError
        If the table cannot be read.
    InputError
        If a file has no row, or two.
    """
    [table] = read_labelled([path], ("geometry", "waveform", "blockage"))
    if "file" not in table:
        raise InputError(f"{path} lacks the column 'file'; it has {list(table.columns)}.")
    rows = []
    for file in files:
        found = np.flatnonzero(table["file"].map(str).isin([str(file), Path(file).name]))
        if found.size != 1:
            raise InputError(f"{path} has {found.size} rows for {file}; it needs one.")
        rows.append(int(found[0]))
    return table.iloc[rows].drop(columns="file").reset_index(drop=True)


def _with_keys(labels: pd.DataFrame) -> pd.DataFrame:
    """Add the columns that name a case, where the files have none."""
    for name, values in (("geometry", np.arange(len(labels))), ("waveform", 0)):
        if name not in labels:
            labels[name] = values
    return labels


# ---- what the arrays hold ------------------------------------------------


def _check(vessel: VesselResults) -> None:
    n_times, n_points = vessel.time.size, vessel.z.size
    if n_times < 4 or n_points < 3:
        raise InputError(
            f"{vessel.name} has {n_times} instants and {n_points} points; at least 4 and 3 are "
            "needed."
        )
    expected: dict[str, tuple[int, ...]] = dict.fromkeys(VARIABLES, (n_times, n_points))
    expected["area_undeformed"] = (n_points,)
    for name, shape in expected.items():
        array = getattr(vessel, name)
        if array.shape != shape:
            swapped = "; it looks transposed" if array.shape == shape[::-1] else ""
            raise InputError(
                f"{vessel.name}: {name} has the shape {array.shape}, but time and z make "
                f"{shape}{swapped}."
            )
    for name in (*VARIABLES, "area_undeformed", "time", "z"):
        array = getattr(vessel, name)
        bad = ~np.isfinite(array)
        rule = "is not finite"
        if "area" in name and not bad.any():
            bad, rule = array <= 0, "is not positive"
        if bad.any():
            at = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(
                f"{vessel.name}: {name}{list(at)} is {array[at]:g}, which {rule} "
                f"({np.count_nonzero(bad)} such values)."
            )
    for name in ("time", "z"):
        axis = getattr(vessel, name)
        if (np.diff(axis) <= 0).any():
            index = int(np.argmax(np.diff(axis) <= 0)) + 1
            raise InputError(
                f"{vessel.name}: {name}[{index}] = {axis[index]:g} is not larger than "
                "the one before it; sort the results, and leave out what is there twice."
            )


# ---- direction of the flow -----------------------------------------------


def _flipped(vessel: VesselResults, flip: Flip | None) -> VesselResults:
    if flip == "flow":
        return dataclasses.replace(vessel, flow=-vessel.flow)
    if flip == "z":
        # The flow's sign is that of the file's own direction, which turns too.
        arrays: dict[str, Any] = {name: getattr(vessel, name)[:, ::-1] for name in VARIABLES}
        arrays |= {"flow": -arrays["flow"], "area_undeformed": vessel.area_undeformed[::-1]}
        arrays["z"] = vessel.z[0] + vessel.z[-1] - vessel.z[::-1]
        return dataclasses.replace(vessel, **arrays)
    return vessel


def _check_direction(vessel: VesselResults) -> None:
    mean = vessel.flow.mean(axis=0)
    scale = np.abs(vessel.flow).max()
    inlet, outlet = mean[0], mean[-1]
    if inlet < -1e-3 * scale:
        raise InputError(
            f"{vessel.name}: the flow runs against z, its mean is {inlet:.4g} mL/s at the first "
            "point. If flow out of the vessel counts as positive there, pass flip='flow' "
            "(--flip flow); if the points run from the outlet to the inlet, flip='z' (--flip z)."
        )
    if inlet > 1e-3 * scale and outlet < -1e-3 * scale:
        raise InputError(
            f"{vessel.name}: the mean flow is {inlet:.4g} mL/s at the first point and {outlet:.4g} "
            "at the last: the sign changes on the way. Give flow along z the same sign at all "
            "points."
        )
