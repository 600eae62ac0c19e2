"""The boundary around readers of files that may be foreign or damaged."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from pcnde_bridge._utils.files import check_file
from pcnde_bridge.errors import FileError, PCNDEError


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
