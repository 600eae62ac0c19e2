"""Idealized stenosed vessels: a straight tube with any number of narrowings.

The narrowing is the one of Sherwin et al. (2003) that the paper uses, in the form
measured on the paper's data: with x the distance from the throat and L_s the
length of the stenosis, the radius is

    r(x) = r_min + (r₀ − r_min)·sin²(πx/L_s),  |x| ≤ L_s/2,   r_min = r₀·√(1 − β),

where the blockage β is a fraction of **area**.  Units are CGS.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import (
    all_of,
    check_fields,
    check_values,
    finite,
    positive,
    real_array,
    whole,
)
from pcnde_bridge.errors import InputError


@dataclass(frozen=True)
class Stenosis:
    """Narrowing of a vessel.

    Attributes
    ----------
    blockage : float
        Fraction of the healthy area that is blocked at the throat, in [0, 1).
    position : float
        Distance of the throat from the inlet, cm.
    length : float
        Length L_s, cm.

    Raises
    ------
    InputError
        If a value is not a finite number, the blockage outside [0, 1) or the length not positive.
    """

    blockage: float
    position: float = 2.0
    length: float = 0.5

    def __post_init__(self) -> None:
        check_fields(self, finite, blockage="", position="cm")
        check_fields(self, positive, length="cm")
        if not 0.0 <= self.blockage < 1.0:
            raise InputError(
                f"Stenosis.blockage is a fraction of area in [0, 1), got {self.blockage!r}; "
                "a percentage must be divided by 100."
            )

    @property
    def start(self) -> float:
        """Distance of the upstream edge from the inlet, cm."""
        return self.position - self.length / 2

    @property
    def end(self) -> float:
        """Distance of the downstream edge from the inlet, cm."""
        return self.position + self.length / 2


@dataclass(frozen=True)
class Vessel:
    """Straight tube, healthy or with stenoses; the default is the paper's tube.

    Attributes
    ----------
    stenoses : tuple of Stenosis
        Any number of stenoses, which must neither overlap nor leave the tube.
    length, diameter : float
        Length of the tube and diameter of its healthy cross-section, cm.

    Raises
    ------
    InputError
        If a size is not positive, or a stenosis overlaps another or an end.

    Examples
    --------
    >>> from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
    >>> vessel = Vessel((Stenosis(blockage=0.75),))
    >>> float(vessel.area_undeformed([2.0])[0] / vessel.healthy_area)
    0.25
    """

    stenoses: tuple[Stenosis, ...] = ()
    length: float = 4.0
    diameter: float = 0.4

    def __post_init__(self) -> None:
        object.__setattr__(self, "stenoses", all_of(Stenosis, "Vessel.stenoses", self.stenoses))
        check_fields(self, positive, length="cm", diameter="cm")
        for i, stenosis in enumerate(self.stenoses):
            if stenosis.start < 0.0 or stenosis.end > self.length:
                raise InputError(
                    f"Vessel.stenoses[{i}] reaches from {stenosis.start:g} to {stenosis.end:g} cm, "
                    f"outside the tube of {self.length:g} cm; move or shorten it."
                )
        ordered = sorted(self.stenoses, key=lambda s: s.position)
        for upstream, downstream in pairwise(ordered):
            if upstream.end > downstream.start:
                places = f"{upstream.position:g} and {downstream.position:g} cm"
                raise InputError(f"The stenoses at {places} overlap; move or shorten one of them.")

    @property
    def healthy_area(self) -> float:
        """Cross-section S_D without a stenosis, cm²."""
        return math.pi * self.diameter**2 / 4

    @property
    def blockage(self) -> float:
        """Largest blockage of all stenoses; 0 for a healthy vessel."""
        return max((s.blockage for s in self.stenoses), default=0.0)

    def grid(self, n_points: int = 101) -> Array:
        """Return equally spaced points from inlet to outlet, cm, shape (n_points,)."""
        return np.linspace(0.0, self.length, whole("n_points", n_points, 2))

    def radius_undeformed(self, z: npt.ArrayLike) -> Array:
        """Return the radius of the unloaded tube, cm, shape (...).

        Parameters
        ----------
        z : array_like of float, shape (...)
            Distance from the inlet, cm, within the tube.

        Raises
        ------
        InputError
            If a point is not a real number, or lies outside the tube.
        """
        z = real_array("z", z)
        tolerance = 1e-9 * self.length
        outside = ~((z >= -tolerance) & (z <= self.length + tolerance))
        check_values("z", z, outside, f"points must lie in the tube of {self.length:g} cm")
        healthy = self.diameter / 2
        radius = np.full(z.shape, healthy)
        for stenosis in self.stenoses:
            throat = healthy * math.sqrt(1.0 - stenosis.blockage)
            x = z - stenosis.position
            narrowed = throat + (healthy - throat) * np.sin(np.pi * x / stenosis.length) ** 2
            radius = np.where(np.abs(x) <= stenosis.length / 2, narrowed, radius)
        return radius

    def area_undeformed(self, z: npt.ArrayLike) -> Array:
        """Return the cross-section S_u of the unloaded tube, cm²; see :meth:`radius_undeformed`."""
        return np.asarray(np.pi * self.radius_undeformed(z) ** 2)
