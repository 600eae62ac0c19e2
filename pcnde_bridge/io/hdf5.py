"""HDF5 files of other programs: data sets of flow, area and pressure."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._utils.files import as_paths, check_file
from pcnde_bridge._utils.hdf5 import read_dataset
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.io.units import FACTORS, stated_units
from pcnde_bridge.io.vessel_results import (
    CaseOptions,
    VesselResults,
    to_cases,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

NAMES = (*VARIABLES, "area_undeformed", "time", "z")


def read_hdf5(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    names: Mapping[str, str] | None = None,
    **options: Unpack[CaseOptions],
) -> Cases:
    """Read HDF5 files.

    Parameters
    ----------
    paths : path-like or sequence of them
        Files with the data sets ``flow``, ``area`` and ``pressure`` of shape (time, z)
        or (case, time, z), ``area_undeformed`` of shape (z,) or (case, z), ``time`` and
        ``z``; ``period`` and ``labels/…`` if they are there.  An attribute ``units`` of
        a data set counts where the option ``units`` says nothing.
    names : mapping, optional
        Paths of data sets of another name: ``{"flow": "/results/Q"}``.
    **options
        ``period``, ``units``, ``flip``, ``instants``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.vessel_results.to_cases`.

    Returns
    -------
    Cases
        In the order of the files, and in each as they stand.

    Raises
    ------
    DataNotFoundError
        If a file is not there.
    FileError
        If a file is damaged or no HDF5.
    InputError
        If data sets are missing, or units, flow or time steps are doubtful.
    """
    places = dict(names or {})
    if unknown := sorted(set(places) - set(NAMES)):
        raise InputError(f"names has {unknown}; it can name {list(NAMES)}.")
    for name, place in places.items():
        if not isinstance(place, str):
            raise InputError(f"names[{name!r}] must be the path of a data set, got {place!r}.")
    stated = set(stated_units(options.get("units")))
    return to_cases(
        [vessel for path in as_paths(paths) for vessel in _read(path, places, stated)], **options
    )


def _read(path: Path, names: Mapping[str, str], stated: set[str]) -> list[VesselResults]:
    import h5py

    check_file(path, "an HDF5 file")
    arrays: dict[str, npt.NDArray[Any]] = {}
    labels: dict[str, npt.NDArray[Any]] = {}
    units: dict[str, str] = {}
    try:
        with h5py.File(path, "r") as file:
            for name in (*NAMES, "period"):
                place = names.get(name, name)
                values = read_dataset(file, place)
                if values is not None:
                    arrays[name] = values
                    units[name] = _text(file[place].attrs.get("units", ""))
            group = file.get("labels")
            for name in group if isinstance(group, h5py.Group) else ():
                values = read_dataset(file, f"labels/{name}")
                if values is not None:
                    labels[name] = values
    except Exception as error:  # damaged bytes can make the reader raise nearly anything
        raise FileError(f"{path} is no HDF5 file, or damaged: {error}.") from error
    if absent := [name for name in NAMES if name not in arrays]:
        raise InputError(
            f"{path} lacks the data sets {absent}; name them, names={{'{absent[0]}': 'path'}} "
            f"(--names {absent[0]}=path)."
        )
    return _vessels(path, arrays, labels, _known_units(path, units, stated))


def _text(attribute: Any) -> str:
    """Return an attribute that is a text, or an array of one, however it is stored."""
    value = np.asarray(attribute).item() if np.size(attribute) == 1 else attribute
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _known_units(path: Path, units: Mapping[str, str], stated: set[str]) -> dict[str, str]:
    """Return the units that the file states, by what they are of, unless the caller does."""
    found: dict[str, str] = {}
    for name, text in units.items():
        of = {"area_undeformed": "area", "period": "time"}.get(name, name)
        unit = _usual_spelling(text)
        if not unit or of in stated:
            continue
        if unit not in FACTORS[of]:
            raise InputError(
                f"{path}: {name} has the unknown unit {text!r}; known are {list(FACTORS[of])}. "
                f"Say which it is, units={{'{of}': …}} (--units {of}=…), or units='cgs' "
                "(--units cgs) if all are CGS units."
            )
        if found.setdefault(of, unit) != unit:
            raise InputError(f"{path}: {name} is in {unit}, but there is also {found[of]}.")
    return found


def _usual_spelling(unit: str) -> str:
    """Return ``cm^3/s`` for ``cm3/s``, ``cm³/s`` or ``cm**3 / s``, and ``mL/s`` for ``ml/s``."""
    plain = "".join(unit.split()).replace("²", "2").replace("³", "3").replace("**", "^")
    return re.sub(r"\b(m?)l\b", r"\1L", re.sub(r"(?<=[a-z])(?=\d)", "^", plain))


def _vessels(
    path: Path,
    arrays: Mapping[str, npt.NDArray[Any]],
    labels: Mapping[str, npt.NDArray[Any]],
    units: Mapping[str, str],
) -> list[VesselResults]:
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            raise InputError(f"{path}: {name} holds {array.dtype}, not numbers.")
    fields = {name: arrays[name].astype(np.float64) for name in NAMES}
    for name, dimensions in (*((name, 2) for name in VARIABLES), ("area_undeformed", 1)):
        if fields[name].ndim == dimensions:
            fields[name] = fields[name][np.newaxis]
    count = len(fields["flow"]) if fields["flow"].ndim == 3 else 0
    for name in (*VARIABLES, "area_undeformed"):
        if fields[name].ndim != (2 if name == "area_undeformed" else 3) or (
            len(fields[name]) != count
        ):
            raise InputError(
                f"{path}: {name} has the shape {arrays[name].shape}; it must be "
                f"{'(case, z)' if name == 'area_undeformed' else '(case, time, z)'}, for as many "
                "cases as flow has, without the case for a single one."
            )
    period = arrays.get("period")
    if period is not None and period.size != 1:
        raise InputError(f"{path}: period must be one number, it has the shape {period.shape}.")
    for name, column in labels.items():
        if column.shape != (count,):
            raise InputError(f"{path}: labels/{name} has the shape {column.shape}, not ({count},).")
    for name in ("time", "z"):
        if fields[name].ndim != 1:
            raise InputError(f"{path}: {name} has the shape {fields[name].shape}, not one axis.")
    vessels = []
    for i in range(count):
        vessels.append(
            VesselResults(
                f"{path}, case {i}" if count > 1 else str(path),
                fields["flow"][i],
                fields["area"][i],
                fields["pressure"][i],
                fields["area_undeformed"][i],
                fields["time"],
                fields["z"],
                labels={name: column[i] for name, column in labels.items()},
                units=units,
                period=None if period is None else float(period.item()),
            )
        )
    return vessels
