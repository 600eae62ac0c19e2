"""Outlets of the 1D solver: a resistance or a three-element Windkessel."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import finite_array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError


class OutletElements(NamedTuple):
    """Elements of an outlet, one value for each case.

    Attributes
    ----------
    proximal, distal : array of shape (case,)
        R and R_d, dyn·s/cm⁵.
    delay : array of shape (case,)
        Time constant R_d·C, s.
    distal_pressure : array of shape (case,)
        p_d, dyn/cm².
    """

    proximal: Any
    distal: Any
    delay: Any
    distal_pressure: Any


@dataclass(frozen=True)
class Windkessel:
    """Outlet with a resistance, or a three-element Windkessel, and a distal pressure.

    p = R·Q + p_c,  C·dp_c/dt = Q − (p_c − p_d)/R_d.  Without R_d this is the
    resistance outlet p = R·Q + p_d.

    Attributes
    ----------
    resistance : float or array_like, shape (n_cases,)
        R, dyn·s/cm⁵; the proximal one of three elements.
    distal_resistance : float or array_like, shape (n_cases,)
        R_d, dyn·s/cm⁵.
    capacitance : float or array_like, shape (n_cases,)
        C, cm⁵/dyn.
    distal_pressure : float or array_like, shape (n_cases,)
        p_d, dyn/cm².
    """

    resistance: npt.ArrayLike
    distal_resistance: npt.ArrayLike = 0.0
    capacitance: npt.ArrayLike = 0.0
    distal_pressure: npt.ArrayLike = 0.0

    def elements(self, n_cases: int) -> OutletElements:
        """Check the values and broadcast them to all cases.

        Raises
        ------
        InputError
            If a value is not finite, a resistance or the capacitance is negative, or an
            array has neither one value nor one for each case.
        """
        proximal, distal, capacitance, pressure = (
            self._for_cases(field.name, n_cases) for field in fields(self)
        )
        return OutletElements(proximal, distal, distal * capacitance, pressure)

    def _for_cases(self, name: str, n_cases: int) -> Array:
        value = finite_array(f"outlet.{name}", getattr(self, name))
        if value.ndim > 1 or value.size not in (1, n_cases):
            wanted = f"one number or one for each of {n_cases} cases"
            raise InputError(f"outlet.{name} must be {wanted}, got shape {value.shape}.")
        if name != "distal_pressure" and (value < 0.0).any():
            raise InputError(f"outlet.{name} must not be negative, got {value.min():g}.")
        return np.broadcast_to(value, (n_cases,))


def outlet_resistance(cases: Cases) -> float:
    """Return the resistance that fits p = R·Q at the outlet of all cases best, dyn·s/cm⁵.

    Raises
    ------
    InputError
        If no blood flows out, or the flow is against the pressure.
    """
    flow, pressure = cases.flow[:, :, -1].ravel(), cases.pressure[:, :, -1].ravel()
    if not flow @ pressure > 0.0:
        raise InputError("The data's outlet flow and pressure give no resistance; give an outlet.")
    return float(flow @ pressure / (flow @ flow))
