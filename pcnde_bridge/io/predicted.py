"""Interface of the predictions that this subpackage writes to files."""

from __future__ import annotations

from typing import Protocol

import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases


class Predicted(Protocol):
    """Prediction that can be written, such as :class:`pcnde_bridge.Prediction`."""

    @property
    def area_undeformed(self) -> Array:
        """Undeformed area, shape (case, z), cm²."""

    @property
    def time(self) -> Array:
        """Time points, s."""

    @property
    def z(self) -> Array:
        """Axial positions, cm."""

    @property
    def period(self) -> float:
        """Length of the cycle, s."""

    @property
    def labels(self) -> pd.DataFrame:
        """Labels, one row for each case."""

    def __len__(self) -> int: ...

    def variables(self) -> dict[str, Array]:
        """Return the predicted variables by name, shape (case, time, z)."""

    def to_frame(self) -> pd.DataFrame:
        """Return the prediction as a tidy table."""

    def to_cases(self) -> Cases:
        """Return the prediction as a data set."""
