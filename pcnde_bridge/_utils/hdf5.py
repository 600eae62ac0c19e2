"""Reading data sets of HDF5 files that may be foreign or damaged."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray
from pcnde_bridge._utils.files import Budget

_MOST_LINKS = 64


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
        None if there is no such data set.  Text is returned as ``str``.

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
    # Numbers become 8 bytes each; a whole chunk is unpacked for each value.
    budget = budget or Budget(Path(group.file.filename).stat().st_size)
    budget.claim(at.size * max(at.dtype.itemsize, 8))
    budget.claim(math.prod(at.chunks or ()) * at.dtype.itemsize)
    if h5py.check_string_dtype(at.dtype) is not None:
        texts = np.asarray(at.asstr("utf-8")[()], dtype=object)
        budget.claim(4 * texts.size * max(map(len, texts.flat), default=0))
        return texts.astype(np.str_)
    return np.asarray(at[()])


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
