"""Single-file archives of named arrays and JSON facts, for models and checkpoints; checksums.

An archive is a ``.npz`` file without pickled objects, whatever the ending of its name.
"""

import contextlib
import hashlib
import json
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray, StrPath
from pcnde_bridge._utils.files import atomic_write, check_members, reading
from pcnde_bridge._utils.hdf5 import release
from pcnde_bridge.errors import FileError

_HEADER, _NAMES = "header", "arrays"
_LARGEST_HEADER = 1 << 24
_AT_ONCE = 1 << 26  # bytes of an array that a checksum reads at once
_MODEL_KINDS = {"pcnde-model", "pcnde-ensemble"}  # load_model reads both
_NAMES_OF_KINDS = {"pcnde-cases": "a data set", None: "something else"}
_SIGNATURES = {b"PK": "", b"\x89HDF": "an HDF5"}  # first bytes of .npz and other files


def write_archive(
    path: StrPath, kind: str, version: int, facts: Mapping[str, Any], arrays: Mapping[str, AnyArray]
) -> None:
    """Write an archive atomically.

    Parameters
    ----------
    path : path-like
        File to write; an existing file is replaced.
    kind, version : str, int
        Format of the file, checked by :func:`read_archive`.
    facts : mapping
        Data that JSON can represent.
    arrays : mapping of str to array
        Numbers or text.

    Raises
    ------
    FileError
        If the file cannot be written.
    TypeError
        If an array holds Python objects.
    """
    if any(array.dtype.hasobject for array in arrays.values()):
        raise TypeError("an archive holds no Python objects")
    names = {"format": kind, "format_version": version, _NAMES: list(arrays)}
    header = json.dumps({**names, **facts})
    with atomic_write(path) as temporary, temporary.open("wb") as handle:
        named: dict[str, Any] = {_HEADER: np.array(header), **arrays}
        np.savez(handle, **named)


