"""Stenosis of a vessel: the area without it, its throat, and positions beyond its ends."""

import math
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.errors import PCNDEWarning

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


def summary(z: Array, area_undeformed: Array) -> str:
    """Return a sentence on the healthy diameters and the blockages of vessels.

    Parameters
    ----------
    z : array of shape (z,)
        Axial positions, cm.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """
    healthy, narrow = areas_at_throats(z, area_undeformed)
    ends_of = [
        dict.fromkeys(f"{limit:{form}}" for limit in (values.min(), values.max()))
        for values, form in ((10 * diameter(healthy), ".3g"), (1 - narrow / healthy, ".0%"))
    ]
    of_healthy, of_blockage = (" to ".join(limits) for limits in ends_of)
    return f"Vessels: healthy diameter {of_healthy} mm, blockage {of_blockage}."


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


def areas_at_throats(z: Array, area_undeformed: Array) -> tuple[Array, Array]:
    """Return the healthy area S_D and S_u at the throats, cm², each of shape (case,).

    Parameters
    ----------
    z : array of shape (z,)
        Axial positions, cm.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """
    points, ratios = throats(z, area_undeformed)
    healthy = healthy_area(z, area_undeformed)[np.arange(len(points)), points]
    return healthy, ratios * healthy


def ends(z: Array, area_undeformed: Array) -> tuple[Array, Array]:
    """Return where the narrowest stenosis begins and ends, cm, each of shape (case,).

    It reaches from its throat to the first point on either side with at least 99.9 % of
    :func:`healthy_area`.  A vessel without a stenosis has its own ends.

    Parameters
    ----------
    z : array of shape (z,)
        Axial positions, cm.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """
    healthy = healthy_area(z, area_undeformed)
    points, ratios = throats(z, area_undeformed)
    start, end = np.full(len(points), z[0]), np.full(len(points), z[-1])
    for case in np.flatnonzero(ratios <= NO_STENOSIS):
        outside = np.flatnonzero(area_undeformed[case] >= _HEALTHY * healthy[case])
        # The end points of the vessel are always outside.
        start[case] = z[outside[outside < points[case]][-1]]
        end[case] = z[outside[outside > points[case]][0]]
    return start, end


def check_length(z: Array, area_undeformed: Array, length: float) -> None:
    """Warn if the stenosis of a case is much shorter or longer than a formula's L_s, cm.

    Warns
    -----
    PCNDEWarning
        If a length found by :func:`ends` differs from L_s by more than half of it.
    """
    start, end = ends(z, area_undeformed)
    found = end - start
    _, ratios = throats(z, area_undeformed)
    other = np.flatnonzero((ratios <= NO_STENOSIS) & (np.abs(found - length) > length / 2))
    if other.size:
        case = int(other[0])
        warnings.warn(
            f"The stenosis of case {case} is {found[case]:.2g} cm long, but the formula of the "
            f"pressure loss has L_s = {length:g} cm: set stenosis_length to that of the vessels.",
            PCNDEWarning,
            stacklevel=3,
        )


def measuring_positions(z: Array, area_undeformed: Array) -> tuple[Array, Array]:
    """Return the positions between which the drop of the narrowest stenosis is taken, cm.

    The positions are one healthy diameter beyond its :func:`ends`, but within the vessel.

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
    healthy, _ = areas_at_throats(z, area_undeformed)
    start, end = ends(z, area_undeformed)
    margin = diameter(healthy)
    return np.maximum(z[0], start - margin), np.minimum(z[-1], end + margin)
