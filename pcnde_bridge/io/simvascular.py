"""Centerline results of SimVascular: ``.vtp`` files with arrays for each time step.

svSlicer and SimVascular's own tools average 3D results over the cross-sections and write
them onto the centerline as point arrays ``pressure_00500`` and ``velocity_00500`` (which
holds the flow) or ``flow_00500``, named by the number of the time step.  A wall shear stress
is ``wss_00500`` or, as in the 3D results, ``vWSS_00500``, whose magnitude is used.  SimVascular's
reduced-order simulations write ``pressure_0.5``, ``flow_0.5`` and ``area_0.5``, named by
the time in s.  ``Path`` is the distance along each branch, ``BranchId`` the branch (-1
within a junction), ``CenterlineSectionArea`` the area of the cross-section of the mesh.

Time series have a file for each time step, with arrays ``pressure``, ``velocity`` and so on:
``name_00500.vtp``, named by the number of the time step, or those that a ``.pvd`` file lists.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, IntArray
from pcnde_bridge._utils.archive import with_prefix
from pcnde_bridge._utils.files import Budget, as_paths, reading
from pcnde_bridge._utils.validation import positive
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, read_vessels
from pcnde_bridge.io.centerlines import LABEL_PREFIX, WRITER, checksum
from pcnde_bridge.io.vessel_results import VesselResults
from pcnde_bridge.io.vtp import Lines, read_lines, xml_root

_VARIABLE = re.compile("pressure|velocity|flow|area|wall_shear_stress|v?wss", re.IGNORECASE)
_STEP = re.compile(rf"({_VARIABLE.pattern})_(\d+|\d*\.?\d+(?:[eE][-+]?\d+)?|\d+\.)", re.IGNORECASE)
_NUMBERED = re.compile(r"(.*?)(\d+)\.vtp", re.IGNORECASE)
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
        ``.vtp`` files, one for each case or, with arrays without the number of the time step
        in their names, one for each time step; or ``.pvd`` files that list them.
    time_step : float, optional
        Time step of the 3D simulation, s; needed where arrays or files are named by the
        number of the time step.
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
    series = _series(as_paths(paths))

    def read(name: Path) -> list[VesselResults]:
        return [_vessel(str(name), _merged(series[name]), branch, time_step, rigid)]

    return read_vessels([*series], read, **options)


def _series(paths: Sequence[Path]) -> dict[Path, dict[str, Path]]:
    """Return the files of each case by their time step; "" is that of a file with all of them."""
    series: dict[Path, dict[str, Path]] = {}
    by_step: dict[Path, bool] = {}
    for path in paths:
        number = _NUMBERED.fullmatch(path.name)
        name = path.with_name(f"{number[1]}….vtp") if number else path
        if path.suffix.lower() == ".pvd":
            series |= _collection(path)
        elif number and name not in by_step:
            by_step[name] = not any(map(_STEP.fullmatch, read_lines(path).arrays))
        if number and by_step[name]:
            series.setdefault(name, {})[number[2]] = path
        elif path.suffix.lower() != ".pvd":
            series[path] = {"": path}
    return series


def _collection(path: Path) -> dict[Path, dict[str, Path]]:
    """Return the files of each part of a ``.pvd`` file by their time step."""
    parts: dict[Path, dict[str, Path]] = {}
    with reading(path, "a .pvd file (VTK XML Collection)"):
        for item in xml_root(path.read_bytes()).iterfind("Collection/DataSet"):
            part = path.with_name(f"{path.name}, part {item.get('part', '0')}")
            parts.setdefault(part, {})[item.attrib["timestep"]] = path.parent / item.attrib["file"]
    return parts


def _merged(files: Mapping[str, Path]) -> Lines:
    """Return the files of a time series as one, with the time step in the names of arrays."""
    budget = Budget(2 * sum(map(_size, {*files.values()})))
    first: Lines | None = None
    arrays: dict[str, Array] = {}
    for step, path in files.items():
        found = read_lines(path)
        if first is None:
            first = found
            arrays |= {n: v for n, v in found.arrays.items() if not (step and _is_variable(n))}
        if not np.array_equal(found.points, first.points):
            raise InputError(f"{path} has other points than the first file.")
        named = {n: v for n, v in found.arrays.items() if step and _is_variable(n)}
        with reading(path, "a .vtp file of a time series"):
            budget.claim(sum(values.nbytes for values in named.values()))
        arrays |= {f"{name}_{step}": values for name, values in named.items()}
    assert first is not None
    return first._replace(arrays=arrays)


def _size(path: Path) -> int:
    """Return the size of a file, or 0 where only reading it tells what is wrong."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _is_variable(name: str) -> bool:
    return _VARIABLE.fullmatch(name) is not None