def read_archive(
    path: StrPath, kind: str, version: int, what: str
) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Read an archive.

    Parameters
    ----------
    path : path-like
        File to read.
    kind, version : str, int
        Format, and its newest version, that the caller understands.
    what : str
        Kind of file in messages: ``"model"``, ``"checkpoint"``.

    Returns
    -------
    facts : dict
        The JSON part.
    arrays : dict of str to array
        The arrays.

    Raises
    ------
    FileError
        If the file is missing, damaged, of another kind, or of a newer format.
    """
    with reading(path, f"a pcnde_bridge {what}"), _opened(path, kind, what) as archive:
        facts = stated_facts(archive)
        check_format(path, facts, kind, version, what)
        check_members(archive.zip, Path(path).stat().st_size)
        # A damaged length in an array's own header would end its reading before the checksum
        # is compared, and a damaged table of contents would hide arrays.
        if (damaged := archive.zip.testzip()) is not None:
            raise zipfile.BadZipFile(f"bad checksum of {damaged}")
        arrays = {key: archive[key] for key in archive.files if key != _HEADER}
        if set(arrays) != set(facts.pop(_NAMES, arrays)):
            raise zipfile.BadZipFile("arrays are missing")
    return facts, arrays


def _opened(path: StrPath, kind: str, what: str) -> Any:
    """Open a ``.npz`` file, or raise an error that names the kind of another file."""
    if Path(path).is_file():  # a pipe is read only once
        with Path(path).open("rb") as file:
            first = file.read(4)
        other = next((n for start, n in _SIGNATURES.items() if first.startswith(start)), "no .npz")
        if first and other:
            advice = _advice(path, kind)
            raise FileError(f"{path} is not a pcnde_bridge {what}: it is {other} file.{advice}")
    return np.load(path, allow_pickle=False)


def _advice(path: StrPath, kind: str) -> str:
    """Return how to create a file of a kind from another file."""
    suffix = Path(path).suffix.lower()
    if kind in _MODEL_KINDS and suffix in (".npz", ".h5", ".hdf5"):
        return f" Fit a model first: pcnde fit {path} --preset physics --out model.npz."
    if kind in _MODEL_KINDS:
        return " Pass a model's file, as pcnde fit writes it."
    if kind == "pcnde-cases" and suffix != ".npz":
        return f" Convert it first: pcnde convert {path} --from hdf5 --out cases.h5."
    return ""


@contextlib.contextmanager
def interpreting(where: StrPath, what: str) -> Iterator[None]:
    """Turn errors caused by missing or inconsistent contents into a ``FileError``.

    Parameters
    ----------
    where : path-like
        Name of the file whose facts and arrays are used inside the block.
    what : str
        Kind of file in messages: ``"model"``, ``"checkpoint"``.

    Raises
    ------
    FileError
        If the block raises an error that such contents cause.
    """
    try:
        yield
    except FileError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise FileError(f"{where} is not a complete {what}: {reason}.") from error


def archive_kind(path: StrPath) -> str | None:
    """Return the kind that an archive states, or None if it cannot be read."""
    with contextlib.suppress(Exception), reading(path, "an archive"):
        with np.load(path, allow_pickle=False) as archive:
            kind = stated_facts(archive)["format"]
        return kind if isinstance(kind, str) else None
    return None  # read_archive explains the reason


def stated_facts(archive: Any) -> dict[str, Any]:
    """Return the JSON part of an open archive, or the format that a data set states."""
    # Data sets state their format in arrays of their own.
    stated = [name for name in (_HEADER, "format", "format_version") if name in archive]
    for name in stated:
        if archive.zip.getinfo(f"{name}.npy").file_size > _LARGEST_HEADER:
            raise ValueError("its header is too large")
    if _HEADER not in stated:
        return {name: archive[name].item() for name in stated}
    facts = json.loads(str(archive[_HEADER]))
    if not isinstance(facts, dict):
        raise ValueError("its header is not a JSON object")
    return facts


def check_format(path: StrPath, facts: dict[str, Any], kind: str, version: int, what: str) -> None:
    """Raise unless the facts of a file state its kind, in a version that is known."""
    found = facts.get("format")
    if {kind, found} == _MODEL_KINDS:
        advice = f" Give a file of one {what}; pcnde_bridge.load_model reads either."
        raise FileError(f"{path} is not a pcnde_bridge {what} but a {found!r} file.{advice}")
    if found != kind:
        other = _NAMES_OF_KINDS.get(found, f"a {found!r} file")
        raise FileError(f"{path} is not a pcnde_bridge {what} but {other}.{_advice(path, kind)}")
    found_version = facts.get("format_version")
    if not isinstance(found_version, int) or found_version > version:
        raise FileError(
            f"{path} was written by a newer pcnde_bridge (format {found_version}; this one reads "
            f"up to {version}). Upgrade the package: pip install . in its newer source."
        )


def sha256_arrays(arrays: Mapping[str, AnyArray]) -> str:
    """Return the SHA-256 checksum of named arrays, as 64 hexadecimal digits.

    Names, their order, shapes, kinds and every value count.  Byte order and memory
    layout do not.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Numbers, booleans or text; arrays of Python objects are not allowed.

    Raises
    ------
    TypeError
        If an array holds Python objects.
    """
    digest = hashlib.sha256()
    for name, array in arrays.items():
        if array.dtype.hasobject:
            raise TypeError(f"array {name!r} holds Python objects; it has no checksum")
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        digest.update(f"{name}|{little.dtype.str}|{array.shape}|".encode())
        values = little.reshape(-1).view(np.uint8).data
        for start in range(0, len(values), _AT_ONCE):
            digest.update(values[start : start + _AT_ONCE])
            release(array)
    return digest.hexdigest()


def with_prefix(prefix: str, arrays: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
    """Return the arrays whose names have a prefix, by their names without it."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
