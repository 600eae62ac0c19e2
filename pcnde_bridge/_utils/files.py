"""Reading files with clear errors, and writing them atomically."""

from __future__ import annotations

import contextlib
import errno
import glob
import json
import os
import re
import secrets
import shutil
import signal
import stat
import threading
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import filelock

from pcnde_bridge.errors import DataNotFoundError, FileError, InputError, PCNDEError

if TYPE_CHECKING:
    import pandas as pd

    from pcnde_bridge._typing import StrPath

# Uncompressed or lightly compressed contents are expected; deflate packs zeros a thousandfold.
# Contents are copied several times on their way into a data set.
_LARGEST_UNPACKED, _LARGEST_RATIO = 3 << 23, 4

_PATIENCE = 30.0  # s, for reading a named pipe
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


@contextlib.contextmanager
def locked(path: StrPath) -> Iterator[Path]:
    """Lock a file, or a folder, that this run writes; remove what killed runs left of it.

    The lock file ``.NAME.lock`` (``.lock`` in a folder) is removed at the end of the block.
    The operating system unlocks the files of a process that is killed.  Blocks for the same
    file may be nested in one thread.

    Parameters
    ----------
    path : path-like
        The file, which need not exist.  A symbolic link is followed.

    Yields
    ------
    pathlib.Path
        The file that the path leads to.

    Raises
    ------
    FileError
        If another run has locked the file, or it could not be written.
    """
    with _writing(path):
        target = Path(os.path.realpath(path))
        with contextlib.suppress(FileNotFoundError):
            if stat.S_IFMT(target.stat().st_mode) not in (stat.S_IFREG, stat.S_IFDIR):
                raise OSError("it is a device or a pipe; give a file name")
        if not target.parent.is_dir():
            raise OSError(f"the folder {str(target.parent)!r} does not exist; create it first")
        name = target / ".lock" if target.is_dir() else target.with_name(f".{target.name}.lock")
        lock = filelock.FileLock(name, blocking=False, is_singleton=True)
        lock.acquire()
    outermost = lock.lock_counter == 1
    try:
        if outermost:
            pattern = f".{glob.escape(target.name)}.{'[0-9a-f]' * 8}{glob.escape(target.suffix)}"
            for temporary in target.parent.glob(pattern):
                with contextlib.suppress(OSError):
                    temporary.unlink()
        yield target
    finally:
        if outermost:  # before the release, so that it is no other run's
            with contextlib.suppress(OSError):
                name.unlink()
        lock.release()


@contextlib.contextmanager
def atomic_write(path: StrPath) -> Iterator[Path]:
    """Write a file so that it appears complete or not at all.

    The temporary file replaces ``path`` when the block ends without an error; otherwise it
    is removed and ``path`` remains as it was.  A symbolic link is followed: the file that
    it points to is replaced.  The new file has the permissions of the old one.

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
        If the folder does not exist or cannot be written to, if ``path`` is a folder or is
        locked by another run, or if the disk is full.

    Examples
    --------
    >>> with atomic_write("result.txt") as temporary:  # doctest: +SKIP
    ...     temporary.write_text("42")
    """
    with _temporary_beside(path) as (target, temporary):
        yield temporary
        with temporary.open("rb+") as handle:
            os.fsync(handle.fileno())
        if target.exists():
            shutil.copymode(target, temporary)
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
    """Write a table atomically, compressed if the file's ending says so; see :func:`plain_text`.

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
        plain_text(table).to_csv(temporary, **options)


def plain_text(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table without text that a spreadsheet would take for a formula.

    An apostrophe is put before text that begins with ``=``, ``+``, ``-`` or ``@``, also
    behind apostrophes; :func:`without_apostrophe` removes it again.
    """
    texts = table.select_dtypes(exclude="number")
    changed = {}
    for name, column in texts.items():
        found = {v: f"'{v}" for v in column.unique() if isinstance(v, str) and _FORMULA.match(v)}
        if found:
            changed[str(name)] = column.map(lambda value, found=found: found.get(value, value))
    names = {n: f"'{n}" for n in table.columns if isinstance(n, str) and _FORMULA.match(n)}
    return table.assign(**changed).rename(columns=names) if changed or names else table


def without_apostrophe(text: str) -> str:
    """Return the text that :func:`plain_text` put an apostrophe before; other text unchanged."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


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


def reserve(path: Path) -> None:
    """Allocate disk space for the whole length of a file, which may have holes.

    On a full disk, writing to the memory map of a file with holes ends the process.

    Raises
    ------
    OSError
        If the disk has too little space.
    """
    size = path.stat().st_size
    if hasattr(os, "posix_fallocate"):
        with path.open("rb+") as file:
            os.posix_fallocate(file.fileno(), 0, size)
    elif shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def make_folder(folder: Path) -> None:
    """Create a folder and its parents where they are missing.

    Raises
    ------
    FileError
        If it cannot be created, or is a file.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise FileError(f"{folder} is a file; give a folder.") from error
    except OSError as error:
        raise FileError(f"Cannot create the folder {folder}: {error}.") from error


