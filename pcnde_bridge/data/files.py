"""A data set in a file, ``.npz`` or HDF5: its arrays by name, and who wrote it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcnde_bridge._utils.files import atomic_write, check_members
from pcnde_bridge._utils.hdf5 import read_dataset
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.data.variables import UNITS, VARIABLES
from pcnde_bridge.errors import DataNotFoundError, FileError

FORMAT = "pcnde-cases"
FORMAT_VERSION = 1

_NPZ_SUFFIXES = (".npz",)
_H5_SUFFIXES = (".h5", ".hdf5")
_SUFFIXES = _NPZ_SUFFIXES + _H5_SUFFIXES


def write_cases(
    path: str | os.PathLike[str], contents: Mapping[str, NDArray[Any]], fingerprint: str
) -> None:
    """Write arrays, atomically.

    Raises
    ------
    FileError
        If the name's ending is unknown or the file cannot be written.
    """
    suffix = _suffix(path)
    header: dict[str, str | int] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "fingerprint": fingerprint,
    }
    with atomic_write(path) as temporary:
        if suffix in _NPZ_SUFFIXES:
            with temporary.open("wb") as handle:
                arrays: dict[str, Any] = {**header, **contents}
                np.savez(handle, **arrays)
        else:
            _write_h5(temporary, header, contents)


def read_cases(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read what :func:`write_cases` wrote, with the ``fingerprint``; nothing of it is checked.

    Raises
    ------
    DataNotFoundError
        If there is no such file.
    FileError
        If the file is truncated, damaged, foreign, incomplete, or of a newer version.
    """
    suffix, name = _suffix(path), repr(str(path))
    if not Path(path).is_file():
        raise DataNotFoundError(f"there is no file {name}; check the path")
    read = _read_npz if suffix in _NPZ_SUFFIXES else _read_h5
    try:
        contents = read(Path(path))
    except _Refused as error:
        raise FileError(f"{name} {error}") from error
    except Exception as error:  # damaged bytes can make a reader raise nearly anything
        raise FileError(
            f"{name} is truncated or damaged ({error}); save or copy it again"
        ) from error
    absent = [key for key in (*UNITS, "period", "fingerprint") if key not in contents]
    if absent:
        raise FileError(f"{name} is incomplete: it lacks {listed(absent)}; save it again")
    return contents


class _Refused(Exception):
    """The file is sound, but is none that :func:`read_cases` reads; the message says why."""


def _check_header(header: Mapping[str, Any]) -> None:
    """Refuse files of other programs and of newer versions of this one."""
    if str(header.get("format")) != FORMAT or "format_version" not in header:
        raise _Refused("is not a data set saved by this package; load files that Cases.save wrote")
    version = int(header["format_version"])
    if version > FORMAT_VERSION:
        raise _Refused(
            f"has format version {version}, newer than {FORMAT_VERSION}, the newest that this "
            "version of the package reads; update the package"
        )


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise FileError(
            f"{str(path)!r} must end in one of {', '.join(_SUFFIXES)}, which says the format"
        )
    return suffix


def _read_npz(path: Path) -> dict[str, NDArray[Any]]:
    with path.open("rb") as handle:
        if handle.read(2) != b"PK":
            raise _Refused("is not an .npz file; load files that Cases.save wrote")
    with np.load(path, allow_pickle=False) as archive:
        check_members(archive.zip, path.stat().st_size)
        _check_header(archive)
        return dict(archive)


def _write_h5(
    path: Path, header: Mapping[str, str | int], contents: Mapping[str, NDArray[Any]]
) -> None:
    import h5py

    # This generation of the format guards its structure by checksums. Text of fixed
    # length keeps out of the one part that they do not cover, where a damaged byte
    # can hang the reader.
    with h5py.File(path, "w", libver=("v108", "v110")) as file:
        for name, value in header.items():
            file.attrs[name] = np.bytes_(value) if isinstance(value, str) else value
        file.create_group("labels", track_order=True)
        for name, values in contents.items():
            file[name] = _h5_text(values) if values.dtype.kind == "U" else values
        for name, units in (*UNITS.items(), ("period", "s")):
            file[name].attrs["units"] = np.bytes_(units)
        for name in VARIABLES:
            file[name].attrs["axes"] = np.bytes_("case, time, z")
        file["area_undeformed"].attrs["axes"] = np.bytes_("case, z")


def _h5_text(values: NDArray[Any]) -> NDArray[Any]:
    """Return text as UTF-8 of fixed length."""
    import h5py

    encoded = np.char.encode(values, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))


def _read_h5(path: Path) -> dict[str, NDArray[Any]]:
    import h5py

    with path.open("rb") as handle:
        if handle.read(8) != b"\x89HDF\r\n\x1a\n":
            raise _Refused("is not an HDF5 file; load files that Cases.save wrote")
    with h5py.File(path, "r") as file:
        header = {
            key: value.decode() if isinstance(value, bytes) else value
            for key, value in file.attrs.items()
        }
        _check_header(header)
        names = [*file, *(f"labels/{name}" for name in file["labels"])]
        found = {name: read_dataset(file, name) for name in names}
        contents = {name: values for name, values in found.items() if values is not None}
        if "fingerprint" in header:
            contents["fingerprint"] = np.array(header["fingerprint"])
    return contents
