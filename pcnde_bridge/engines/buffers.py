"""Memory for results that come again and again.

Large arrays that are freed go back to the operating system, which hands out the next ones
page by page: what writes them then waits for that.
"""

from __future__ import annotations

import math
import weakref
from collections import deque

import numpy as np

from pcnde_bridge._typing import Array

_BLOCKS = 6
"""Flow, area and pressure of a prediction that is in use, and of the next."""

_LARGEST = 1 << 25
"""Bytes of the largest block that is kept."""


class Buffers:
    """Makes arrays, of the memory of earlier ones that nothing refers to any longer."""

    def __init__(self) -> None:
        self._free: deque[Array] = deque(maxlen=_BLOCKS)

    def empty(self, shape: tuple[int, ...]) -> Array:
        """Return an array of this shape whose values are undefined.

        Its memory serves again once it and all views of it are gone.
        """
        size = math.prod(shape)
        try:
            block = self._free.pop()
        except IndexError:
            block = np.empty(size)
        if block.size != size:
            block = np.empty(size)
        # Views of the result refer to this array, and nothing but it to the memory.
        array = np.frombuffer(block.data)
        if block.nbytes <= _LARGEST:
            weakref.finalize(array, self._free.append, block).atexit = False
        return array.reshape(shape)
