"""HDF5 files of other programs with arrays of flow, area, pressure and wall shear stress."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from pcnde_bridge._utils.archive import with_prefix
from pcnde_bridge._utils.files import Budget, as_paths, reading
from pcnde_bridge._utils.hdf5 import read_dataset
from pcnde_bridge._utils.validation import listed, naming
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.files import FORMAT
from pcnde_bridge.data.units import (
    FACTORS,
    QUANTITIES,
    option_of,
    stated_units,
    text_of,
    usual_spelling,
)
from pcnde_bridge.data.variables import FIELDS, UNITS
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, to_cases
from pcnde_bridge.io.vessel_results import VesselResults

_AXES = {
    **dict.fromkeys(FIELDS, ("case", "time", "z")),
    "area_undeformed": ("case", "z"),
    "time": ("time",),
    "z": ("z",),
    "period": (),
}
_REQUIRED = tuple(name for name in UNITS if name != "wall_shear_stress")
_LABELS = ("geometry", "waveform")  # also read beside the other arrays


def read_hdf5(
    paths: Paths, *, names: Mapping[str, str] | None = None, **options: Unpack[CaseOptions]
) -> Cases:
    """Read HDF5 files.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        Files with the arrays ``flow``, ``area`` and ``pressure`` of shape (time, z) or
        (case, time, z), ``area_undeformed`` of shape (z,) or (case, z), ``time`` and
        ``z``; optionally ``wall_shear_stress``, ``period`` and the labels ``geometry``,
        ``waveform`` and ``labels/…`` of shape (case,).  The attribute ``units`` of an array
        is used where the option ``units`` does not state a unit.
    names : mapping, optional
        Paths of arrays with other names, ``{"flow": "/results/Q"}``, or of further labels,
        ``{"patient": "/id"}``.
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
    for name, place in places.items():
        if not isinstance(name, str) or not isinstance(place, str):
            raise InputError(f"names has {name!r}: {place!r}; give the path of an array, a text.")
    stated = stated_units(options.get("units"))
    chosen, vessels, ours = as_paths(paths), [], []
    for path in chosen:
        with naming(path):
            found, units, is_ours = _read(path, places)
            vessels += _vessels(path, found, _known_units(units, stated))
            ours += [path] * is_ours
    cases = to_cases(vessels, **options)
    for path in ours:
        Cases.load(path)  # compares the checksum
    return cases


def _read(
    path: Path, places: Mapping[str, str]
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str], bool]:
    """Return arrays and units by name, and whether this package wrote the file."""
    import h5py

    with reading(path, "an HDF5 file"), h5py.File(path, "r") as file:
        group = file.get("labels")
        usual = dict(zip(_AXES, _AXES, strict=True)) | {f"labels/{n}": n for n in _LABELS}
        for name in group if isinstance(group, h5py.Group) else ():
            usual[f"labels/{name}"] = f"labels/{name}"
        stated = {n if n in _AXES else f"labels/{n}": place for n, place in places.items()}
        where, budget = usual | stated, Budget(path.stat().st_size)
        found = {
            name: values
            for name, place in where.items()
            if (values := read_dataset(file, place, budget)) is not None
        }
        if lost := [place for name, place in stated.items() if name not in found]:
            raise InputError(f"it has no array {listed(lost)} (names=, --names); it has {[*file]}.")
        units = {name: _text(file[where[name]].attrs.get("units", "")) for name in found}
        units = {name: unit for name, unit in units.items() if name in _AXES}
        return found, units, _text(file.attrs.get("format", "")) == FORMAT


def _text(attribute: Any) -> str:
    """Return an attribute that is a text, or an array of one, however it is stored."""
    value = np.asarray(attribute).item() if np.size(attribute) == 1 else attribute
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _known_units(units: Mapping[str, str], stated: Mapping[str, str]) -> dict[str, str]:
    """Return the units in the file by quantity, except those that the caller states."""
    found: dict[str, str] = {}
    for name, text in units.items():
        quantity = QUANTITIES.get(name, name)
        unit = usual_spelling(text)
        if not unit or quantity in stated:
            continue
        if quantity == "area" and unit in FACTORS["z"]:
            raise InputError(f"{name} is in {unit}: pass {option_of(stated, quantity, unit)}.")
        if unit not in FACTORS[quantity]:
            raise InputError(
                f"{name} has the unknown unit {text!r}; known are {list(FACTORS[quantity])}. State "
                f"it, units= (--units {text_of({**stated, quantity: '…'})}), or that all others "
                f"are CGS units (--units {text_of(stated, 'cgs')})."
            )
        if found.setdefault(quantity, unit) != unit:
            raise InputError(f"{name} is in {unit}, but there is also {found[quantity]}.")
        if quantity == "area":
            found["shape"] = "area"
    return found


def _vessels(
    path: Path, arrays: Mapping[str, npt.NDArray[Any]], units: Mapping[str, str]
) -> list[VesselResults]:
    """Return the results of each case from the arrays of a file."""
    if absent := [name for name in _REQUIRED if name not in arrays]:
        raise InputError(f"it lacks the data sets {absent}; name them (--names {absent[0]}=path).")
    fields: dict[str, Any] = {}
    for name, array in arrays.items():
        if not name.startswith("labels/") and array.dtype.kind not in "iuf":
            raise InputError(f"{name} holds {array.dtype}, not numbers.")
        axes = _AXES.get(name, ("case",))
        values = array.squeeze() if name == "period" else array
        by_case = "case" in axes
        if by_case and values.ndim == len(axes) - 1:
            values = values[np.newaxis]
        if values.ndim != len(axes) or (by_case and len(values) != len(fields.get("flow", values))):
            raise InputError(
                f"{name} has the shape {array.shape}; it must be ({', '.join(axes)}), with as many "
                "cases as flow. The axis of a single case can be left out."
            )
        fields[name] = values.astype(np.float64) if name in _AXES else values
    labels = with_prefix("labels/", fields)
    count = len(fields["flow"])
    return [
        VesselResults(
            f"{path}, case {i}" if count > 1 else str(path),
            **{name: fields[name][i] for name in (*FIELDS, "area_undeformed") if name in fields},
            time=fields["time"],
            z=fields["z"],
            labels={name: column[i] for name, column in labels.items()},
            units=units,
            period=float(fields["period"]) if "period" in fields else None,
        )
        for i in range(count)
    ]
