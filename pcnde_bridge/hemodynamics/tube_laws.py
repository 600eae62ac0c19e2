"""Wall laws: pressure p from area S and undeformed area S_u, and the inverse.

The two laws of the paper's section 2.1 (Olufsen 1999; Pfaller et al. 2022) have the form
p = p₀ + k·ε(λ) with the stretch λ = √(S/S_u) of the radius:

    linear    k = 4/3·E·h/r₀                      ε = λ − 1
    Olufsen   k = 4/3·(k₁·exp(k₂·r₀(z)) + k₃)     ε = 1 − 1/λ,   r₀ = √(S_u/π)

Both strains are (λᵐ − 1)/m, with m = 1 and m = −1.
The reference pressure p₀ is the pressure at which the wall is undeformed.  The
paper prints 100 mmHg (:data:`PAPER_REFERENCE_PRESSURE`); its 3D data have zero.

The 1D solver adds the viscous stress of a Kelvin–Voigt wall, p = p₀ + k·(ε + τ·∂ε/∂t); the
methods here give the elastic pressure.  Every parameter is one number, or an array
that broadcasts to (case, z): a plaque or a stent along z, or one wall for each case.

Only arithmetic operators are used, so that every method takes numpy and JAX
arrays alike.  Units are CGS: dyn/cm², cm², cm/s.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from pcnde_bridge._utils.validation import check_fields, check_values, finite, finite_array

PAPER_REFERENCE_PRESSURE = 133_322.0
"""100 mmHg in dyn/cm²."""


class WallAt(NamedTuple):
    """Wall at some places: arrays that broadcast.

    Attributes
    ----------
    exponent : int
        m of the strain ε = (λᵐ − 1)/m.
    undeformed : array
        S_u, cm².
    stiffness, rest : array
        k and p₀, dyn/cm².
    retardation : array or None
        τ, s; None is an elastic wall.
    """

    exponent: int
    undeformed: Any
    stiffness: Any
    rest: Any
    retardation: Any

    def pressure(self, area: Any) -> Any:
        """Return the pressure p(S), dyn/cm²."""
        strain = (((area / self.undeformed) ** 0.5) ** self.exponent - 1.0) / self.exponent
        return self.rest + self.stiffness * strain

    def area(self, pressure: Any) -> Any:
        """Return the area S(p), cm², negative beyond the end of the law."""
        strain = (pressure - self.rest) / self.stiffness
        stretch = (1.0 + self.exponent * strain) ** self.exponent  # m = 1/m
        return self.undeformed * stretch * abs(stretch)

    def slope(self, area: Any) -> Any:
        """Return dp/dS, dyn/cm⁴."""
        return self.stiffness * ((area / self.undeformed) ** 0.5) ** self.exponent / (2.0 * area)

    def damping(self, area: Any) -> Any:
        """Return the viscous pressure per ∂S/∂t, dyn·s/cm⁴."""
        return 0.0 * area if self.retardation is None else self.retardation * self.slope(area)


class _WallLaw(ABC):
    """Wall law; its methods take areas S > 0 and S_u, cm², that broadcast."""

    exponent: ClassVar[int]
    reference_pressure: npt.ArrayLike
    retardation_time: npt.ArrayLike

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Self:
        """Return a wall with these parameters unchecked: arrays of any kind."""
        wall = object.__new__(cls)
        wall.__dict__.update(parameters)
        return wall

    @abstractmethod
    def stiffness(self, area_undeformed: Any) -> Any:
        """Return the stiffness k, dyn/cm²."""

    def at(self, area_undeformed: Any) -> WallAt:
        """Return the wall at places of undeformed area S_u, cm²."""
        stiffness = self.stiffness(area_undeformed)
        numbers = stiffness, self.reference_pressure, self.retardation_time
        return WallAt(self.exponent, area_undeformed, *numbers)

    def pressure(self, area: Any, area_undeformed: Any) -> Any:
        """Return the pressure p(S), dyn/cm², of areas S > 0 and S_u, cm², that broadcast."""
        return self.at(area_undeformed).pressure(area)

    def area(self, pressure: Any, area_undeformed: Any) -> Any:
        """Return the area S(p), cm², negative beyond the pressure at which the law ends.

        The linear law ends with S = 0 at p₀ − k, Olufsen's with S = ∞ at p₀ + k.
        """
        return self.at(area_undeformed).area(pressure)

    def pressure_slope(self, area: Any, area_undeformed: Any) -> Any:
        """Return the slope dp/dS, dyn/cm⁴."""
        return self.at(area_undeformed).slope(area)

    def wave_speed(self, area: Any, area_undeformed: Any, density: float = 1.06) -> Any:
        """Return the pulse wave speed √(S/ρ · dp/dS), cm/s."""
        return (area / density * self.pressure_slope(area, area_undeformed)) ** 0.5


@dataclass(frozen=True)
class LinearWall(_WallLaw):
    """Linear elastic wall; the default is the paper's artery, undeformed at zero pressure.

    Attributes
    ----------
    young_modulus, thickness : float or array_like
        E (dyn/cm²) and h (cm).
    radius : float, array_like or None
        r₀, cm; None is the undeformed radius √(S_u/π) of each place.
    reference_pressure : float or array_like
        p₀, at which S = S_u, dyn/cm².
    retardation_time : float or array_like
        τ of the Kelvin–Voigt wall, s: its viscosity, dyn·s/cm², over E.  The coefficient Γ of
        p = … + Γ/(S_u·√S)·∂S/∂t is 2/3·√π·h·E·τ.

    Raises
    ------
    InputError
        If a number is not finite, E, h or r₀ is not positive, or τ is negative.
    """

    exponent: ClassVar[int] = 1
    young_modulus: npt.ArrayLike = 1.5e7
    thickness: npt.ArrayLike = 0.05
    radius: npt.ArrayLike | None = 0.2
    reference_pressure: npt.ArrayLike = 0.0
    retardation_time: npt.ArrayLike = 0.0

    def __post_init__(self) -> None:
        check_fields(self, _positive, young_modulus="dyn/cm²", thickness="cm")
        if self.radius is not None:
            check_fields(self, _positive, radius="cm")
        check_fields(self, _finite, reference_pressure="dyn/cm²")
        check_fields(self, _not_negative, retardation_time="s")

    def stiffness(self, area_undeformed: Any) -> Any:
        """Return 4/3·E·h/r₀, dyn/cm²."""
        radius: Any = (area_undeformed / math.pi) ** 0.5 if self.radius is None else self.radius
        modulus: Any = self.young_modulus
        return 4.0 / 3.0 * modulus * self.thickness / radius


@dataclass(frozen=True)
class OlufsenWall(_WallLaw):
    """Olufsen's wall law: stiffness decreases with the radius and increases with strain.

    The default coefficients are those fitted by Olufsen (1999).

    Attributes
    ----------
    k1, k2, k3 : float or array_like
        g/(s²·cm), 1/cm and g/(s²·cm).
    reference_pressure, retardation_time : float or array_like
        As of :class:`LinearWall`.

    Raises
    ------
    InputError
        If a number is not finite, k₁ or τ is negative, k₂ positive, or k₃ not positive.
    """

    exponent: ClassVar[int] = -1
    k1: npt.ArrayLike = 2.0e7
    k2: npt.ArrayLike = -22.53
    k3: npt.ArrayLike = 8.65e5
    reference_pressure: npt.ArrayLike = 0.0
    retardation_time: npt.ArrayLike = 0.0

    def __post_init__(self) -> None:
        check_fields(self, _not_negative, k1="g/(s²·cm)", retardation_time="s")
        check_fields(self, _positive, k3="g/(s²·cm)")
        check_fields(self, _not_positive, k2="1/cm")
        check_fields(self, _finite, reference_pressure="dyn/cm²")

    def stiffness(self, area_undeformed: Any) -> Any:
        """Return 4/3·(k₁·exp(k₂·r₀) + k₃), dyn/cm²."""
        radius = (area_undeformed / math.pi) ** 0.5
        return 4.0 / 3.0 * (self.k1 * math.e ** (self.k2 * radius) + self.k3)


Wall = LinearWall | OlufsenWall
"""A wall law."""


def _finite(name: str, value: Any, unit: str) -> Any:
    """Return a number as a float, or an array of numbers."""
    return finite(name, value, unit) if np.ndim(value) == 0 else finite_array(name, value)


def _positive(name: str, value: Any, unit: str) -> Any:
    return _refuse(np.less_equal, f"must be positive ({unit})", name, value, unit)


def _not_negative(name: str, value: Any, unit: str) -> Any:
    return _refuse(np.less, f"must not be negative ({unit})", name, value, unit)


def _not_positive(name: str, value: Any, unit: str) -> Any:
    return _refuse(np.greater, f"must not be positive ({unit})", name, value, unit)


def _refuse(compare: Any, rule: str, name: str, value: Any, unit: str) -> Any:
    value = _finite(name, value, unit)
    array = np.asarray(value)
    check_values(name, array, compare(array, 0.0), f"{name.rpartition('.')[2]} {rule}")
    return value
