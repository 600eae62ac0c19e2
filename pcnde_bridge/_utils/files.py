"""Reading files with clear errors, and writing them atomically."""

from __future__ import annotations

import contextlib
import errno
import glob
import json
import os
import secrets
import shutil
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcnde_bridge.errors import DataNotFoundError, FileError, InputError, PCNDEError

if TYPE_CHECKING:
    import pandas as pd

    from pcnde_bridge._typing import StrPath

# Uncompressed or lightly compressed contents are expected; deflate packs zeros a thousandfold.
# Contents are copied several times on their way into a data set.
_LARGEST_UNPACKED, _LARGEST_RATIO = 3 << 23, 4


@contextlib.contextmanager
def atomic_write(path: StrPath) -> Iterator[Path]:
    """Write a file so that it appears complete or not at all.

    The temporary file replaces ``path`` when the block ends without an error; otherwise it
    is removed and ``path`` remains as it was.  A symbolic link is followed: the file that
    it points to is replaced.

    Parameters
    ----------
    path : path-like
        The file to write.

    Yields
    ------
    pathlib.Path
        An empty temporary file in the same folder and with the same suffix, to be opened
        and closed inside the block.

    Raises
    ------
    FileError
        If the folder does not exist or cannot be written to, if ``path`` is a folder,
        or if the disk is full.

    Examples
    --------
    >>> with atomic_write("result.txt") as temporary:  # doctest: +SKIP
    ...     temporary.write_text("42")
    """
    with _temporary_beside(path) as (target, temporary):
        yield temporary
        with temporary.open("rb+") as handle:
            os.fsync(handle.fileno())
        temporary.replace(target)


def read_json(path: StrPath, what: str) -> dict[str, Any]:
    """Read a JSON object from a file; ``what`` it holds is such as "settings".

    Raises
    ------
    DataNotFoundError
        If there is no such file.
    FileError
        If the file is not JSON.
    InputError
        If it holds something else than an object.
    """
    with reading(path, f"a readable JSON file of {what}"):
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    if not isinstance(found, dict):
        raise InputError(f"{path} must hold a JSON object of {what}.")
    return found


