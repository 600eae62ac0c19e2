"""Reusable output buffers.

The operating system provides newly allocated large arrays page by page, which slows down
the first write to them.
"""

import math
import weakref
from collections import deque

import numpy as np

from pcnde_bridge._typing import Array

_BLOCKS = 6
"""Number of cached blocks: flow, area and pressure of the current and the next prediction."""

_LARGEST = 1 << 25
"""Size of the largest cached block, bytes."""


class Buffers:
    """Pool that reuses the memory of arrays without remaining references."""

    def __init__(self) -> None:
        self._free: deque[Array] = deque(maxlen=_BLOCKS)

    def __reduce__(self) -> tuple[type, tuple[()]]:
        """Pickle without the memory."""
        return Buffers, ()

    def empty(self, shape: tuple[int, ...]) -> Array:
        """Return an array of this shape whose values are undefined.

        Its memory is reused when the array and all its views are deleted.
        """
        size = math.prod(shape)
        try:
            block = self._free.pop()
        except IndexError:
            block = np.empty(size)
        if block.size != size:
            block = np.empty(size)
        # Views of the result refer to this array, which alone refers to the memory.
        array = np.frombuffer(block.data)
        if block.nbytes <= _LARGEST:
            weakref.finalize(array, self._free.append, block).atexit = False
        return array.reshape(shape)
