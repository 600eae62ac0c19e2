"""Checksums of named arrays that are the same on every machine."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from pcnde_bridge._typing import AnyArray


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
        digest.update(little.tobytes() if little.dtype.kind == "U" else little.data)
    return digest.hexdigest()