def write_json(path: StrPath, data: Any, indent: int | None = 1) -> None:
    """Write a JSON file atomically.

    Parameters
    ----------
    path : path-like
        The file to write.
    data : object
        Data that JSON can represent.
    indent : int or None
        Spaces per level; None writes a single line.

    Raises
    ------
    FileError
        If the file cannot be written, see :func:`atomic_write`.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(data, indent=indent) + "\n", encoding="utf-8")


def write_csv(path: StrPath, table: pd.DataFrame, **options: Any) -> None:
    """Write a table atomically, compressed if the file's ending says so.

    Parameters
    ----------
    path : path-like
        The file to write.
    table : DataFrame
        The table.
    **options
        Further arguments of :meth:`pandas.DataFrame.to_csv`.

    Raises
    ------
    FileError
        If the file cannot be written, see :func:`atomic_write`.
    """
    with atomic_write(path) as temporary:
        table.to_csv(temporary, **options)


def check_writable(path: StrPath, size: int = 0) -> None:
    """Raise if a file could not be written; to be called before a long computation.

    Parameters
    ----------
    path : path-like
        The file that will be written; it is not touched.
    size : int
        Bytes that must be free on its disk.

    Raises
    ------
    FileError
        If the file cannot be written, or too little space is free.
    """
    with _temporary_beside(path) as (target, _):
        free = shutil.disk_usage(target.parent).free
        if free < size:
            raise OSError(
                f"about {size / 1e6:.1f} MB are needed, and {free / 1e6:.1f} MB are free on the "
                "disk; free some space or choose another folder"
            )


def remove_leftovers(path: StrPath) -> None:
    """Remove temporary files of a process that was killed while it wrote a file.

    Use it only for files that no other process may be writing.
    """
    target = Path(path).resolve()
    pattern = f".{glob.escape(target.name)}.{'[0-9a-f]' * 8}{glob.escape(target.suffix)}"
    for temporary in target.parent.glob(pattern):
        with contextlib.suppress(OSError):
            temporary.unlink()


def make_folder(folder: Path) -> None:
    """Create a folder and its parents where they are missing.

    Raises
    ------
    FileError
        If it cannot be created, or is a file.
    """
    if folder.is_file():
        raise FileError(f"{folder} is a file; give a folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"Cannot create the folder {folder}: {error}.") from error


@contextlib.contextmanager
def _temporary_beside(path: StrPath) -> Iterator[tuple[Path, Path]]:
    """Yield the file that a path leads to, and a new file beside it that is removed at the end.

    An ``OSError`` inside the block becomes a ``FileError`` that explains it.
    """
    target = Path(path).resolve()
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}{target.suffix}")
    try:
        if not target.parent.is_dir():
            raise OSError(f"the folder {str(target.parent)!r} does not exist; create it first")
        if target.is_dir():
            raise OSError("it is a folder; give a file name")
        temporary.touch(exist_ok=False)  # with the usual permissions, unlike tempfile's
        yield target, temporary
    except PCNDEError:  # which can be an OSError, too
        raise
    except OSError as error:
        # h5py adds lines of addresses to the message.
        reason = os.strerror(error.errno) if error.errno else str(error)
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            reason = "the disk is full; free some space or choose another folder"
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            reason = f"no permission to write in {str(target.parent)!r}; choose another folder"
        raise FileError(f"cannot write {str(path)!r}: {reason}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextlib.contextmanager
def reading(path: StrPath, what: str) -> Iterator[None]:
    """Turn any failure to read a file into a ``FileError`` that names the file.

    Damaged bytes can make a reader raise almost any exception; this is the one place
    that catches them.  Errors of this package pass unchanged.

    Parameters
    ----------
    path : path-like
        The file that is read inside the block.
    what : str
        What the file should be, with its article: ``"an HDF5 file"``.

    Raises
    ------
    DataNotFoundError
        If there is no such file.
    FileError
        If it is a folder, not permitted to be read, damaged or something else.
    """
    check_file(Path(path), what)
    try:
        yield
    except PCNDEError:
        raise
    except PermissionError as error:
        raise FileError(f"No permission to read {path}.") from error
    except Exception as error:
        raise FileError(
            f"{path} is not {what}, or it is truncated or damaged ({error}). "
            "Check the file, or copy or create it again."
        ) from error


def check_file(path: Path, what: str) -> None:
    """Raise if there is no file to read; ``what`` it should be is such as "a .vtp file".

    Raises
    ------
    DataNotFoundError
        If the path does not exist.
    FileError
        If the path is a folder.
    """
    if path.is_dir():
        raise FileError(f"{path} is a folder, not {what}.")
    if not path.exists():  # a pipe is no regular file
        raise DataNotFoundError(f"There is no file {path}; check the path.")


def as_paths(paths: StrPath | Iterable[StrPath]) -> list[Path]:
    """Return one path, or several, as a list."""
    return [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]


class Budget:
    """Memory that the contents of one file may take: 24 MiB, or four times the file if larger.

    Parameters
    ----------
    stored : int
        Bytes of the file.
    """

    def __init__(self, stored: int) -> None:
        self._stored, self._claimed = stored, 0

    def claim(self, count: int) -> None:
        """Add a number of bytes, before memory is allocated for them.

        Raises
        ------
        ValueError
            If all claims together are too large for the file.
        """
        self._claimed += count
        if self._claimed > max(_LARGEST_UNPACKED, _LARGEST_RATIO * self._stored):
            raise ValueError(f"it claims {self._claimed} bytes in a file of {self._stored}")


def check_members(archive: zipfile.ZipFile, stored: int) -> None:
    """Refuse a zip archive that unpacks to far more than its size, or outside its folder.

    Parameters
    ----------
    archive : zipfile.ZipFile
        The open archive.
    stored : int
        Bytes of its file.

    Raises
    ------
    ValueError
        If a member's name leads out of the archive, or its contents are too large.
    """
    for name in archive.namelist():
        if name.startswith(("/", "\\")) or ".." in name.replace("\\", "/").split("/"):
            raise ValueError(f"its member {name!r} leads out of it")
    Budget(stored).claim(sum(member.file_size for member in archive.infolist()))


def cache_folder(cache: StrPath | None) -> Path:
    """Return the given folder, else ``PCNDE_CACHE``, else the user's cache folder."""
    chosen = cache or os.environ.get("PCNDE_CACHE")
    if chosen:
        return Path(chosen).expanduser()
    import pooch

    return Path(pooch.os_cache("pcnde_bridge"))
