"""Centreline results of SimVascular: ``.vtp`` files with arrays for each time step.

svSlicer and SimVascular's own tools average 3D results over the cross-sections and write
them onto the centreline as point arrays ``pressure_00500`` and ``velocity_00500`` (which
holds the flow) or ``flow_00500``, by the number of the time step; SimVascular's
reduced-order simulations as ``pressure_0.5``, ``flow_0.5`` and ``area_0.5``, by the time
in s.  ``Path`` is the distance along each branch, ``BranchId`` the branch (-1 within a
junction), ``CenterlineSectionArea`` the area of the cross-section of the mesh.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import (
    as_paths,
    atomic_write,
    make_folder,
)
from pcnde_bridge._utils.optional import require
from pcnde_bridge._utils.validation import positive
from pcnde_bridge._version import __version__
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.io.vessel_results import CaseOptions, VesselResults, to_cases
from pcnde_bridge.io.vtp import read_lines

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcnde_bridge.io.predictions import Predicted

_STEP = re.compile(r"(pressure|velocity|flow|area)_(\d+|\d*\.?\d+(?:[eE][-+]?\d+)?|\d+\.)")
_LABEL = "labels/"
_WRITER = "pcnde_bridge"  # array that tells our own files from those of others


def read_simvascular(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    time_step: float | None = None,
    branch: int | None = None,
    rigid: bool = False,
    **options: Unpack[CaseOptions],
) -> Cases:
    """Read centreline results of SimVascular.

    Parameters
    ----------
    paths : path-like or sequence of them
        ``.vtp`` files, one for each case.
    time_step : float, optional
        Of the 3D simulation, s; needed where arrays are named by the number of the
        time step.
    branch : int, optional
        ``BranchId`` of the vessel, where the file has several.
    rigid : bool
        Allow files without an area for each time step: the simulation had rigid
        walls, and the area is that of the mesh at all times.
    **options
        ``period``, ``units``, ``flip``, ``instants``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.vessel_results.to_cases`.

    Returns
    -------
    Cases
        z counts from the first point of the branch, along ``Path`` or, without it, along
        the file's lines.  The undeformed area is the array ``area_undeformed``, or else
        ``CenterlineSectionArea``, or ``area``.

    Raises
    ------
    DataNotFoundError
        If a file is not there.
    FileError
        If a file is damaged or no ``.vtp``.
    InputError
        If arrays are missing, or units, flow or time steps are doubtful.
    """
    return to_cases(
        [_read_vessel(path, time_step, branch, rigid) for path in as_paths(paths)], **options
    )


def _read_vessel(
    path: Path, time_step: float | None, branch: int | None, rigid: bool
) -> VesselResults:
    points, lines, arrays, facts = read_lines(path)
    chosen = _branch(path, arrays, lines, len(points), branch)
    z = _distance(points, arrays, chosen)
    steps = _steps(path, arrays)
    times = _times(path, list(steps["pressure"]), time_step)
    fields = {
        name: np.array([_scalar(path, arrays, array)[chosen] for array in named.values()])
        for name, named in steps.items()
    }
    order = np.argsort(times)
    period = facts.get("period")
    undeformed = next(
        (n for n in ("area_undeformed", "CenterlineSectionArea", "area") if n in arrays), None
    )
    if undeformed is None:
        raise InputError(
            f"{path} has no undeformed area: it needs the array CenterlineSectionArea or "
            "area_undeformed (cm²)."
        )
    s_u = _scalar(path, arrays, undeformed)[chosen]
    if "area" not in fields:
        if not rigid:
            raise InputError(
                f"{path} has no area for each time step (area_…). If the walls were rigid, pass "
                f"rigid=True (--rigid): the area is then {undeformed} at all times."
            )
        fields["area"] = np.broadcast_to(s_u, fields["flow"].shape)
    return VesselResults(
        str(path),
        fields["flow"][order],
        fields["area"][order],
        fields["pressure"][order],
        s_u,
        times[order],
        z,
        labels={
            name.removeprefix(_LABEL): value
            for name, value in facts.items()
            if name.startswith(_LABEL)
        },
        period=None if isinstance(period, str) else period,
    )


def _branch(
    path: Path,
    arrays: Mapping[str, Array],
    lines: list[npt.NDArray[np.int64]],
    n: int,
    branch: int | None,
) -> npt.NDArray[np.intp]:
    """Return the points of the vessel, from its inlet on."""
    if "BranchId" not in arrays:
        if branch is not None:
            raise InputError(f"{path} has no array BranchId: leave branch out.")
        found = _along(lines, np.arange(n))
        if found is None:
            raise InputError(
                f"{path} has no array BranchId, and its points are not one line from an inlet to "
                "an outlet. Extract the centreline of one vessel, or one with BranchId."
            )
        return found
    ids = _scalar(path, arrays, "BranchId")
    there = sorted({int(i) for i in ids if i >= 0})
    if branch is None:
        if len(there) != 1:
            raise InputError(
                f"{path} has the branches {there}: choose one, branch= (--branch), and convert "
                "each vessel by itself."
            )
        branch = there[0]
    elif branch not in there:
        raise InputError(f"{path} has no branch {branch!r}; its branches are {there}.")
    chosen = np.flatnonzero(ids == branch)
    if _has_path(arrays):
        return chosen[np.argsort(arrays["Path"][chosen], kind="stable")]
    found = _along(lines, chosen)
    if found is None:
        raise InputError(
            f"{path} has no array Path, and no line that runs once through all points of branch "
            f"{branch}: their order along the vessel is not known. Export the centreline with "
            "Path, as svSlicer writes it, or with its lines."
        )
    return found


def _has_path(arrays: Mapping[str, Array]) -> bool:
    return "Path" in arrays and arrays["Path"].ndim == 1


def _along(
    lines: list[npt.NDArray[np.int64]], chosen: npt.NDArray[np.intp]
) -> npt.NDArray[np.intp] | None:
    """Return the points in the order in which the lines run through them, if it is one."""
    wanted = set(chosen.tolist())
    pairs = {pair for line in lines for pair in itertools.pairwise(line.tolist())}
    after = {one: other for one, other in pairs if {one, other} <= wanted}
    starts = wanted.difference(after.values())
    if len(starts) != 1 or len(set(after.values())) != len(wanted) - 1:
        return None  # it forks, or has a gap, or is closed
    order = [starts.pop()]
    while order[-1] in after:
        order.append(after[order[-1]])
    return np.array(order, dtype=np.intp) if len(order) == len(wanted) else None


def _distance(points: Array, arrays: Mapping[str, Array], chosen: npt.NDArray[np.intp]) -> Array:
    if _has_path(arrays):
        along = arrays["Path"][chosen]
        return np.asarray(along - along[:1])
    steps = np.linalg.norm(np.diff(points[chosen], axis=0), axis=1)
    return np.append(0.0, np.cumsum(steps))


def _steps(path: Path, arrays: Mapping[str, Array]) -> dict[str, dict[str, str]]:
    """Return the arrays' names of each field by their time step, all of the same steps."""
    found: dict[str, dict[str, str]] = {}
    for name in arrays:
        if match := _STEP.fullmatch(name):
            found.setdefault(match[1], {})[match[2]] = name
    flow = found.pop("velocity", {})
    found["flow"] = found.get("flow") or flow
    for name in ("pressure", "flow"):
        if not found.get(name):
            raise InputError(
                f"{path} has no arrays {name}_<time step>{' or velocity_…' * (name == 'flow')}; "
                f"it has {sorted(arrays)[:10]}. Give averaged results on a centreline, as "
                "svSlicer writes them."
            )
    if not found.get("area"):
        found.pop("area", None)
    everywhere = set.intersection(*(set(steps) for steps in found.values()))
    for name, steps in found.items():
        if missing := sorted({s for other in found.values() for s in other} - set(steps)):
            raise InputError(
                f"{path} has no {name}_{missing[0]} ({len(missing)} time steps lack {name}, "
                f"{len(everywhere)} are whole)."
            )
    return {
        name: {step: steps[step] for step in found["pressure"]} for name, steps in found.items()
    }


def _times(path: Path, steps: list[str], time_step: float | None) -> Array:
    numbers = np.array([float(step) for step in steps])
    if not all(step.isdigit() for step in steps):
        if time_step is not None:
            raise InputError(
                f"{path} names its arrays by time, such as pressure_{steps[0]}: leave time_step "
                "out."
            )
        return numbers
    if time_step is None:
        raise InputError(
            f"{path} names its arrays by time step, such as pressure_{steps[0]}: pass the "
            "simulation's time step, time_step= (--time-step), in s."
        )
    return numbers * positive("time_step", time_step, "s")


def _scalar(path: Path, arrays: Mapping[str, Array], name: str) -> Array:
    array = arrays[name]
    if array.ndim != 1:
        raise InputError(
            f"{path}: {name} has {array.shape[1]} numbers at each point. These are not averages "
            "over cross-sections: a flow is one number."
        )
    return array


# ---- writing -----------------------------------------------------------------


def write_vtp(prediction: Predicted, path: str | os.PathLike[str]) -> list[Path]:
    """Write a prediction as centrelines, with arrays for each time step.

    The vessel is a straight line along z.  :func:`read_simvascular` reads the files back.

    Parameters
    ----------
    prediction : Prediction
        Of one or many cases.
    path : path-like
        Ends in ``.vtp``.  Of many cases, each gets a file of its own with its number:
        ``name_000.vtp``, ….  Further such files of an earlier prediction are removed.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    FileError
        If a file cannot be written.
    MissingExtraError
        If VTK is not installed (extra ``vtk``).
    """
    target = Path(path)
    contents = [_polydata(prediction, case, None) for case in range(len(prediction))]
    names = [target]
    if len(prediction) > 1:
        names = [_numbered(target, case) for case in range(len(prediction))]
    with contextlib.ExitStack() as all_or_none:
        for name, content in zip(names, contents, strict=True):
            all_or_none.enter_context(atomic_write(name)).write_bytes(content)
    _remove_earlier(
        target.parent, rf"{re.escape(target.stem)}_\d{{3,}}{re.escape(target.suffix)}", names
    )
    return names


def write_pvd(prediction: Predicted, path: str | os.PathLike[str]) -> list[Path]:
    """Write a prediction as an animation for ParaView: one file for each time step.

    Parameters
    ----------
    prediction : Prediction
        Its cases become the parts of each time step.
    path : path-like
        Ends in ``.pvd``; it names the others, which lie in a folder of the same name.
        Further such files of an earlier prediction are removed.

    Returns
    -------
    list of Path
        The ``.pvd`` file, then the others.

    Raises
    ------
    FileError
        If a file cannot be written.
    MissingExtraError
        If VTK is not installed (extra ``vtk``).
    """
    target = Path(path)
    folder = target.with_suffix("")
    steps = [
        (case, step, folder / f"{target.stem}_{case:03d}_{step:04d}.vtp")
        for step in range(len(prediction.time))
        for case in range(len(prediction))
    ]
    contents = [_polydata(prediction, case, step) for case, step, _ in steps]
    rows = [
        f'<DataSet timestep="{float(prediction.time[step])!r}" part="{case}" '
        f"file={quoteattr(f'{folder.name}/{name.name}')}/>"
        for case, step, name in steps
    ]
    with contextlib.ExitStack() as all_or_none:
        all_or_none.enter_context(atomic_write(target)).write_text(
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>\n'
            + "\n".join(rows)
            + "\n</Collection></VTKFile>\n",
            encoding="utf-8",
        )
        make_folder(folder)
        for (_, _, name), content in zip(steps, contents, strict=True):
            all_or_none.enter_context(atomic_write(name)).write_bytes(content)
    pattern = rf"{re.escape(target.stem)}_\d{{3,}}_\d{{4,}}\.vtp"
    _remove_earlier(folder, pattern, [name for _, _, name in steps])
    return [target, *(name for _, _, name in steps)]


def _numbered(path: Path, case: int) -> Path:
    return path.with_name(f"{path.stem}_{case:03d}{path.suffix}")


def _remove_earlier(folder: Path, pattern: str, written: Collection[Path]) -> None:
    """Remove our own files of an earlier prediction, lest they be read as part of this one."""
    kept = {path.name for path in written}
    for path in folder.iterdir():
        if path.name in kept or not re.fullmatch(pattern, path.name):
            continue
        try:
            if f'Name="{_WRITER}"'.encode() in path.read_bytes():
                path.unlink()
        except OSError as error:
            raise FileError(
                f"Cannot remove {path}, which is of an earlier prediction: {error}."
            ) from error


def _polydata(prediction: Predicted, case: int, step: int | None) -> bytes:
    """Return the content of a ``.vtp`` file: of one time step, or with arrays for all."""
    model = require("vtkmodules.vtkCommonDataModel", "vtk")
    core, io = require("vtkmodules.vtkCommonCore", "vtk"), require("vtkmodules.vtkIOXML", "vtk")
    to_vtk = require("vtkmodules.util.numpy_support", "vtk").numpy_to_vtk
    data, points, lines = model.vtkPolyData(), core.vtkPoints(), model.vtkCellArray()
    n = prediction.z.size
    line = np.zeros((n, 3))
    line[:, 2] = prediction.z
    points.SetData(to_vtk(line, deep=True))
    data.SetPoints(points)
    lines.InsertNextCell(n, list(range(n)))
    data.SetLines(lines)
    arrays: dict[str, npt.NDArray[Any]] = {
        "BranchId": np.zeros(n, dtype=np.int64),
        "GlobalNodeId": np.arange(n),
        "Path": prediction.z - prediction.z[0],
        "area_undeformed": prediction.area_undeformed[case],
    }
    for name, values in prediction.variables().items():
        if step is not None:
            arrays[name] = values[case, step]
        else:
            for time, row in zip(prediction.time, values[case], strict=True):
                arrays[f"{name}_{float(time)!r}"] = row
    for name, values in arrays.items():
        array = to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    facts = {f"{_LABEL}{name}": value for name, value in prediction.labels.iloc[case].items()}
    for name, value in {"period": prediction.period, _WRITER: __version__, **facts}.items():
        if isinstance(value, str):
            array = core.vtkStringArray()
            array.InsertNextValue(value)
        else:
            number = int(value) if isinstance(value, bool | np.bool_) else value  # VTK has no bool
            array = to_vtk(np.array([number]), deep=True)
        array.SetName(name)
        data.GetFieldData().AddArray(array)
    writer = io.vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.WriteToOutputStringOn()
    if not writer.Write():
        raise FileError("VTK could not write the centreline.")
    return str(writer.GetOutputString()).encode()
