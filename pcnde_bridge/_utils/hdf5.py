"""Reading data sets of HDF5 files that may be foreign or damaged, and large ones in place."""

import math
import mmap
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pcnde_bridge._typing import AnyArray
from pcnde_bridge._utils.files import Budget

_MOST_LINKS = 64

SMALLEST_MAP = 1 << 27
"""Bytes from which :func:`read_dataset` leaves a data set on disk."""


def read_dataset(group: Any, name: str, budget: Budget | None = None) -> AnyArray | None:
    """Read a data set that is stored in the file itself and has a plausible size.

    Parameters
    ----------
    group : h5py.File
        Open file.
    name : str
        Path of the data set.
    budget : Budget, optional
        Memory that all data sets of the file may take.

    Returns
    -------
    array, or None
        None if there is no such data set.  Text is returned as ``str``.  Large numbers that are
        stored as they are in memory stay on disk, see :func:`map_dataset`.

    Raises
    ------
    ValueError
        If the data set is stored in another file, or claims more than the file can hold.
    """
    import h5py

    at = _found(group, name)
    if not isinstance(at, h5py.Dataset):
        return None
    if at.external or at.is_virtual:
        raise ValueError(f"{name} is stored in another file; external links are not followed")
    # In one piece, and written: the offset of one that is not is meaningless.
    stored = at.chunks is None and at.id.get_storage_size() == at.nbytes
    if stored and at.nbytes >= SMALLEST_MAP and at.dtype == np.dtype("<f8"):
        return map_dataset(at)
    # Numbers become 8 bytes each; a whole chunk is unpacked for each value.
    budget = budget or Budget(Path(group.file.filename).stat().st_size)
    budget.claim(at.size * max(at.dtype.itemsize, 8))
    budget.claim(math.prod(at.chunks or ()) * at.dtype.itemsize)
    if h5py.check_string_dtype(at.dtype) is not None:
        texts = np.asarray(at.asstr("utf-8")[()], dtype=object)
        budget.claim(4 * texts.size * max(map(len, texts.flat), default=0))
        return texts.astype(np.str_)
    return np.asarray(at[()])


def map_dataset(at: Any, mode: Literal["r", "r+"] = "r") -> np.memmap[Any, Any]:
    """Return the memory map of a contiguous data set, which outlives the open file.

    Raises
    ------
    ValueError
        If the file is shorter than the data set.
    """
    return np.memmap(at.file.filename, at.dtype, mode, at.id.get_offset(), at.shape)


def create_dataset(file: Any, name: str, shape: tuple[int, ...]) -> None:
    """Create a contiguous data set of float64 whose numbers are written by :func:`map_dataset`.

    No later write changes the file's structure, so that an interruption cannot damage it.
    """
    import h5py

    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space = h5py.h5s.create_simple(shape)
    group = file.require_group(name.rpartition("/")[0] or "/")
    h5py.h5d.create(group.id, name.rpartition("/")[2].encode(), h5py.h5t.IEEE_F64LE, space, layout)


def release(*arrays: AnyArray | None) -> None:
    """Return the memory that has been read from memory maps; what is needed again is read again."""
    for array in arrays:
        mapped = getattr(array, "_mmap", None)
        if mapped is not None and hasattr(mapped, "madvise"):  # not on Windows
            mapped.madvise(mmap.MADV_DONTNEED)


def _found(file: Any, name: str) -> Any:
    """Return the object at a path, through soft links but never out of the file."""
    import h5py

    at, parts = file, name.strip("/").split("/")
    for _ in range(_MOST_LINKS):
        if not parts or not isinstance(at, h5py.Group):
            return None if parts else at
        part = parts.pop(0)
        link = at.get(part, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise ValueError(f"{name} is stored in another file; external links are not followed")
        if isinstance(link, h5py.SoftLink):
            at = file if link.path.startswith("/") else at
            parts = [*link.path.strip("/").split("/"), *parts]
        else:
            at = at.get(part)
    raise ValueError(f"{name} is reached by too many links")
