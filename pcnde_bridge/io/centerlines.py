"""Predictions as centerline files for SimVascular and ParaView (``.vtp``, ``.pvd``)."""

import contextlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import AnyArray, StrPath
from pcnde_bridge._utils.archive import sha256_arrays
from pcnde_bridge._utils.files import atomic_write, check_writable, make_folder
from pcnde_bridge._utils.optional import require
from pcnde_bridge._version import __version__
from pcnde_bridge.data.indices import VesselQuantities
from pcnde_bridge.errors import FileError

LABEL_PREFIX = "labels/"
"""Beginning of the names of field data that are labels of a case."""

WRITER = "pcnde_bridge"
"""Name of the text in files of this package: its version, and the checksum of the results."""


def checksum(arrays: Mapping[str, AnyArray], labels: Mapping[str, Any], period: Any) -> str:
    """Return the SHA-256 checksum of a vessel's results and their labels."""
    plain = {name: np.asarray(value).item() for name, value in labels.items()}
    facts = json.dumps([period, plain], sort_keys=True)
    return sha256_arrays({**dict(sorted(arrays.items())), "facts": np.array(facts)})


def write_vtp(prediction: VesselQuantities, path: StrPath) -> list[Path]:
    """Write a prediction as centerlines with arrays for each time step.

    The vessel is a straight line along z.  :func:`pcnde_bridge.io.read_simvascular` reads
    the files back.

    Parameters
    ----------
    prediction : Prediction
        Prediction of one or several cases.
    path : path-like
        File that ends in ``.vtp``.  Several cases are written to numbered files,
        ``name_000.vtp`` and so on; other such files of an earlier prediction are removed.

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
    contents: dict[Path, bytes] = {}
    for case in range(len(prediction)):
        number = f"_{case:03d}" if len(prediction) > 1 else ""
        name = target.with_name(f"{target.stem}{number}{target.suffix}")
        contents[name] = _vtp(prediction, case, None)
    earlier = rf"{re.escape(target.stem)}_\d{{3,}}{re.escape(target.suffix)}"
    return _write_all(contents, target.parent, earlier)


def write_pvd(prediction: VesselQuantities, path: StrPath) -> list[Path]:
    """Write a prediction as an animation for ParaView: one file for each time step.

    Parameters
    ----------
    prediction : Prediction
        Prediction whose cases become the parts of each time step.
    path : path-like
        File that ends in ``.pvd``.  It names the others, which are in a folder of the same
        name; other such files of an earlier prediction are removed.

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
    contents: dict[Path, bytes] = {}
    rows = []
    for step, time in enumerate(prediction.time):
        for case in range(len(prediction)):
            name = folder / f"{target.stem}_{case:03d}_{step:04d}.vtp"
            contents[name] = _vtp(prediction, case, step)
            file = quoteattr(f"{folder.name}/{name.name}")
            rows.append(f'<DataSet timestep="{float(time)!r}" part="{case}" file={file}/>\n')
    collection = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>\n'
        f"{''.join(rows)}</Collection></VTKFile>\n"
    )
    check_writable(target)
    make_folder(folder)
    earlier = rf"{re.escape(target.stem)}_\d{{3,}}_\d{{4,}}\.vtp"
    return _write_all({target: collection.encode(), **contents}, folder, earlier)


def _write_all(contents: Mapping[Path, bytes], folder: Path, earlier: str) -> list[Path]:
    """Write all files or none, and remove those of an earlier prediction from the folder.

    Files that were left over would be read as a part of this prediction.
    """
    with contextlib.ExitStack() as all_or_none:
        for path, content in contents.items():
            all_or_none.enter_context(atomic_write(path)).write_bytes(content)
    for path in folder.iterdir():
        try:
            old = path not in contents and re.fullmatch(earlier, path.name)
            if old and f'Name="{WRITER}"'.encode() in path.read_bytes():
                path.unlink()
        except OSError as error:
            raise FileError(f"Cannot remove {path} of an earlier prediction: {error}.") from error
    return list(contents)


def _vtp(prediction: VesselQuantities, case: int, step: int | None) -> bytes:
    """Return the content of a ``.vtp`` file: one time step, or arrays for each of them."""
    core, model = (require(f"vtkmodules.vtkCommon{part}", "vtk") for part in ("Core", "DataModel"))
    data, lines, n = model.vtkPolyData(), model.vtkCellArray(), prediction.z.size
    lines.InsertNextCell(n, list(range(n)))
    data.SetLines(lines)
    wrapped = require("vtkmodules.numpy_interface.dataset_adapter", "vtk").WrapDataObject(data)
    wrapped.Points = np.outer(prediction.z, [0.0, 0.0, 1.0])
    data.GetPoints().GetData().SetName("Points")
    for name, values in _point_arrays(prediction, case, step).items():
        wrapped.PointData.append(values, name)
    found = prediction.labels.iloc[case].to_dict()
    # VTK has no bool.
    labels = {str(k): int(v) if isinstance(v, bool | np.bool_) else v for k, v in found.items()}
    arrays = {name: values[case] for name, values in prediction.variables().items()}
    arrays |= {"area_undeformed": prediction.area_undeformed[case], "time": prediction.time}
    digest = checksum({**arrays, "z": prediction.z - prediction.z[0]}, labels, prediction.period)
    facts = {f"{LABEL_PREFIX}{name}": value for name, value in labels.items()}
    facts |= {"period": prediction.period, WRITER: f"{__version__} {digest}"}
    for name, value in facts.items():
        if isinstance(value, str):
            text = core.vtkStringArray()
            text.SetName(name)
            text.InsertNextValue(value)
            data.GetFieldData().AddArray(text)
        else:
            wrapped.FieldData.append(np.array([value]), name)
    writer = require("vtkmodules.vtkIOXML", "vtk").vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.WriteToOutputStringOn()
    if not writer.Write():
        raise FileError("VTK could not write the centerline.")
    return str(writer.GetOutputString()).encode()


def _point_arrays(
    prediction: VesselQuantities, case: int, step: int | None
) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays at the points of the centerline."""
    n = prediction.z.size
    arrays: dict[str, npt.NDArray[Any]] = {
        "BranchId": np.zeros(n, dtype=np.int64),
        "GlobalNodeId": np.arange(n),
        "Path": prediction.z - prediction.z[0],
        "area_undeformed": prediction.area_undeformed[case],
    }
    for name, values in prediction.variables().items():
        if step is None:
            times = map(float, prediction.time)
            arrays |= {f"{name}_{t!r}": row for t, row in zip(times, values[case], strict=True)}
        else:
            arrays[name] = values[case, step]
    return arrays
