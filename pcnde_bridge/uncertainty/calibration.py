r"""How far predictions may be off, found on cases that were left out.

The standard deviation of a variable is

.. math:: \sigma = c \sqrt{s^2 + e(z)^2},

with s the deviation among several predictions, e(z) an error along the vessel that all of
them share, and c a factor.  On the cases left out, e(z) is the 68 % quantile of the errors
at each point, and c makes 90 % intervals hold 90 % of the values.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError

_LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class Calibration:
    """What makes a standard deviation of the deviation among predictions.

    Attributes
    ----------
    profile : array of shape (3, point)
        e(z) of flow, area and pressure, equally spaced from inlet to outlet.
    scale : array of shape (3,)
        c of flow, area and pressure.
    """

    profile: Array
    scale: Array

    @classmethod
    def fit(cls, profile: Array, error: Array, spread: Array) -> Calibration:
        """Find the factors.

        Parameters
        ----------
        profile : array of shape (3, z)
            Of :func:`shared_error`.
        error, spread : array of shape (3, case, time, z)
            Absolute errors of the cases left out, and s.
        """
        width = np.hypot(spread, profile[:, None, None])
        return cls(profile, np.array([_factor(*pair) for pair in zip(error, width, strict=True)]))

    def shared(self, variable: str, z: Array) -> Array:
        """Return e at the points z, cm."""
        along = np.linspace(0, 1, self.profile.shape[1])
        profile = self.profile[VARIABLES.index(variable)]
        shared: Array = np.interp((z - z[0]) / (z[-1] - z[0]), along, profile)
        return shared

    def deviation(self, variable: str, spread: Array, z: Array) -> Array:
        """Return σ of s, both (case, time, z)."""
        scale = self.scale[VARIABLES.index(variable)]
        deviation: Array = scale * np.hypot(spread, self.shared(variable, z))
        return deviation

    def check(self) -> None:
        """Raise if the arrays do not belong together, or are no deviations.

        Raises
        ------
        InputError
            Saying what their shapes are, or that a value is negative or not finite.
        """
        n, shape = len(VARIABLES), self.profile.shape
        if self.scale.shape != (n,) or len(shape) != 2 or shape[0] != n or shape[1] == 0:
            raise InputError(
                f"The calibration's arrays do not belong together: {shape}, {self.scale.shape}."
            )
        if not all(((array >= 0) & (array < np.inf)).all() for array in (self.profile, self.scale)):
            raise InputError("The calibration holds values that are negative or not finite.")


def shared_error(error: Array) -> Array:
    """Return e(z), (3, z), of absolute errors (3, case, time, z)."""
    return np.quantile(error, 0.68, axis=(1, 2))


def _factor(error: Array, width: Array) -> float:
    """Factor on deviations with which normal 90 % intervals hold 90 % of the errors.

    Where these are zero the values are known, as the flow at the inlet, and do not count.
    """
    inside = width > _LEAST
    if not inside.any():
        return 0.0
    normal = NormalDist().inv_cdf(0.95)  # 90 % lie within so many deviations
    return float(np.quantile(error[inside] / width[inside], 0.9)) / normal
