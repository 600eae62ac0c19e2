"""Type aliases shared by all subpackages."""

import os
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""Array of 64-bit floats."""

IntArray = npt.NDArray[np.int64]
"""Array of 64-bit integers, such as the positions of cases in a data set."""

BoolArray = npt.NDArray[np.bool_]
"""Array of truth values."""

ComplexArray = npt.NDArray[np.complex128]
"""Array of complex numbers, such as harmonics."""

AnyArray = npt.NDArray[Any]
"""Array of numbers or text of any kind."""

StrPath = str | os.PathLike[str]
"""Path of a file or folder."""
