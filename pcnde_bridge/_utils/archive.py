"""One-file archives of named arrays and JSON facts: models and checkpoints.

An archive is a ``.npz`` without pickled objects, whatever its name's ending.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._utils.files import atomic_write, check_members
from pcnde_bridge.errors import FileError

_HEADER, _NAMES = "header", "arrays"
_LARGEST_HEADER = 1 << 24
_EITHER = {"pcnde-model", "pcnde-ensemble"}  # load_model reads them


def write_archive(
    path: str | os.PathLike[str],
    kind: str,
    version: int,
    facts: Mapping[str, Any],
    arrays: Mapping[str, npt.NDArray[Any]],
) -> None:
    """Write an archive atomically.

    Parameters
    ----------
    path : path-like
        File to write; replaced as a whole if it exists.
    kind, version : str, int
        Format of the file, checked by :func:`read_archive`.
    facts : mapping
        Whatever JSON can hold.
    arrays : mapping of str to array
        Numbers or text.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    if any(array.dtype.hasobject for array in arrays.values()):
        raise TypeError("an archive holds no Python objects")
    names = {"format": kind, "format_version": version, _NAMES: list(arrays)}
    header = json.dumps({**names, **facts})
    with atomic_write(path) as temporary, temporary.open("wb") as handle:
        named: dict[str, Any] = {_HEADER: np.array(header), **arrays}
        np.savez(handle, **named)


def read_archive(
    path: str | os.PathLike[str], kind: str, version: int, what: str
) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """Read an archive back.

    Parameters
    ----------
    path : path-like
        File to read.
    kind, version : str, int
        Format, and its newest version, that the caller understands.
    what : str
        What the file should be, for messages: ``"model"``, ``"checkpoint"``.

    Returns
    -------
    facts : dict
        The JSON part.
    arrays : dict of str to array
        The arrays.

    Raises
    ------
    FileError
        If the file is missing, truncated, foreign, or of a newer format.
    """
    name = str(Path(path))
    try:
        with np.load(path, allow_pickle=False) as archive:
            if not hasattr(archive, "files") or _HEADER not in archive.files:
                raise _Foreign
            info = archive.zip.getinfo(f"{_HEADER}.npy")
            if info.file_size > _LARGEST_HEADER:
                raise _Foreign
            check_members(archive.zip, Path(path).stat().st_size)
            facts = json.loads(str(archive[_HEADER]))
            if not isinstance(facts, dict) or facts.get("format") != kind:
                found = facts.get("format") if isinstance(facts, dict) else None
                advice = ""
                if {kind, found} == _EITHER:
                    advice = f" Give a file of one {what}; pcnde_bridge.load_model reads either."
                raise FileError(
                    f"{name} is not a pcnde_bridge {what} but "
                    f"{f'a {found!r} file' if found else 'something else'}.{advice}"
                )
            found_version = facts.get("format_version")
            if not isinstance(found_version, int) or found_version > version:
                raise FileError(
                    f"{name} was written by a newer pcnde_bridge (format {found_version}; this "
                    f"one reads up to {version}). Upgrade the package: "
                    "pip install --upgrade pcnde-bridge."
                )
            # A damaged length in an array's own header would end its reading before the
            # checksum is compared, and a damaged table of contents would hide arrays.
            if (damaged := archive.zip.testzip()) is not None:
                raise zipfile.BadZipFile(f"bad checksum of {damaged}")
            arrays = {key: archive[key] for key in archive.files if key != _HEADER}
            if set(arrays) != set(facts.pop(_NAMES, arrays)):
                raise zipfile.BadZipFile("arrays are missing")
    except FileError:
        raise
    except FileNotFoundError as error:
        raise FileError(f"There is no {what} at {name}.") from error
    except IsADirectoryError as error:
        raise FileError(f"{name} is a folder, not a {what} file.") from error
    except PermissionError as error:
        raise FileError(f"No permission to read {name}.") from error
    except (_Foreign, ValueError, TypeError, AttributeError, OSError, EOFError) as error:
        raise FileError(
            f"{name} is not a pcnde_bridge {what}: it is truncated or foreign."
        ) from error
    except (zipfile.BadZipFile, KeyError, NotImplementedError, RuntimeError, MemoryError) as error:
        raise FileError(f"{name} is damaged: it cannot be read as a {what} ({error}).") from error
    except Exception as error:
        # zlib raises its own errors for damaged members.
        raise FileError(f"{name} is damaged: it cannot be read as a {what} ({error}).") from error
    return facts, arrays


def archive_kind(path: str | os.PathLike[str]) -> str | None:
    """Return the kind that an archive says it is, or None if it is none or cannot be read."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            if archive.zip.getinfo(f"{_HEADER}.npy").file_size > _LARGEST_HEADER:
                return None
            kind = json.loads(str(archive[_HEADER]))["format"]
    except Exception:
        return None  # :func:`read_archive` says what is wrong
    return kind if isinstance(kind, str) else None


class _Foreign(Exception):
    """The file is no archive of this package."""
