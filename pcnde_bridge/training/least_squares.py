"""Linear least squares: the exact minimum with respect to linear parameters."""

from collections.abc import Sequence

import numpy as np

from pcnde_bridge._typing import Array

_RANK = 1e-12  # relative; the eigenvalues of normal equations are squares


def solve_per_point(columns: Sequence[Array], target: Array) -> tuple[Array, float]:
    """Minimize Σ_case,time (Σ_k u_k(z)·column_k − target)² at every point z.

    Where the columns do not determine all u_k, those of the smallest norm are taken.

    Parameters
    ----------
    columns : sequence of arrays that broadcast to (case, time, z)
        Factor of each unknown.
    target : array of shape (case, time, z)
        Value that the sum should have.

    Returns
    -------
    unknowns : array of shape (k, z)
        u_k.
    loss : float
        Mean square of the residual.
    """
    full = [np.broadcast_to(column, target.shape) for column in columns]
    normal = np.array([[np.einsum("ntz,ntz->z", a, b) for b in full] for a in full])
    right = np.array([np.einsum("ntz,ntz->z", a, target) for a in full])
    unknowns = solve_normal(np.moveaxis(normal, 2, 0), right.T).T
    residual = target - sum(u * column for u, column in zip(unknowns, full, strict=True))
    return unknowns, float(np.mean(residual**2))


def solve_normal(normal: Array, right: Array) -> Array:
    """Solve normal equations, scaled to columns of length one.

    Parameters
    ----------
    normal : array of shape (..., k, k)
        Products of the columns.
    right : array of shape (..., k)
        Products of the columns with the target.

    Returns
    -------
    array of shape (..., k)
        Unknowns; those of the smallest norm if the equations are singular.
    """
    length = np.sqrt(np.einsum("...kk->...k", normal))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    scaled = scale[..., :, None] * normal * scale[..., None, :]
    inverse = np.linalg.pinv(scaled, rcond=_RANK, hermitian=True)
    return scale * np.einsum("...jk,...k->...j", inverse, scale * right)
