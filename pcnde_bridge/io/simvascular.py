"""Centerline results of SimVascular: ``.vtp`` files with arrays for each time step.

svSlicer and SimVascular's own tools average 3D results over the cross-sections and write
them onto the centerline as point arrays ``pressure_00500`` and ``velocity_00500`` (which
holds the flow) or ``flow_00500``, named by the number of the time step.  SimVascular's
reduced-order simulations write ``pressure_0.5``, ``flow_0.5`` and ``area_0.5``, named by
the time in s.  ``Path`` is the distance along each branch, ``BranchId`` the branch (-1
within a junction), ``CenterlineSectionArea`` the area of the cross-section of the mesh.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, IntArray
from pcnde_bridge._utils.files import as_paths
from pcnde_bridge._utils.validation import naming, positive
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, to_cases
from pcnde_bridge.io.centerlines import LABEL_PREFIX, WRITER
from pcnde_bridge.io.vessel_results import VesselResults
from pcnde_bridge.io.vtp import Lines, read_lines

_STEP = re.compile(
    r"(pressure|velocity|flow|area)_(\d+|\d*\.?\d+(?:[eE][-+]?\d+)?|\d+\.)", re.IGNORECASE
)
_UNDEFORMED = ("area_undeformed", "CenterlineSectionArea", "area")

_Positions = npt.NDArray[np.intp]


def read_simvascular(
    paths: Paths,
    *,
    time_step: float | None = None,
    branch: int | None = None,
    rigid: bool = False,
    **options: Unpack[CaseOptions],
) -> Cases:
    """Read centerline results of SimVascular.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        ``.vtp`` files, one for each case.
    time_step : float, optional
        Time step of the 3D simulation, s; needed where arrays are named by the number of
        the time step.
    branch : int, optional
        ``BranchId`` of the vessel, where the file has several.
    rigid : bool
        Accept files without an area for each time step: the walls were rigid, and the area
        of the mesh is used at all times.
    **options
        ``period``, ``units``, ``flip``, ``time_points``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.to_cases`.

    Returns
    -------
    Cases
        Distances z start at the first point of the branch and follow ``Path`` or, without
        it, the lines of the file.  The undeformed area is the array ``area_undeformed``,
        or else ``CenterlineSectionArea``, or ``area``.

    Raises
    ------
    DataNotFoundError
        If a file does not exist.
    FileError
        If a file is damaged or not ``.vtp``.
    InputError
        If arrays are missing, or units, flow or time steps are ambiguous.
    """
    vessels = []
    for path in as_paths(paths):
        with naming(path):
            centerline = _Centerline(read_lines(path), branch)
            vessels.append(centerline.results(str(path), time_step, rigid))
    return to_cases(vessels, **options)


class _Centerline:
    """One vessel of a centerline file."""

    def __init__(self, lines: Lines, branch: int | None) -> None:
        self._points, self._lines, self._arrays, self._facts = lines
        self._has_path = "Path" in self._arrays and self._arrays["Path"].ndim == 1
        self._chosen = self._ordered_points(branch)

    def results(self, name: str, time_step: float | None, rigid: bool) -> VesselResults:
        """Return the results of the vessel, in the order of time and from its inlet on."""
        names = self._names_by_step()
        steps = sorted(names["pressure"], key=float)
        fields: dict[str, Any] = {
            variable: np.array([self._values(named[step]) for step in steps])
            for variable, named in names.items()
        }
        undeformed = next((array for array in _UNDEFORMED if array in self._arrays), None)
        if undeformed is None:
            raise InputError(
                "it has no undeformed area: it needs the array CenterlineSectionArea or "
                "area_undeformed (cm²)."
            )
        area_undeformed = self._values(undeformed)
        if "area" not in fields:
            if not rigid:
                raise InputError(
                    "it has no area for each time step (area_…). If the walls were rigid, pass "
                    f"rigid=True (--rigid): then {undeformed} is used at all times."
                )
            fields["area"] = np.broadcast_to(area_undeformed, fields["flow"].shape)
        period = self._facts.get("period")
        return VesselResults(
            name,
            **fields,
            area_undeformed=area_undeformed,
            time=_times(steps, time_step),
            z=self._distance(),
            labels={
                fact.removeprefix(LABEL_PREFIX): value
                for fact, value in self._facts.items()
                if fact.startswith(LABEL_PREFIX)
            },
            period=None if isinstance(period, str) else period,
            predicted=WRITER in self._facts,
        )

    def _ordered_points(self, branch: int | None) -> _Positions:
        """Return the points of the vessel, from its inlet on."""
        if "BranchId" not in self._arrays:
            if branch is not None:
                raise InputError("it has no array BranchId: leave branch out.")
            found = _along(self._lines, np.arange(len(self._points)))
            if found is None:
                raise InputError(
                    "it has no array BranchId, and its points are not one line from an inlet to an "
                    "outlet. Extract the centerline of one vessel, or one with BranchId."
                )
            return found
        ids = self._scalar("BranchId")
        chosen = np.flatnonzero(ids == _chosen_branch(ids, branch))
        if self._has_path:
            return chosen[np.argsort(self._arrays["Path"][chosen], kind="stable")]
        found = _along(self._lines, chosen)
        if found is None:
            raise InputError(
                "it has no array Path, and no line that runs once through all points of branch "
                f"{int(ids[chosen[0]])}: their order along the vessel is unknown. Export the "
                "centerline with Path, as svSlicer writes it, or with its lines."
            )
        return found

    def _distance(self) -> Array:
        """Return the distance of the points from the first one."""
        if self._has_path:
            along = self._values("Path")
            return np.asarray(along - along[:1])
        steps = np.linalg.norm(np.diff(self._points[self._chosen], axis=0), axis=1)
        return np.append(0.0, np.cumsum(steps))

    def _names_by_step(self) -> dict[str, dict[str, str]]:
        """Return the arrays' names of each variable by their time step, the same for all."""
        found: dict[str, dict[str, str]] = {}
        for name in self._arrays:
            if match := _STEP.fullmatch(name):
                found.setdefault(match[1].lower(), {})[match[2]] = name
        velocity = found.pop("velocity", {})
        found.setdefault("flow", velocity)
        for name in ("pressure", "flow"):
            if not found.get(name):
                raise InputError(
                    f"it has no arrays {name}_<time step>{' or velocity_…' * (name == 'flow')}; "
                    f"it has {sorted(self._arrays)[:10]}. Give averaged results on a centerline, "
                    "as svSlicer writes them."
                )
        every = set[str]().union(*found.values())
        complete = every.intersection(*found.values())
        for name, steps in found.items():
            if missing := sorted(every.difference(steps)):
                raise InputError(
                    f"it has no {name}_{missing[0]} ({len(missing)} time steps lack {name}, "
                    f"{len(complete)} are complete)."
                )
        return found

    def _values(self, name: str) -> Array:
        """Return an array at the points of the vessel."""
        return self._scalar(name)[self._chosen]

    def _scalar(self, name: str) -> Array:
        """Return an array of one number at each point."""
        array = self._arrays[name]
        if array.ndim != 1:
            raise InputError(
                f"{name} has {array.shape[1]} numbers at each point, but an average over the "
                "cross-section is one number: a flow, not a velocity."
            )
        return array


def _chosen_branch(ids: Array, branch: int | None) -> int:
    """Return the number of the branch asked for, or of the only one."""
    branches = sorted({int(i) for i in ids if i >= 0})
    if branch is None and len(branches) != 1:
        raise InputError(
            f"it has the branches {branches}: choose one, branch= (--branch), and convert each "
            "vessel by itself."
        )
    if branch is not None and branch not in branches:
        raise InputError(f"it has no branch {branch!r}; its branches are {branches}.")
    return branches[0] if branch is None else branch


def _times(steps: Sequence[str], time_step: float | None) -> Array:
    """Return the times of the steps, s."""
    numbers = np.array([float(step) for step in steps])
    by_number = all(step.isdigit() for step in steps)
    if by_number and time_step is None:
        raise InputError(
            f"its arrays are named by time step, such as pressure_{steps[0]}: pass the "
            "simulation's time step, time_step= (--time-step), in s."
        )
    if by_number:
        return numbers * positive("time_step", time_step, "s")
    if time_step is not None:
        raise InputError(
            f"its arrays are named by time, such as pressure_{steps[0]}: leave time_step out."
        )
    return numbers


def _along(lines: Sequence[IntArray], chosen: _Positions) -> _Positions | None:
    """Return the points in the order of the lines through them, or None if it is not unique."""
    wanted = set(chosen.tolist())
    pairs = {pair for line in lines for pair in itertools.pairwise(line.tolist())}
    after = {one: other for one, other in pairs if {one, other} <= wanted}
    starts = wanted.difference(after.values())
    if len(starts) != 1 or len(set(after.values())) != len(wanted) - 1:
        return None  # a fork, a gap or a closed line
    order = [starts.pop()]
    while order[-1] in after:
        order.append(after[order[-1]])
    return np.array(order, dtype=np.intp) if len(order) == len(wanted) else None
