"""Balances of volume and momentum of vessels, whatever the units of their variables."""

import math

import numpy as np

from pcnde_bridge._typing import Array

_FEWEST = 16  # time points that show accelerations


def growth_of_volume(flow: Array, area: Array, time: Array, z: Array) -> Array:
    """Return the slope of inflow less outflow over the growth of the volume, (case,).

    It is NaN where the two are not clearly related, as with rigid walls.

    Parameters
    ----------
    flow, area : array of shape (case, time, z)
        Results in any units.
    time, z : array
        Time points and points.
    """
    growth = np.gradient(np.trapezoid(area, z, axis=2), time, axis=1)
    excess = flow[:, :, 0] - flow[:, :, -1]
    growth -= growth.mean(axis=1, keepdims=True)
    excess -= excess.mean(axis=1, keepdims=True)
    product, growths = (excess * growth).sum(axis=1), (growth**2).sum(axis=1)
    rounding = 1e-9 * np.abs(flow).max(axis=(1, 2))
    related = (product > 0.95 * np.linalg.norm(excess, axis=1) * np.sqrt(growths)) & (
        np.abs(excess).max(axis=1) > rounding
    )
    slope: Array = np.full(len(flow), np.nan)
    np.divide(product, growths, out=slope, where=related & (len(time) >= 8))
    return slope


def density(flow: Array, area: Array, pressure: Array, time: Array, z: Array) -> Array:
    """Return the density by which differences of the pressure accelerate the flow, (case,).

    Losses are the rest that is constant, linear or quadratic in the flow.  It is NaN where
    accelerations do not explain what remains of the differences.

    Parameters
    ----------
    flow, area, pressure : array of shape (case, time, z)
        Results in any units.
    time, z : array
        Time points and points.
    """
    from scipy.interpolate import CubicSpline

    found: Array = np.full(len(flow), np.nan)
    if len(time) < _FEWEST:
        return found
    per_length = np.trapezoid(flow / area.mean(axis=1, keepdims=True), z, axis=2)
    accelerations = CubicSpline(time, per_length, axis=1)(time, 1)
    drops, means = pressure[:, :, 0] - pressure[:, :, -1], flow.mean(axis=2)
    floor = 1e-6 * np.abs(pressure).max(axis=(1, 2)) * math.sqrt(len(time))
    for case, q in enumerate(means / np.abs(means).max(axis=1, keepdims=True).clip(1e-300)):
        losses, _ = np.linalg.qr(np.stack([np.ones_like(q), q, q * np.abs(q)], axis=1))
        drop, rate = (
            values - losses @ (losses.T @ values) for values in (drops[case], accelerations[case])
        )
        size = np.linalg.norm(drop)
        if size > floor[case] and drop @ rate > 0.98 * size * np.linalg.norm(rate):
            found[case] = (drop @ rate) / (rate @ rate)
    return found
