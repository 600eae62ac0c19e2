"""Files of a data set, ``.npz`` or HDF5: its arrays by name, and the version of the format."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray, StrPath
from pcnde_bridge._utils.archive import check_format, stated_facts
from pcnde_bridge._utils.files import Budget, atomic_write, check_members, reading
from pcnde_bridge._utils.hdf5 import create_dataset, read_dataset
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.data.variables import FIELDS, UNITS, VARIABLES
from pcnde_bridge.errors import FileError

FORMAT = "pcnde-cases"
FORMAT_VERSION = 1

SUFFIXES = (".npz", ".h5", ".hdf5")


def write_cases(path: StrPath, contents: Mapping[str, AnyArray], fingerprint: str) -> None:
    """Write the arrays of a data set atomically.

    Raises
    ------
    FileError
        If the ending of the name is unknown or the file cannot be written.
    """
    suffix = _suffix(path)
    header = _header(fingerprint)
    with atomic_write(path) as temporary:
        if suffix == ".npz":
            arrays: dict[str, Any] = {**header, **contents}
            np.savez(temporary, **arrays)
        else:
            _write_h5(temporary, header, contents)


def create_cases(path: StrPath, contents: Mapping[str, AnyArray | tuple[int, ...]]) -> None:
    """Create an HDF5 file of a data set whose arrays are written later.

    A shape in place of an array is that of a data set that
    :func:`pcnde_bridge._utils.hdf5.create_dataset` creates.  The fingerprint is empty: the file
    cannot be loaded before :func:`pcnde_bridge.data.cases.sign_cases`.
    """
    _write_h5(Path(path), _header("-" * 64), contents)


def write_fingerprint(path: StrPath, fingerprint: str) -> None:
    """Write the fingerprint into a file of :func:`create_cases`."""
    import h5py

    with h5py.File(path, "r+") as file:
        file.attrs["fingerprint"] = np.bytes_(fingerprint)


def read_cases(path: StrPath) -> dict[str, AnyArray]:
    """Read the arrays written by :func:`write_cases`, and the ``fingerprint``, unchecked.

    Raises
    ------
    DataNotFoundError
        If there is no such file.
    FileError
        If the file is truncated, damaged, foreign, incomplete, or of a newer version.
    """
    suffix = _suffix(path)
    kind, read = (".npz", _read_npz) if suffix == ".npz" else ("HDF5", _read_h5)
    with reading(path, f"an {kind} file that Cases.save wrote"):
        contents = read(Path(path))
    required = {*UNITS}.difference(FIELDS).union(VARIABLES)
    keys = *(name for name in UNITS if name in required), "period", "fingerprint"
    absent = [key for key in keys if key not in contents]
    if absent:
        raise FileError(f"{path} is incomplete: it lacks {listed(absent)}; save it again")
    return contents


def _header(fingerprint: str) -> dict[str, Any]:
    return {"format": FORMAT, "format_version": FORMAT_VERSION, "fingerprint": fingerprint}


def _check_header(path: Path, header: Mapping[str, Any]) -> None:
    """Refuse files of other programs and of newer versions of this one."""
    names = [name for name in ("format", "format_version") if name in header]
    facts = {name: np.asarray(header[name]).item() for name in names}
    check_format(path, facts, FORMAT, FORMAT_VERSION, "data set")


def _suffix(path: StrPath) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise FileError(f"the name {str(path)!r} must end in one of {', '.join(SUFFIXES)}")
    return suffix


def _read_npz(path: Path) -> dict[str, AnyArray]:
    with np.load(path, allow_pickle=False) as archive:
        check_members(archive.zip, path.stat().st_size)
        _check_header(path, stated_facts(archive))
        contents = dict(archive)
    # Numbers become 8 bytes each.
    Budget(path.stat().st_size).claim(sum(8 * values.size for values in contents.values()))
    return contents


def _write_h5(
    path: Path,
    header: Mapping[str, str | int],
    contents: Mapping[str, AnyArray | tuple[int, ...]],
) -> None:
    import h5py

    # This generation of the format protects its structure by checksums.  Text of fixed
    # length avoids the one part without checksums, where a damaged byte can hang the reader.
    with h5py.File(path, "w", libver=("v108", "v110")) as file:
        for name, value in header.items():
            file.attrs[name] = np.bytes_(value) if isinstance(value, str) else value
        file.create_group("labels", track_order=True)
        for name, values in contents.items():
            if isinstance(values, tuple):
                create_dataset(file, name, values)
            else:
                file[name] = _h5_text(values) if values.dtype.kind == "U" else values
        axes = {**dict.fromkeys(FIELDS, "case, time, z"), "area_undeformed": "case, z"}
        for key, texts in (("units", {**UNITS, "period": "s"}), ("axes", axes)):
            for name in texts.keys() & contents.keys():
                file[name].attrs[key] = np.bytes_(texts[name])


def _h5_text(values: AnyArray) -> AnyArray:
    """Return text as UTF-8 of fixed length."""
    import h5py

    encoded = np.char.encode(values, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))


def _read_h5(path: Path) -> dict[str, AnyArray]:
    import h5py

    with h5py.File(path, "r") as file:
        header = {
            key: value.decode() if isinstance(value, bytes) else value
            for key, value in file.attrs.items()
        }
        _check_header(path, header)
        names = [*file, *(f"labels/{name}" for name in file["labels"])]
        budget = Budget(path.stat().st_size)
        found = {name: read_dataset(file, name, budget) for name in names}
        contents = {name: values for name, values in found.items() if values is not None}
        if "fingerprint" in header:
            contents["fingerprint"] = np.array(header["fingerprint"])
    return contents
