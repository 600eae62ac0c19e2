"""Reading data sets of HDF5 files that may be foreign or damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray
from pcnde_bridge._utils.files import check_claim


def read_dataset(group: Any, name: str) -> AnyArray | None:
    """Read a data set that is stored in the file itself and has a plausible size.

    Parameters
    ----------
    group : h5py.File or h5py.Group
        Group of an open file.
    name : str
        Path of the data set.

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

    at = group
    for part in name.strip("/").split("/"):
        if not isinstance(at, h5py.Group):
            return None
        if isinstance(at.get(part, getlink=True), h5py.ExternalLink):
            raise ValueError(f"{name} is stored in another file; external links are not followed")
        at = at.get(part)
    if not isinstance(at, h5py.Dataset):
        return None
    if at.external or at.is_virtual:
        raise ValueError(f"{name} is stored in another file; external links are not followed")
    check_claim(at.nbytes, Path(group.file.filename).stat().st_size)
    if h5py.check_string_dtype(at.dtype) is not None:
        return np.asarray(at.asstr("utf-8")[()], dtype=np.str_)
    return np.asarray(at[()])
