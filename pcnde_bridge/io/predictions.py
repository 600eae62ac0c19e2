"""Prediction files: the ending of a file's name selects the format."""

from collections.abc import Iterable
from pathlib import Path

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import atomic_write, is_folder, plain_text
from pcnde_bridge._utils.optional import require
from pcnde_bridge.data.indices import VesselQuantities
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.io.centerlines import write_pvd, write_vtp

_DATA_SETS = (".npz", ".h5", ".hdf5")
CENTERLINES = {".vtp": write_vtp, ".pvd": write_pvd}


def save_csv(parts: Iterable[VesselQuantities], path: StrPath) -> int:
    """Write the tables of several predictions into one file.

    Parameters
    ----------
    parts : iterable of Prediction
        Predictions, such as those of :meth:`pcnde_bridge.PCNDE.predict_batches`; only one
        is in memory at a time.
    path : path-like
        The file, ``.csv`` or ``.csv.gz``.

    Returns
    -------
    int
        Number of cases.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    count = 0
    with atomic_write(path) as temporary:  # its ending also selects the compression
        for part in parts:
            table = plain_text(part.to_frame())
            table.to_csv(temporary, index=False, header=count == 0, mode="a")
            count += len(part)
    return count


def check_target(path: StrPath, has_pressure: bool) -> str:
    """Raise if :meth:`pcnde_bridge.Prediction.save` cannot write a file; compute nothing.

    Parameters
    ----------
    path : path-like
        The file.
    has_pressure : bool
        Whether the prediction will have a pressure.

    Returns
    -------
    str
        The ending that names the format.

    Raises
    ------
    FileError
        If the ending is unknown, or the folder does not exist.
    InputError
        If the format needs a pressure.
    MissingExtraError
        If the format needs VTK, which is not installed (extra ``vtk``).
    """
    target = Path(path)
    suffix = ".csv" if target.name.lower().endswith(".csv.gz") else target.suffix.lower()
    if suffix not in (".csv", *_DATA_SETS, *CENTERLINES):
        raise FileError(f"Cannot write {target}: it must end in .csv, .npz, .h5, .vtp or .pvd.")
    if is_folder(target) or not is_folder(target.parent):
        raise FileError(f"Cannot write {target}: give a file in an existing folder.")
    if suffix in _DATA_SETS and not has_pressure:
        raise InputError("The model has no pressure stages, so no data sets: use .csv or .vtp.")
    if suffix in CENTERLINES:
        require("vtkmodules.vtkIOXML", "vtk")
    return suffix
