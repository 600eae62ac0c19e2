"""Balances of volume and momentum of vessels, whatever the units of their variables."""

import math

import numpy as np

from pcnde_bridge._typing import Array

_FEWEST = 16  # time points that show accelerations
_SIMILAR = 0.98  # correlation; 0.99 for growth and excess flow of published cases
_CERTAIN = 5.0  # standard errors of a mean pressure drop


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


def lag(signal: Array, other: Array) -> int:
    """Return by how many steps a periodic signal is later than another, within half a cycle.

    It is 0 if no lag makes the signals similar, or clearly more similar.
    """
    deviations = [values - values.mean() for values in (signal, other)]
    size = max(math.prod(map(np.linalg.norm, deviations)), np.finfo(float).tiny)
    one, two = map(np.fft.rfft, deviations)
    similar = np.fft.irfft(one * two.conj(), len(signal)) / size
    best = int(similar.argmax())
    if similar[best] < _SIMILAR or similar[best] - similar[0] < 1 - _SIMILAR:
        return 0
    return best if best <= len(signal) // 2 else best - len(signal)


def momentum(
    flow: Array, area: Array, pressure: Array, time: Array, z: Array
) -> tuple[Array, Array]:
    """Return the density, and the pressure drop over that of Poiseuille's flow, each (case,).

    The density is that by which differences of the pressure accelerate the flow, beside losses
    that are constant, linear and quadratic in the flow.  It is NaN where accelerations do not
    explain the rest of the differences.  The drop is the mean pressure along the
    vessel over ∫ Q/S² dz, the friction but for 8·π·μ; it is NaN if it is smaller than the noise.

    Parameters
    ----------
    flow, area, pressure : array of shape (case, time, z)
        Results in any units.
    time, z : array
        Time points and points.
    """
    from scipy.integrate import cumulative_trapezoid
    from scipy.interpolate import CubicSpline

    density, friction = np.full((2, len(flow)), np.nan)
    count, mean_area = len(time), area.mean(axis=1)
    if count < _FEWEST // 2:
        return density, friction
    per_length = np.trapezoid(flow / mean_area[:, None], z, axis=2)
    accelerations = CubicSpline(time, per_length, axis=1)(time, 1)
    drops, means = pressure[:, :, 0] - pressure[:, :, -1], flow.mean(axis=2)
    floor = 1e-6 * np.abs(pressure).max(axis=(1, 2)) * math.sqrt(count)
    profile = cumulative_trapezoid(flow.mean(axis=1) / mean_area**2, z, axis=1, initial=0)
    profile -= profile.mean(axis=1, keepdims=True)
    # By least squares over all points, which noise does not change much.
    size = np.maximum((profile**2).sum(axis=1, keepdims=True), np.finfo(float).tiny)
    falls = -np.einsum("ctz,cz->ct", pressure, profile / size)
    for case, q in enumerate(means / np.abs(means).max(axis=1, keepdims=True).clip(1e-300)):
        losses = np.stack([np.ones_like(q), q, q * np.abs(q)], axis=1)
        drop, rate = _rest(losses, drops[case]), _rest(losses, accelerations[case])
        size_of_drop, product = np.linalg.norm(drop), drop @ rate
        clear = size_of_drop > floor[case]
        if count >= _FEWEST and clear and product > 0.98 * size_of_drop * np.linalg.norm(rate):
            density[case] = product / (rate @ rate)
        noise = np.linalg.norm(_rest(np.column_stack([losses, rate]), falls[case]))
        mean, scale = float(falls[case].mean()), math.sqrt(count * (count - 4))
        over = abs(mean) * np.ptp(profile[case]) > floor[case]
        if over and abs(mean) > _CERTAIN * noise / scale:
            friction[case] = mean
    return density, friction


def _rest(columns: Array, values: Array) -> Array:
    """Return the residual of a least-squares fit of the values by the columns."""
    basis, _ = np.linalg.qr(columns)
    rest: Array = values - basis @ (basis.T @ values)
    return rest
