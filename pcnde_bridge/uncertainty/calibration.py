r"""Calibration of standard deviations on cases that were left out of a fit.

The standard deviation of a variable is

.. math:: \sigma = c \sqrt{s^2 + e(z)^2},

with s the spread among several predictions, e(z) an error along the vessel that all of
them share, and c a factor.  On the cases left out, e(z) is the 68 % quantile of the errors
at each point, and c is chosen so that 90 % intervals contain 90 % of the values.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError

_NEGLIGIBLE = 1e-12

_HALF_WIDTH = NormalDist().inv_cdf(0.95)
"""Half the width of a normal 90 % interval, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Factors that turn the spread among predictions into a standard deviation.

    Attributes
    ----------
    profile : array of shape (3, point)
        Shared error e(z) of flow, area and pressure at points equally spaced from inlet
        to outlet.
    scale : array of shape (3,)
        Factor c of flow, area and pressure.
    """

    profile: Array
    scale: Array

    @classmethod
    def fit(cls, profile: Array, error: Array, spread: Array) -> Calibration:
        """Find the factors that make 90 % intervals contain 90 % of the values.

        Parameters
        ----------
        profile : array of shape (3, z)
            Result of :func:`shared_error`.
        error, spread : array of shape (3, case, time, z)
            Absolute errors of the cases left out, and the spread s of their predictions.
        """
        width = np.hypot(spread, profile[:, None, None])
        return cls(profile, np.array([_factor(*pair) for pair in zip(error, width, strict=True)]))

    def shared_error(self, variable: str, z: Array) -> Array:
        """Return e(z) of a variable at points z (cm), shape (z,)."""
        relative = np.linspace(0, 1, self.profile.shape[1])
        profile = self.profile[VARIABLES.index(variable)]
        error: Array = np.interp((z - z[0]) / (z[-1] - z[0]), relative, profile)
        return error

    def standard_deviation(self, variable: str, spread: Array, z: Array) -> Array:
        """Return σ for the spread s of a variable, both of shape (case, time, z)."""
        scale = self.scale[VARIABLES.index(variable)]
        sigma: Array = scale * np.hypot(spread, self.shared_error(variable, z))
        return sigma

    def check(self) -> None:
        """Check shapes and values.

        Raises
        ------
        InputError
            If the shapes do not belong together, or a value is negative or not finite.
        """
        n, shape = len(VARIABLES), self.profile.shape
        if self.scale.shape != (n,) or len(shape) != 2 or shape[0] != n or shape[1] == 0:
            raise InputError(
                f"The calibration's arrays do not belong together: {shape}, {self.scale.shape}."
            )
        if not all(((array >= 0) & (array < np.inf)).all() for array in (self.profile, self.scale)):
            raise InputError("The calibration has values that are negative or not finite.")


def shared_error(error: Array) -> Array:
    """Return e(z), shape (3, z), of absolute errors, shape (3, case, time, z)."""
    return np.quantile(error, 0.68, axis=(1, 2))


def fit_loss_scales(error: Array, losses: Array, dynamic: Array) -> Array:
    """Fit the standard deviations of the losses to errors of the pressure drop.

    The variance of a drop is (a·losses)² + (b·dynamic)².  The ratio of a and b maximizes the
    likelihood of normal errors.  Their size is chosen so that 90 % intervals contain 90 % of the
    errors.  A share of b is constant in time; it is chosen so that the intervals of the mean drops
    also contain 90 %.

    Parameters
    ----------
    error, losses, dynamic : arrays of shape (case, time)
        Errors of the drop and the two scales, dyn/cm².

    Returns
    -------
    array of shape (3,)
        a, and the constant and the varying part of b.
    """
    from scipy.optimize import minimize

    def cost(logarithms: Array) -> float:
        a, b = np.exp(logarithms)
        variance = (a * losses) ** 2 + (b * dynamic) ** 2 + _NEGLIGIBLE
        return float((np.log(variance) + error**2 / variance).mean())

    a, b = np.exp(minimize(cost, np.log([0.05, 0.05]), method="Nelder-Mead").x)
    a, b = np.array([a, b]) * _factor(np.abs(error), np.hypot(a * losses, b * dynamic))
    needed = (error.mean(axis=1) / _HALF_WIDTH) ** 2 - (a * losses.mean(axis=1)) ** 2
    shares = np.sqrt(np.maximum(needed, 0)) / (b * dynamic.mean(axis=1) + _NEGLIGIBLE)
    share = min(float(np.quantile(shares, 0.9)), 1.0)
    return np.array([a, b * share, b * np.sqrt(1 - share**2)])


def _factor(error: Array, width: Array) -> float:
    """Return the factor with which normal 90 % intervals contain 90 % of the errors.

    Values of zero width are known, such as the flow at the inlet, and do not count.
    """
    uncertain = width > _NEGLIGIBLE
    if not uncertain.any():
        return 0.0
    return float(np.quantile(error[uncertain] / width[uncertain], 0.9)) / _HALF_WIDTH
