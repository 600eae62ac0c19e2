"""Linear least squares: the exact minimum of what enters an equation linearly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcnde_bridge._typing import Array

_RANK = 1e-12  # of the scaled normal equations, whose eigenvalues are the squares


def solve_per_point(columns: Sequence[Array], target: Array) -> tuple[Array, float]:
    """Minimise Σ_case,time (Σ_k u_k(z)·column_k − target)² at every point z.

    Where the columns do not determine all u_k, those of the least size are taken.

    Parameters
    ----------
    columns : sequence of arrays that broadcast to (case, time, z)
        What each unknown multiplies.
    target : array of shape (case, time, z)
        What the sum should be.

    Returns
    -------
    unknowns : array of shape (k, z)
        u_k.
    loss : float
        Mean of the squares that are left.
    """
    full = [np.broadcast_to(column, target.shape) for column in columns]
    normal = np.array([[np.einsum("ntz,ntz->z", a, b) for b in full] for a in full])
    right = np.array([np.einsum("ntz,ntz->z", a, target) for a in full])
    unknowns = solve_normal(np.moveaxis(normal, 2, 0), right.T).T
    left = target - sum(u * column for u, column in zip(unknowns, full, strict=True))
    return unknowns, float(np.mean(left**2))


def solve_normal(normal: Array, right: Array) -> Array:
    """Solve normal equations, scaled to columns of length one; the least solution if singular.

    Parameters
    ----------
    normal : array of shape (..., k, k)
        Products of the columns.
    right : array of shape (..., k)
        Products of the columns with the target.

    Returns
    -------
    array of shape (..., k)
        The unknowns.
    """
    length = np.sqrt(np.einsum("...kk->...k", normal))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    scaled = scale[..., :, None] * normal * scale[..., None, :]
    inverse = np.linalg.pinv(scaled, rcond=_RANK, hermitian=True)
    result: Array = scale * np.einsum("...jk,...k->...j", inverse, scale * right)
    return result
