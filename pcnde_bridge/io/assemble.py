"""Assembly of a data set from the results of vessels, the last step of every reader.

Units, direction of the flow, the cycle and the grid are checked here.  Ambiguous results
are rejected with the option that resolves the ambiguity; nothing is flipped, cut or
interpolated unless requested.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import as_paths
from pcnde_bridge._utils.validation import check_increasing, naming, whole
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.checks import check_arrays
from pcnde_bridge.data.labels import default_labels
from pcnde_bridge.data.plausibility import check_units, sizes_of
from pcnde_bridge.data.single_vessel import check_axes, check_vessel
from pcnde_bridge.data.units import FACTORS, QUANTITIES, in_cgs, stated_units
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.resampling import (
    check_same_grid,
    match_length,
    on_points,
    on_time_points,
    one_cycle,
)
from pcnde_bridge.io.vessel_results import VesselResults

Flip = Literal["flow", "z"]

_FLIP = (
    "If flow out of the vessel counts as positive there, pass flip='flow' (--flip flow); if the "
    "points run from the outlet to the inlet, flip='z' (--flip z)."
)

Paths = StrPath | Sequence[StrPath]
"""One path or several."""


class CaseOptions(TypedDict, total=False):
    """Options of :func:`to_cases` that every reader accepts."""

    period: float | None
    units: str | Mapping[str, str] | None
    flip: Flip | None
    time_points: int | None
    points: int | npt.ArrayLike | None
    labels: pd.DataFrame | Mapping[str, Any] | None


def to_cases(
    results: Sequence[VesselResults],
    *,
    period: float | None = None,
    units: str | Mapping[str, str] | None = None,
    flip: Flip | None = None,
    time_points: int | None = None,
    points: int | npt.ArrayLike | None = None,
    labels: pd.DataFrame | Mapping[str, Any] | None = None,
) -> Cases:
    """Check the results of vessels and assemble a data set.

    Parameters
    ----------
    results : sequence of VesselResults
        One for each case.
    period : float, optional
        Length of the cycle, s.  The last complete cycle of a longer recording is used, and
        an end point that repeats the start is left out; cycles begin at multiples of the
        period.  By default the recording is one cycle without its end point.
    units : str or mapping, optional
        ``"cgs"``, ``"mm-g-s"`` or ``"si"``, or the units that differ from CGS, such as
        ``{"pressure": "mmHg"}``.  Units that neither the caller nor the file states are
        taken to be CGS if the numbers are usual for arteries, and rejected otherwise.
    flip : {'flow', 'z'}, optional
        Change the sign of the flow, or reverse z, where the flow of the file runs against
        its z.
    time_points : int, optional
        Resample the cycle to this number of equal steps by Fourier series; unequal steps
        are interpolated by a periodic cubic spline before.
    points : int or array of shape (z,), optional
        Resample to this number of equally spaced points, or to these points (cm), by
        monotone cubic interpolation, which does not overshoot at a stenosis.
    labels : DataFrame or mapping, optional
        One row for each case, as in :class:`Cases`.  By default the labels of the files;
        without any, ``geometry`` numbers the cases.

    Returns
    -------
    Cases
        The data set in CGS units.

    Raises
    ------
    InputError
        If results are not usable or ambiguous; the message names the file and the option
        that resolves the ambiguity.
    """
    if not results:
        raise InputError("There are no results for a data set: name at least one file.")
    if flip not in (None, "flow", "z"):
        raise InputError(f"flip must be 'flow' or 'z', got {flip!r}.")
    if time_points is not None:
        time_points = whole("time_points", time_points, 4)
    stated = stated_units(units)
    vessels = []
    for given in results:
        with naming(given.name):
            check_arrays(given.as_case())
            check_increasing("time", given.time)
            vessel = _flipped(_in_cgs(given, stated), flip)
            known = {**given.units, **stated}
            check_axes(vessel.flow)
            check_units(sizes_of(**vessel.as_case()), known, unique=True, start=True)
            vessel = one_cycle(vessel, period)
            if not vessel.predicted:
                check_vessel(vessel.variables(), vessel.z, vessel.time, _FLIP)
                check_units(sizes_of(**vessel.as_case()), known)
            vessel = on_time_points(vessel, time_points)
            vessels.append(on_points(vessel, points))
    first = vessels[0]
    if points is not None and np.ndim(points) == 0:
        vessels = [match_length(vessel, first) for vessel in vessels]
    for vessel in vessels[1:]:
        check_same_grid(first, vessel)
    cases = [vessel.as_case() for vessel in vessels]
    arrays: dict[str, Any] = {
        name: np.concatenate([case[name] for case in cases]) for name in cases[0]
    }
    arrays |= {"time": first.time, "z": first.z}
    table = _labels_of(vessels) if labels is None else labels
    return Cases(**arrays, period=first.period, labels=table, check=False)


def read_vessels(
    paths: Paths, read: Callable[[Path], Iterable[VesselResults]], **options: Unpack[CaseOptions]
) -> Cases:
    """Assemble a data set from the vessels of several files.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        The files.
    read : callable
        Reads the vessels of one file; its input errors get the file's name.
    **options
        Options of :func:`to_cases`.
    """
    vessels: list[VesselResults] = []
    for path in as_paths(paths):
        with naming(path):
            vessels += read(path)
    return to_cases(vessels, **options)


def _labels_of(vessels: Sequence[VesselResults]) -> pd.DataFrame:
    """Return the labels of the files, with numbers for the keys that they lack."""
    first = vessels[0]
    for other in vessels:
        if other.labels.keys() != first.labels.keys():
            raise InputError(
                f"{first.name} has the labels {[*first.labels]}, {other.name} {[*other.labels]}: "
                "give all files the same labels, or pass labels= (--labels)."
            )
    keys = pd.DataFrame(default_labels(len(vessels)))
    labels = pd.DataFrame([dict(vessel.labels) for vessel in vessels], index=keys.index)
    return labels.join(keys[keys.columns.difference(labels.columns)])


def _in_cgs(vessel: VesselResults, stated: Mapping[str, str]) -> VesselResults:
    """Convert results to CGS from the units that the caller, or else the file, states."""
    arrays: dict[str, Any] = {
        name: in_cgs(QUANTITIES.get(name, name), values, {**vessel.units, **stated})
        for name in (*FACTORS, *QUANTITIES)
        if (values := getattr(vessel, name)) is not None
    }
    return dataclasses.replace(vessel, **arrays)


def _flipped(vessel: VesselResults, flip: Flip | None) -> VesselResults:
    if flip is None:
        return vessel
    # The sign of the flow refers to the direction of z, which may be reversed, too.
    flow, stress = vessel.flow, vessel.wall_shear_stress
    # So does that of a wall shear stress, unless it is a magnitude.
    if stress is not None and stress.mean() * flow.mean() > 0:
        stress = -stress
    vessel = dataclasses.replace(vessel, flow=-flow, wall_shear_stress=stress)
    if flip == "flow":
        return vessel
    backwards = vessel.z[0] + vessel.z[-1] - vessel.z[::-1]
    undeformed = vessel.area_undeformed[::-1]
    return vessel.change(lambda field: field[:, ::-1], area_undeformed=undeformed, z=backwards)
