"""Stenosis of a vessel: the area without it, its throat, and positions beyond its ends."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array

NO_STENOSIS = 0.99
"""Limit of the smallest S_u over the healthy area: a vessel above it has no stenosis."""

_HEALTHY = 0.999  # share of the healthy area that is reached at the end of a narrowing


def diameter(area: Any) -> Any:
    """Return the diameter of a circle, cm, of an area in cm²; numpy or JAX array."""
    return (4.0 / math.pi * area) ** 0.5


def healthy_area(z: Array, area_undeformed: Array) -> Array:
    """Return the area without a stenosis, cm²: an even taper a·exp(b·z) from end to end.

    Parameters
    ----------
    z : array of shape (z,)
        Axial positions, cm.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """
    share = (z - z[0]) / (z[-1] - z[0])
    first, last = np.log(area_undeformed[:, :1]), np.log(area_undeformed[:, -1:])
    return np.asarray(np.exp(first + share * (last - first)))


def throats(z: Array, area_undeformed: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Return the point of the narrowest stenosis, and its S_u over the healthy area.

    Parameters
    ----------
    z : array of shape (z,)
        Axial positions, cm.
    area_undeformed : array of shape (case, z)
        S_u, cm².

    Returns
    -------
    points : array of int, shape (case,)
        Points at which S_u is smallest relative to :func:`healthy_area`.
    ratios : array of shape (case,)
        S_u over the healthy area there; above :data:`NO_STENOSIS` there is no stenosis.
    """
    ratio = area_undeformed / healthy_area(z, area_undeformed)
    return ratio.argmin(axis=1), ratio.min(axis=1)


def measuring_positions(z: Array, area_undeformed: Array) -> tuple[Array, Array]:
    """Return the positions between which the drop of the narrowest stenosis is taken, cm.

    A narrowing reaches from its throat to the first point on either side with at least
    99.9 % of :func:`healthy_area`.  The positions are one healthy diameter beyond its ends,
    but within the vessel.  In a vessel without a stenosis, they are the vessel's ends.

    Parameters
    ----------
    z : array of shape (z,)
        Axial positions, cm.
    area_undeformed : array of shape (case, z)
        S_u, cm².

    Returns
    -------
    proximal, distal : array of shape (case,)
        Positions upstream and downstream of the stenosis.
    """
    healthy = healthy_area(z, area_undeformed)
    points, ratios = throats(z, area_undeformed)
    proximal, distal = np.full(len(points), z[0]), np.full(len(points), z[-1])
    for case in np.flatnonzero(ratios <= NO_STENOSIS):
        throat = points[case]
        outside = np.flatnonzero(area_undeformed[case] >= _HEALTHY * healthy[case])
        margin = diameter(healthy[case, throat])
        # The end points of the vessel are always outside.
        proximal[case] = max(z[0], z[outside[outside < throat][-1]] - margin)
        distal[case] = min(z[-1], z[outside[outside > throat][0]] + margin)
    return proximal, distal
