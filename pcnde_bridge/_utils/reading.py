"""Boundaries around readers: errors of damaged files, and the file's name in messages."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from pcnde_bridge._utils.files import check_file
from pcnde_bridge.errors import FileError, InputError, PCNDEError


@contextlib.contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Turn any failure to read a file into an error of this package.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        Kind of file with its article, for messages: ``"a .vtp file"``.

    Raises
    ------
    DataNotFoundError
        If the file does not exist.
    FileError
        If the path is a folder or not readable, or if the block raises anything but an
        error of this package.

    Examples
    --------
    >>> with reading(path, "an HDF5 file"), h5py.File(path) as file:  # doctest: +SKIP
    ...     flow = file["flow"][()]
    """
    check_file(path, what)
    try:
        yield
    except PCNDEError:
        raise
    except PermissionError as error:
        raise FileError(f"No permission to read {path}.") from error
    except Exception as error:  # readers of damaged bytes raise nearly anything
        raise FileError(
            f"Cannot read {path} as {what}: it is truncated, damaged or of another kind ({error})."
        ) from error


@contextlib.contextmanager
def naming(name: object) -> Iterator[None]:
    """Put a name before the messages of input errors.

    Parameters
    ----------
    name : str or Path
        Name of the file whose content the block checks.

    Raises
    ------
    InputError
        If the block raises one: ``"name: message"``.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
