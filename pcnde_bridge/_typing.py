"""Type aliases that are used throughout the package."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""Array of 64-bit floats."""

IntArray = npt.NDArray[np.int64]
"""Array of 64-bit integers."""
