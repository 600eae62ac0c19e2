r"""Calibration of standard deviations on cases that were left out of a fit.

The standard deviation of a variable is

.. math:: \sigma = c \sqrt{s^2 + (a\,e(z))^2},

with s the spread among several predictions, e(z) an error along the vessel that all of
them share, a the amplitude of the inflow relative to the training cases, and c a factor.
Errors grow with the amplitude: without a, intervals would be too wide for weak waveforms and too
narrow for strong ones.  On the cases left out, e(z) is the 68 % quantile of the errors over a at
each point, and c is chosen so that 90 % intervals contain 90 % of the values.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError

_NEGLIGIBLE = 1e-12
_SMALLEST_AMPLITUDE = 0.3  # relative; the error of a nearly steady flow is not nearly zero

_HALF_WIDTH = NormalDist().inv_cdf(0.95)
"""Half the width of a normal 90 % interval, in standard deviations."""


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Displayed):
    """Factors that turn the spread among predictions into a standard deviation.

    Attributes
    ----------
    profile : array of shape (3, point)
        Shared error e(z) of flow, area and pressure at points equally spaced from inlet
        to outlet.
    scale : array of shape (3,)
        Factor c of flow, area and pressure.
    amplitude : array of shape (1,)
        Amplitude of the training cases' inflows, mL/s, see :func:`amplitude`.
    """

    profile: Array
    scale: Array
    amplitude: Array

    def shared_error(self, variable: str, inflow: Array, z: Array) -> Array:
        """Return a·e(z) of a variable, shape (case, 1, z).

        Parameters
        ----------
        variable : str
            Name of the variable.
        inflow : array of shape (case, time)
            Flow rate at the inlet, mL/s.
        z : array of shape (z,)
            Points, cm.
        """
        points = np.linspace(0, 1, self.profile.shape[1])
        profile = self.profile[VARIABLES.index(variable)]
        along = np.interp((z - z[0]) / (z[-1] - z[0]), points, profile)
        return relative_amplitude(inflow, self.amplitude)[:, None, None] * along

    def standard_deviation(self, variable: str, spread: Array, inflow: Array, z: Array) -> Array:
        """Return σ for the spread s of a variable, both of shape (case, time, z)."""
        scale = self.scale[VARIABLES.index(variable)]
        return scale * np.hypot(spread, self.shared_error(variable, inflow, z))

    def check(self) -> None:
        """Check shapes and values.

        Raises
        ------
        InputError
            If the shapes do not belong together, or a value is negative or not finite.
        """
        n, shape = len(VARIABLES), self.profile.shape
        others = self.scale.shape, self.amplitude.shape
        if others != ((n,), (1,)) or len(shape) != 2 or shape[0] != n or shape[1] == 0:
            raise InputError(f"The calibration's arrays do not belong together: {shape}, {others}.")
        if not all(((array >= 0) & (array < np.inf)).all() for array in vars(self).values()):
            raise InputError("The calibration has values that are negative or not finite.")


def amplitude(inflow: Array) -> Array:
    """Return the root mean square of inflows (case, time) without their means, shape (1,)."""
    return np.array([np.sqrt(np.var(inflow, axis=1).mean())])


def relative_amplitude(inflow: Array, reference: Array) -> Array:
    """Return a of each inflow (case, time): its amplitude over a reference (1,), at least 0.3.

    It is 1 if the reference is 0, which is that of steady inflows.
    """
    if not reference.any():
        return np.ones(len(inflow))
    return np.maximum(np.std(inflow, axis=1) / reference, _SMALLEST_AMPLITUDE)


def shared_error(error: Array, relative: Array) -> Array:
    """Return e(z), shape (3, z).

    Parameters
    ----------
    error : array of shape (3, case, time, z)
        Absolute errors of the cases left out.
    relative : array of shape (case,)
        Result of :func:`relative_amplitude`.
    """
    return np.quantile(error / relative[:, None, None], 0.68, axis=(1, 2))


def fit_scales(
    profile: Iterable[Array], error: Iterable[Array], spread: Iterable[Array], relative: Array
) -> tuple[Array, Array]:
    """Find the factors c that make 90 % intervals contain 90 % of the values.

    Parameters
    ----------
    profile : three arrays of shape (z,)
        Result of :func:`shared_error`; a variable may have a subset of the points.
    error, spread : three arrays of shape (case, time, z)
        Absolute errors of the cases left out, and the spread s of their predictions.
    relative : array of shape (case,)
        Result of :func:`relative_amplitude`.

    Returns
    -------
    tuple of arrays of shape (3,)
        The factors, and the mean standard deviations.
    """
    size = relative[:, None, None]
    widths = [np.sqrt(s**2 + (size * e) ** 2) for s, e in zip(spread, profile, strict=True)]
    found = np.array([_factor(*pair) for pair in zip(error, widths, strict=True)])
    return found, found * [width.mean() for width in widths]


def fit_loss_scales(error: Array, losses: Array, dynamic: Array) -> Array:
    """Fit the standard deviations of the losses to errors of the pressure drop.

    The variance of a drop is (a·losses)² + (b·dynamic)².  The ratio of a and b maximizes the
    likelihood of normal errors.  Their size is chosen so that 90 % intervals contain 90 % of the
    errors.  A share of b is constant in time; it is chosen so that the intervals of the mean drops
    also contain 90 % of new ones: the quantile of n errors is the (n + 1)·90 %-th in order, as in
    split conformal prediction (Lei et al. 2018, J. Am. Stat. Assoc. 113:1094).

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
    share = min(float(np.quantile(shares, min(0.9 * (1 + 1 / len(shares)), 1.0))), 1.0)
    return np.array([a, b * share, b * np.sqrt(1 - share**2)])


def _factor(error: Array, width: Array) -> float:
    """Return the factor with which normal 90 % intervals contain 90 % of the errors.

    Values of zero width are known, such as the flow at the inlet, and do not count.
    """
    uncertain = width > _NEGLIGIBLE
    if not uncertain.any():
        return 0.0
    return float(np.quantile(error[uncertain] / width[uncertain], 0.9)) / _HALF_WIDTH
