"""HDF5 files of other programs with arrays of flow, area and pressure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from pcnde_bridge._utils.files import Budget, as_paths, reading
from pcnde_bridge._utils.hdf5 import read_dataset
from pcnde_bridge._utils.validation import naming
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.files import FORMAT
from pcnde_bridge.data.units import FACTORS, stated_units
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, to_cases
from pcnde_bridge.io.vessel_results import VesselResults

_AXES = {
    **dict.fromkeys(VARIABLES, ("case", "time", "z")),
    "area_undeformed": ("case", "z"),
    "time": ("time",),
    "z": ("z",),
}
NAMES = tuple(_AXES)


def read_hdf5(
    paths: Paths, *, names: Mapping[str, str] | None = None, **options: Unpack[CaseOptions]
) -> Cases:
    """Read HDF5 files.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        Files with the arrays ``flow``, ``area`` and ``pressure`` of shape (time, z) or
        (case, time, z), ``area_undeformed`` of shape (z,) or (case, z), ``time`` and
        ``z``; optionally ``period`` and ``labels/…``.  The attribute ``units`` of an array
        is used where the option ``units`` does not state a unit.
    names : mapping, optional
        Paths of arrays with other names: ``{"flow": "/results/Q"}``.
    **options
        ``period``, ``units``, ``flip``, ``time_points``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.to_cases`.

    Returns
    -------
    Cases
        The cases in the order of the files and of the arrays.

    Raises
    ------
    DataNotFoundError
        If a file does not exist.
    FileError
        If a file is damaged or not HDF5.
    InputError
        If arrays are missing, or units, flow or time steps are ambiguous.
    """
    places = dict(names or {})
    if unknown := sorted(set(places) - set(NAMES)):
        raise InputError(f"names has {unknown}; it can name {list(NAMES)}.")
    for name, place in places.items():
        if not isinstance(place, str):
            raise InputError(f"names[{name!r}] must be the path of a data set, got {place!r}.")
    stated = set(stated_units(options.get("units")))
    vessels: list[VesselResults] = []
    for path in as_paths(paths):
        with naming(path):
            vessels += _read(path, places, stated)
    cases = to_cases(vessels, **options)
    for path in as_paths(paths):
        _check_own(path)
    return cases


def _read(path: Path, places: Mapping[str, str], stated: set[str]) -> list[VesselResults]:
    import h5py

    arrays: dict[str, npt.NDArray[Any]] = {}
    labels: dict[str, npt.NDArray[Any]] = {}
    units: dict[str, str] = {}
    with reading(path, "an HDF5 file"), h5py.File(path, "r") as file:
        budget = Budget(path.stat().st_size)
        for name in (*NAMES, "period"):
            place = places.get(name, name)
            if (values := read_dataset(file, place, budget)) is not None:
                arrays[name] = values
                units[name] = _text(file[place].attrs.get("units", ""))
        group = file.get("labels")
        for name in group if isinstance(group, h5py.Group) else ():
            if (values := read_dataset(file, f"labels/{name}", budget)) is not None:
                labels[name] = values
    if absent := [name for name in NAMES if name not in arrays]:
        raise InputError(
            f"it lacks the data sets {absent}; name them, names={{'{absent[0]}': 'path'}} (--names "
            f"{absent[0]}=path)."
        )
    return _vessels(path, arrays, labels, _known_units(units, stated))


def _check_own(path: Path) -> None:
    """Compare the checksum of a file that this package wrote."""
    import h5py

    with h5py.File(path, "r") as file:
        ours = _text(file.attrs.get("format", "")) == FORMAT
    if ours:
        Cases.load(path)


def _text(attribute: Any) -> str:
    """Return an attribute that is a text, or an array of one, however it is stored."""
    value = np.asarray(attribute).item() if np.size(attribute) == 1 else attribute
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _known_units(units: Mapping[str, str], stated: set[str]) -> dict[str, str]:
    """Return the units in the file by quantity, except those that the caller states."""
    found: dict[str, str] = {}
    for name, text in units.items():
        quantity = {"area_undeformed": "area", "period": "time"}.get(name, name)
        unit = _usual_spelling(text)
        if not unit or quantity in stated:
            continue
        if unit not in FACTORS[quantity]:
            raise InputError(
                f"{name} has the unknown unit {text!r}; known are {list(FACTORS[quantity])}. State "
                f"it, units={{'{quantity}': …}} (--units {quantity}=…), or units='cgs' (--units "
                "cgs) if all are CGS units."
            )
        if found.setdefault(quantity, unit) != unit:
            raise InputError(f"{name} is in {unit}, but there is also {found[quantity]}.")
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
    """Return the results of each case from the arrays of a file."""
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            raise InputError(f"{name} holds {array.dtype}, not numbers.")
    fields = {name: arrays[name].astype(np.float64) for name in NAMES}
    for name, axes in _AXES.items():
        if axes[0] == "case" and fields[name].ndim == len(axes) - 1:
            fields[name] = fields[name][np.newaxis]
    count = len(fields["flow"]) if fields["flow"].ndim == 3 else 0
    for name, axes in _AXES.items():
        values = fields[name]
        if values.ndim != len(axes) or (axes[0] == "case" and len(values) != count):
            raise InputError(
                f"{name} has the shape {arrays[name].shape}; it must be ({', '.join(axes)}), with "
                "as many cases as flow. The axis of a single case can be left out."
            )
    period = arrays.get("period")
    if period is not None and period.size != 1:
        raise InputError(f"period must be one number, it has the shape {period.shape}.")
    for name, column in labels.items():
        if column.shape != (count,):
            raise InputError(f"labels/{name} has the shape {column.shape}, not ({count},).")
    return [
        VesselResults(
            f"{path}, case {i}" if count > 1 else str(path),
            **{name: fields[name][i] for name in (*VARIABLES, "area_undeformed")},
            time=fields["time"],
            z=fields["z"],
            labels={name: column[i] for name, column in labels.items()},
            units=units,
            period=None if period is None else float(period.item()),
        )
        for i in range(count)
    ]