@contextlib.contextmanager
def _temporary_beside(path: StrPath) -> Iterator[tuple[Path, Path]]:
    """Lock a file; yield the file that the path leads to, and a new one beside it.

    The new file is removed at the end.
    """
    with locked(path) as target, _writing(path):
        if target.is_dir():
            raise OSError("it is a folder; give a file name")
        temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}{target.suffix}")
        try:
            # With the usual permissions, unlike tempfile's, or private until they are copied.
            temporary.touch(0o600 if target.exists() else 0o666, exist_ok=False)
            yield target, temporary
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()


@contextlib.contextmanager
def _writing(path: StrPath) -> Iterator[None]:
    """Turn an ``OSError`` inside the block into a ``FileError`` that explains it."""
    try:
        yield
    except PCNDEError:  # which can be an OSError, too
        raise
    except filelock.Timeout as error:
        raise FileError(
            f"{str(path)!r} is in use by another run: wait until that ends, or give another name"
        ) from error
    except OSError as error:
        # h5py adds lines of addresses to the message.
        reason = os.strerror(error.errno) if error.errno else str(error)
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            reason = "the disk is full; free some space or choose another folder"
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            folder = str(Path(os.path.realpath(path)).parent)
            reason = f"no permission to write in {folder!r}; choose another folder"
        raise FileError(f"cannot write {str(path)!r}: {reason}") from error


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
        If it is a folder, a device or an empty pipe, not permitted to be read, in use by
        another program, damaged or something else.
    """
    check_file(Path(path), what)
    try:
        with _written_pipe(Path(path)):
            yield
    except PCNDEError:
        raise
    except PermissionError as error:
        raise FileError(f"No permission to read {path}.") from error
    except BlockingIOError as error:
        raise FileError(f"{path} is in use by another program: close it there.") from error
    except Exception as error:
        raise FileError(
            f"{path} is not {what}, or it is truncated or damaged ({error}). "
            "Check the file, or copy or create it again."
        ) from error


@contextlib.contextmanager
def _written_pipe(path: Path) -> Iterator[None]:
    """Raise if a named pipe is not read in time; without a writer, opening it never ends."""
    # The shell's own pipes, which always have a writer, have no name.
    named = Path(os.path.realpath(path)).is_fifo()
    if not named or threading.current_thread() is not threading.main_thread():
        yield
        return

    def give_up(*_: object) -> None:
        raise FileError(f"{path} is a pipe to which no program writes; give a file.")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def check_file(path: Path, what: str) -> None:
    """Raise if there is no file to read; ``what`` it should be is such as "a .vtp file".

    Raises
    ------
    DataNotFoundError
        If the path does not exist.
    FileError
        If the path is a folder or a device, or cannot be followed.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise DataNotFoundError(f"There is no file {path} ({what}); check the path.") from error
    except OSError as error:
        raise FileError(f"{path} cannot be read: {os.strerror(error.errno or 0)}.") from error
    for found, of_kind in (("folder", stat.S_ISDIR), ("device", stat.S_ISCHR)):
        if of_kind(mode):
            raise FileError(f"{path} is a {found}, not {what}.")


def is_folder(path: StrPath) -> bool:
    """Return whether a path leads to a folder; False if it cannot be followed."""
    try:
        return Path(path).is_dir()
    except OSError:  # such as a name that is too long, before Python 3.14
        return False


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
        return expanded(chosen)
    import pooch

    return Path(pooch.os_cache("pcnde_bridge"))


def expanded(path: StrPath) -> Path:
    """Return the path of a folder in the user's settings, with ``~`` replaced.

    Raises
    ------
    FileError
        If it cannot be followed, or begins with the name of an unknown user.
    """
    try:
        found = Path(path).expanduser()
        found.exists()  # such as a name that is too long
    except (RuntimeError, OSError) as error:
        raise FileError(f"The folder {path} cannot be used: {error}.") from error
    return found


def is_first_time(notice: str) -> bool:
    """Return whether this user has not seen a notice yet, and note in the cache that it is seen."""
    try:
        mark = cache_folder(None) / f"{notice}.seen"
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch(exist_ok=False)
    except FileExistsError:
        return False
    except (OSError, FileError):  # no cache
        pass
    return True
