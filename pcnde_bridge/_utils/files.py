"""Files: whether they are there, writing them atomically; checksums of arrays."""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import json
import os
import secrets
import shutil
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcnde_bridge.errors import (
    DataNotFoundError,
    FileError,
    PCNDEError,
)


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file so that it appears whole or not at all.

    Yields the path of an empty temporary file in the folder of ``path`` and with
    its suffix. When the block ends well, the temporary file replaces ``path``;
    when it raises, the temporary file is removed and ``path`` stays as it was.
    A symbolic link is followed: the file that it points to is replaced.

    Parameters
    ----------
    path : str or path-like
        The file to write.

    Yields
    ------
    pathlib.Path
        The temporary file, to be opened and closed inside the block.

    Raises
    ------
    FileError
        When the folder does not exist or cannot be written to, when ``path`` is
        a folder, or when the disk is full.

    Examples
    --------
    >>> with atomic_write("result.txt") as temporary:  # doctest: +SKIP
    ...     temporary.write_text("42")
    """
    target, temporary = _places(path)
    try:
        _create(temporary)
        yield temporary
        _flush(temporary)
        temporary.replace(target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        # The package's own errors can be OSErrors too; they already say what is wrong.
        if isinstance(error, OSError) and not isinstance(error, PCNDEError):
            raise FileError(f"cannot write {str(path)!r}: {_reason(error, target)}") from error
        raise


def write_json(path: str | os.PathLike[str], data: Any, indent: int | None = 1) -> None:
    """Write a JSON file, whole or not at all.

    Parameters
    ----------
    path : str or path-like
        The file to write.
    data : object
        Whatever JSON can hold.
    indent : int or None
        Spaces of each level; None puts everything into one line.

    Raises
    ------
    FileError
        As :func:`atomic_write`.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(data, indent=indent) + "\n", encoding="utf-8")


def check_writable(path: str | os.PathLike[str], size: int = 0) -> None:
    """Raise if a file could not be written: to be called before long work.

    Parameters
    ----------
    path : str or path-like
        The file that will be written; it is not touched.
    size : int
        Bytes that must be free on its disk.

    Raises
    ------
    FileError
        As :func:`atomic_write`, or when too little space is free.
    """
    target, temporary = _places(path)
    try:
        _create(temporary)
        temporary.unlink()
        free = shutil.disk_usage(target.parent).free
    except OSError as error:
        raise FileError(f"cannot write {str(path)!r}: {_reason(error, target)}") from error
    if free < size:
        raise FileError(
            f"cannot write {str(path)!r}: about {size / 1e6:.1f} MB are needed, and "
            f"{free / 1e6:.1f} MB are free on the disk; free some space or choose another folder"
        )


def remove_leftovers(path: str | os.PathLike[str]) -> None:
    """Remove temporary files of a process that was killed while it wrote a file.

    Only for files that no other process may be writing.
    """
    target = Path(path).resolve()
    pattern = f".{glob.escape(target.name)}.{'[0-9a-f]' * 8}{glob.escape(target.suffix)}"
    for temporary in target.parent.glob(pattern):
        with contextlib.suppress(OSError):
            temporary.unlink()


def _places(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Return the file that a path means, and a temporary one beside it, or raise."""
    target = Path(path).resolve()
    if not target.parent.is_dir():
        raise FileError(
            f"cannot write {str(path)!r}: the folder {str(target.parent)!r} does not exist; "
            "create it first"
        )
    if target.is_dir():
        raise FileError(f"cannot write {str(path)!r}: it is a folder; give a file name")
    name = f".{target.name}.{secrets.token_hex(4)}{target.suffix}"
    return target, target.with_name(name)


def _create(path: Path) -> None:
    """Make an empty file; not by tempfile.mkstemp, whose files only their owner may read."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))


def _flush(path: Path) -> None:
    """Have the operating system put a file's contents on the disk."""
    with path.open("rb+") as handle:
        os.fsync(handle.fileno())


def _reason(error: OSError, target: Path) -> str:
    """Say in words why a file could not be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; free some space or choose another folder"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"no permission to write in {str(target.parent)!r}; choose another folder"
    # Not what h5py adds, which fills lines with addresses.
    return os.strerror(error.errno) if error.errno else str(error)


# What is read is uncompressed or little compressed; deflate packs zeros a thousandfold.
_UNPACKED, _TIMES = 1 << 28, 100


def as_paths(paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Return one path, or several, as a list."""
    return [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]


def check_file(path: Path, what: str) -> None:
    """Raise if there is no file to read; ``what`` it would be, as "a .vtp file".

    Raises
    ------
    FileError
        If the path is a folder.
    DataNotFoundError
        If there is nothing.
    """
    if path.is_dir():
        raise FileError(f"{path} is a folder, not {what}.")
    if not path.is_file():
        raise DataNotFoundError(f"There is no file {path}; check the path.")


def make_folder(folder: Path) -> None:
    """Make a folder, and those that hold it, unless it is there.

    Raises
    ------
    FileError
        If it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"Cannot make the folder {folder}: {error}.") from error


def check_claim(claimed: int, stored: int) -> None:
    """Refuse contents that are much larger than the file that holds them.

    Parameters
    ----------
    claimed : int
        Bytes that the contents would take in memory.
    stored : int
        Bytes of the file.

    Raises
    ------
    RuntimeError
        If they are more than 256 MiB and more than a hundred times the file.
    """
    if claimed > max(_UNPACKED, _TIMES * stored):
        raise RuntimeError(f"it claims {claimed} bytes in a file of {stored}")


def check_members(archive: zipfile.ZipFile, stored: int) -> None:
    """Refuse archives that unpack into far more than they are, or out of their folder.

    Parameters
    ----------
    archive : zipfile.ZipFile
        Open.
    stored : int
        Bytes of its file.

    Raises
    ------
    RuntimeError
        If it is such an archive.
    """
    for name in archive.namelist():
        if name.startswith(("/", "\\")) or ".." in name.replace("\\", "/").split("/"):
            raise RuntimeError(f"its member {name!r} leads out of it")
    check_claim(sum(member.file_size for member in archive.infolist()), stored)


def sha256_arrays(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return the SHA-256 checksum of named arrays, as 64 hexadecimal digits.

    Names, their order, shapes, kinds and every value count. The byte order and
    the memory layout do not, so the result is the same on every machine.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Numbers, booleans or text; arrays of Python objects are not allowed.

    Returns
    -------
    str
        The checksum.
    """
    digest = hashlib.sha256()
    for name, array in arrays.items():
        if array.dtype.hasobject:
            raise TypeError(f"array {name!r} holds Python objects; it has no checksum")
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        digest.update(f"{name}|{little.dtype.str}|{array.shape}|".encode())
        digest.update(little.tobytes() if little.dtype.kind == "U" else little.data)
    return digest.hexdigest()
