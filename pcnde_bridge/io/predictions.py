"""Prediction files: the ending of a file's name selects the format."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import atomic_write
from pcnde_bridge._utils.optional import require
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import FileError, InputError


class Predicted(Protocol):
    """The part of :class:`pcnde_bridge.Prediction` that is written to files."""

    @property
    def area_undeformed(self) -> Array:
        """Undeformed area, shape (case, z), cm²."""

    @property
    def time(self) -> Array:
        """Time points, s."""

    @property
    def z(self) -> Array:
        """Axial positions, cm."""

    @property
    def period(self) -> float:
        """Length of the cycle, s."""

    @property
    def labels(self) -> pd.DataFrame:
        """Labels, one row for each case."""

    def __len__(self) -> int: ...

    def variables(self) -> dict[str, Array]:
        """Return the predicted variables by name, shape (case, time, z)."""

    def to_frame(self) -> pd.DataFrame:
        """Return the prediction as a tidy frame."""

    def to_cases(self) -> Cases:
        """Return the prediction as a data set."""


def save(prediction: Predicted, path: str | os.PathLike[str]) -> list[Path]:
    """Write a prediction in the format that the file's ending names.

    See :meth:`pcnde_bridge.Prediction.save` for the formats and errors.
    """
    suffix = check_target(path, "pressure" in prediction.variables())
    if suffix == ".csv":
        save_csv([prediction], path)
    elif suffix in (".vtp", ".pvd"):
        from pcnde_bridge.io.simvascular import write_pvd, write_vtp

        return (write_vtp if suffix == ".vtp" else write_pvd)(prediction, path)
    else:
        prediction.to_cases().save(path)
    return [Path(path)]


def save_csv(parts: Iterable[Predicted], path: str | os.PathLike[str]) -> int:
    """Write the frames of predictions into one table, one after the other.

    Parameters
    ----------
    parts : iterable of Prediction
        Such as :meth:`pcnde_bridge.PCNDE.predict_batches` gives: only one is in memory.
    path : path-like
        The file, ``.csv`` or ``.csv.gz``.

    Returns
    -------
    int
        Cases that were written.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    count = 0
    with atomic_write(path) as temporary:  # its ending, too, says whether to compress
        for part in parts:
            part.to_frame().to_csv(temporary, index=False, header=count == 0, mode="a")
            count += len(part)
    return count


def check_target(path: str | os.PathLike[str], has_pressure: bool) -> str:
    """Refuse a file that :meth:`Prediction.save` could not write, before anything is computed.

    Parameters
    ----------
    path : path-like
        The file.
    has_pressure : bool
        Whether the pressure will be there.

    Returns
    -------
    str
        The ending that says the format.

    Raises
    ------
    FileError, InputError, MissingExtraError
        As :meth:`Prediction.save`.
    """
    target = Path(path)
    name = target.name.lower().removesuffix(".gz")
    suffix = Path(name).suffix
    known = (".csv", ".npz", ".h5", ".hdf5", ".vtp", ".pvd")
    if suffix not in known or (name != target.name.lower() and suffix != ".csv"):
        raise FileError(
            f"Cannot tell the format of {target}: it must end in .csv, .npz, .h5, .vtp or .pvd."
        )
    if target.is_dir() or not target.parent.is_dir():
        raise FileError(f"Cannot write {target}: give a file in an existing folder.")
    if suffix in (".npz", ".h5", ".hdf5") and not has_pressure:
        raise InputError(
            "The model has no pressure stages, so this is not a whole data set: write a .csv or "
            ".vtp file."
        )
    if suffix in (".vtp", ".pvd"):
        require("vtkmodules.vtkIOXML", "vtk")
    return suffix