def _vessel(
    name: str, centerline: Lines, branch: int | None, time_step: float | None, rigid: bool
) -> VesselResults:
    """Return the results of a vessel, in the order of time and from its inlet on."""
    points, arrays = _from_inlet_on(centerline, branch)
    names = _names_by_step(arrays)
    for stress in names.get("wall_shear_stress", {}).values():
        if arrays[stress].ndim == 2:
            arrays[stress] = np.linalg.norm(arrays[stress], axis=1)
    undeformed = next((name for name in _UNDEFORMED if name in arrays), None)
    if undeformed is None:
        raise InputError("it has no undeformed area: CenterlineSectionArea or area_undeformed.")
    if "area" not in names and not rigid:
        advice = f"Pass rigid=True (--rigid) to use {undeformed}."
        raise InputError(f"it has no area for each time step. {advice}")
    steps = sorted(names["pressure"], key=float)
    names.setdefault("area", dict.fromkeys(steps, undeformed))
    fields: dict[str, Any] = {
        variable: np.array([_scalar(arrays, named[step]) for step in steps])
        for variable, named in names.items()
    }
    z = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum())
    if "Path" in arrays:
        z = _scalar(arrays, "Path") - arrays["Path"][:1]
    facts = centerline.facts
    period = facts.get("period")
    results = VesselResults(
        name,
        **fields,
        area_undeformed=_scalar(arrays, undeformed),
        time=_times(steps, time_step),
        z=z,
        labels=with_prefix(LABEL_PREFIX, facts),
        period=None if isinstance(period, str) else period,
        units={"shape": "area"} if WRITER in facts else {},
        predicted=WRITER in facts,
    )
    arrays = {**results.variables(), "area_undeformed": results.area_undeformed}
    digest = checksum({**arrays, "time": results.time, "z": z}, results.labels, results.period)
    stated = str(facts.get(WRITER, "")).split()[1:]
    if stated and stated != [digest]:
        raise FileError(f"{name} was changed after it was written: its checksum is wrong.")
    return results


def _from_inlet_on(centerline: Lines, branch: int | None) -> tuple[Array, dict[str, Array]]:
    """Return the points of the vessel, and the arrays at them, from its inlet on."""
    arrays = centerline.arrays
    chosen = np.arange(len(centerline.points))
    lacks = "BranchId, and its points are not one line from an inlet to an outlet"
    if "BranchId" in arrays:
        ids = _scalar(arrays, "BranchId")
        branch = _chosen_branch(ids, branch)
        chosen = np.flatnonzero(ids == branch)
        lacks = f"Path, and no line that runs once through all points of branch {branch}"
    elif branch is not None:
        raise InputError("it has no array BranchId: leave branch out.")
    if {"BranchId", "Path"} <= arrays.keys():
        along = _scalar(arrays, "Path")[chosen]
        order: _Positions | None = chosen[np.argsort(along, kind="stable")]
    else:
        order = _along(centerline.lines, chosen)
    if order is None:
        raise InputError(
            f"it has no array {lacks}: their order along the vessel is unknown. Export one vessel "
            "with BranchId and Path, as svSlicer does, or with its lines."
        )
    return centerline.points[order], {name: array[order] for name, array in arrays.items()}


def _names_by_step(arrays: Mapping[str, Array]) -> dict[str, dict[str, str]]:
    """Return the arrays' names of each variable by their time step, the same for all."""
    found: dict[str, dict[str, str]] = {"pressure": {}, "velocity": {}}
    for name in arrays:
        if match := _STEP.fullmatch(name):
            variable = re.sub("v?wss", "wall_shear_stress", match[1].lower())
            found.setdefault(variable, {})[match[2]] = name
    found.setdefault("flow", found.pop("velocity"))
    steps = set[str]().union(*found.values())
    for name, named in found.items():
        missing = sorted(steps.difference(named)) if named else ["<time step>"]
        if missing:
            raise InputError(
                f"it has no {name}_{missing[0]}{' or velocity_…' * (name == 'flow')} ({len(named)} "
                f"of {len(steps)} time steps have {name}); it has {sorted(arrays)[:10]}. Give "
                "averaged results on a centerline, as svSlicer writes them."
            )
    return found


def _scalar(arrays: Mapping[str, Array], name: str) -> Array:
    """Return an array of one number at each point."""
    array = arrays[name]
    if array.ndim != 1:
        raise InputError(
            f"{name} has {array.shape[1]} numbers at each point, but an average over the "
            "cross-section is one number: a flow, not a velocity."
        )
    return array


def _chosen_branch(ids: Array, branch: int | None) -> int:
    """Return the number of the branch asked for, or of the only one."""
    branches = sorted({int(i) for i in ids if i >= 0})
    if branch is None and len(branches) == 1:
        return branches[0]
    if branch is None or branch not in branches:
        other = "" if branch is None else f", not {branch!r}"
        raise InputError(f"it has the branches {branches}{other}: choose one, branch= (--branch).")
    return branch


def _times(steps: Sequence[str], time_step: float | None) -> Array:
    """Return the times of the steps, s."""
    times = np.array(steps, dtype=np.float64)
    by_number = all(step.isdigit() for step in steps)
    if by_number == (time_step is None):
        named, advice = "time", "leave time_step out"
        if by_number:
            named, advice = "time step", "pass the time step in s, time_step= (--time-step)"
        raise InputError(f"its arrays are named by {named}, such as pressure_{steps[0]}: {advice}.")
    return times * positive("time_step", time_step, "s") if by_number else times


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
