"""Wall laws: pressure p from area S and undeformed area S_u, and the inverse.

The two laws of the paper's section 2.1 (Olufsen 1999; Pfaller et al. 2022):

    linear    p = p₀ + 4/3·(E·h/r₀)·(√(S/S_u) − 1)
    Olufsen   p = p₀ + 4/3·(k₁·exp(k₂·r₀(z)) + k₃)·(1 − √(S_u/S)),   r₀ = √(S_u/π)

The reference pressure p₀ is the pressure at which the wall is undeformed.  The
paper prints 100 mmHg (:data:`PAPER_REFERENCE_PRESSURE`); its 3D data have zero.

Only arithmetic operators are used, so that every method takes numpy and JAX
arrays alike.  Units are CGS: dyn/cm², cm², cm/s.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from pcnde_bridge._utils.validation import check_fields, finite, positive
from pcnde_bridge.errors import InputError

PAPER_REFERENCE_PRESSURE = 133_322.0
"""100 mmHg in dyn/cm²."""


class _WallLaw(ABC):
    """Wall law; its methods take areas S > 0 and S_u, cm², that broadcast."""

    @abstractmethod
    def pressure_slope(self, area: Any, area_undeformed: Any) -> Any:
        """Return the slope dp/dS, dyn/cm⁴."""

    def wave_speed(self, area: Any, area_undeformed: Any, density: float = 1.06) -> Any:
        """Return the pulse wave speed √(S/ρ · dp/dS), cm/s."""
        return (area / density * self.pressure_slope(area, area_undeformed)) ** 0.5


@dataclass(frozen=True)
class LinearWall(_WallLaw):
    """Linear elastic wall; the default is the paper's artery, undeformed at zero pressure.

    Attributes
    ----------
    young_modulus, thickness, radius : float
        E (dyn/cm²), h (cm) and r₀ (cm).
    reference_pressure : float
        p₀, at which S = S_u, dyn/cm².

    Raises
    ------
    InputError
        If E, h, r₀ or p₀ is not a finite number, or one of the first three not positive.
    """

    young_modulus: float = 1.5e7
    thickness: float = 0.05
    radius: float = 0.2
    reference_pressure: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, positive, young_modulus="dyn/cm²", thickness="cm", radius="cm")
        check_fields(self, finite, reference_pressure="dyn/cm²")

    @property
    def stiffness(self) -> float:
        """4/3·E·h/r₀, dyn/cm²."""
        return 4.0 / 3.0 * self.young_modulus * self.thickness / self.radius

    def pressure(self, area: Any, area_undeformed: Any) -> Any:
        """Return the pressure p(S), dyn/cm², of areas S > 0 and S_u, cm², that broadcast."""
        return self.reference_pressure + self.stiffness * ((area / area_undeformed) ** 0.5 - 1.0)

    def area(self, pressure: Any, area_undeformed: Any) -> Any:
        """Return the area S(p), cm².

        The law ends with S = 0 at p = p₀ − 4/3·E·h/r₀; below it S < 0.
        """
        strain = (pressure - self.reference_pressure) / self.stiffness
        return area_undeformed * _signed_square(1.0 + strain)

    def pressure_slope(self, area: Any, area_undeformed: Any) -> Any:
        """Return the slope dp/dS, dyn/cm⁴."""
        return 0.5 * self.stiffness / (area * area_undeformed) ** 0.5


@dataclass(frozen=True)
class OlufsenWall(_WallLaw):
    """Olufsen's wall law: stiffness decreases with the radius and increases with strain.

    The default coefficients are those fitted by Olufsen (1999).

    Attributes
    ----------
    k1, k2, k3 : float
        g/(s²·cm), 1/cm and g/(s²·cm).
    reference_pressure : float
        p₀, at which S = S_u, dyn/cm².

    Raises
    ------
    InputError
        If a number is not finite, k₁ is negative, k₂ positive, or k₃ not positive.
    """

    k1: float = 2.0e7
    k2: float = -22.53
    k3: float = 8.65e5
    reference_pressure: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, positive, k3="g/(s²·cm)")
        check_fields(self, finite, k1="g/(s²·cm)", k2="1/cm", reference_pressure="dyn/cm²")
        if self.k1 < 0.0 or self.k2 > 0.0:
            rule = "k1 must not be negative, and k2 must not be positive"
            raise InputError(f"{rule} in OlufsenWall, got {self.k1!r} and {self.k2!r}.")

    def stiffness(self, area_undeformed: Any) -> Any:
        """Return 4/3·(k₁·exp(k₂·r₀) + k₃), dyn/cm²."""
        radius = (area_undeformed / math.pi) ** 0.5
        return 4.0 / 3.0 * (self.k1 * math.e ** (self.k2 * radius) + self.k3)

    def pressure(self, area: Any, area_undeformed: Any) -> Any:
        """Return the pressure p(S), dyn/cm², of areas S > 0 and S_u, cm², that broadcast."""
        strain = 1.0 - (area_undeformed / area) ** 0.5
        return self.reference_pressure + self.stiffness(area_undeformed) * strain

    def area(self, pressure: Any, area_undeformed: Any) -> Any:
        """Return the area S(p), cm².

        The law ends with S = ∞ at p = p₀ + 4/3·(k₁·exp(k₂·r₀) + k₃); above it S < 0.
        """
        strain = (pressure - self.reference_pressure) / self.stiffness(area_undeformed)
        return area_undeformed / _signed_square(1.0 - strain)

    def pressure_slope(self, area: Any, area_undeformed: Any) -> Any:
        """Return the slope dp/dS, dyn/cm⁴."""
        return 0.5 * self.stiffness(area_undeformed) * (area_undeformed / area) ** 0.5 / area


Wall = LinearWall | OlufsenWall
"""A wall law."""


def _signed_square(root: Any) -> Any:
    """Square with the sign of its argument: pressures beyond a law's end give S < 0."""
    return root * abs(root)
