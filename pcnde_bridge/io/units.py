"""Units of other programs' results: conversion to CGS and plausibility checks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pcnde_bridge.errors import InputError
from pcnde_bridge.io.vessel_results import VesselResults

FACTORS: Mapping[str, Mapping[str, float]] = {
    "flow": {
        "mL/s": 1.0,
        "cm^3/s": 1.0,
        "mm^3/s": 1e-3,
        "m^3/s": 1e6,
        "mL/min": 1 / 60,
        "L/min": 1e3 / 60,
    },
    "area": {"cm^2": 1.0, "mm^2": 1e-2, "m^2": 1e4},
    "pressure": {"dyn/cm^2": 1.0, "Pa": 10.0, "kPa": 1e4, "mmHg": 1333.22},
    "z": {"cm": 1.0, "mm": 0.1, "m": 100.0},
    "time": {"s": 1.0, "ms": 1e-3},
}
"""Known units of each quantity and their factors to CGS (cm, s, mL/s, cm², dyn/cm²)."""

SYSTEMS: Mapping[str, Mapping[str, str]] = {
    "cgs": {"flow": "mL/s", "area": "cm^2", "pressure": "dyn/cm^2", "z": "cm", "time": "s"},
    "mm-g-s": {"flow": "mm^3/s", "area": "mm^2", "pressure": "Pa", "z": "mm", "time": "s"},
    "si": {"flow": "m^3/s", "area": "m^2", "pressure": "Pa", "z": "m", "time": "s"},
}
"""Systems of units by name."""

# Usual ranges in arteries: pressure of 20 … 300 mmHg, flow of a small branch … of the aorta,
# area of a diameter of 0.25 mm … 7 cm.
_USUAL = {
    "pressure": ("the median pressure", 2.67e4, 4e5),
    "flow": ("the median flow", 1e-3, 300.0),
    "area": ("the median undeformed area", 5e-4, 40.0),
    "z": ("the length of the vessel", 0.1, 150.0),
    "time": ("the length of the recording", 0.1, 60.0),
}
_USUAL_SPEED = (1.0, 300.0)  # cm/s
_USUAL_SLENDERNESS = (0.3, 90.0)  # length over diameter


def stated_units(units: str | Mapping[str, str] | None) -> dict[str, str]:
    """Return the units that the caller states, by quantity.

    Parameters
    ----------
    units : str, mapping or None
        Name of a system of units, or units by quantity.

    Raises
    ------
    InputError
        If the system, a quantity or a unit is unknown.
    """
    if units is None:
        return {}
    if isinstance(units, str):
        if units not in SYSTEMS:
            raise InputError(
                f"Unknown units {units!r}; give one of {sorted(SYSTEMS)}, or a mapping such as "
                "{'pressure': 'mmHg'}."
            )
        return dict(SYSTEMS[units])
    if not isinstance(units, Mapping):
        raise InputError(f"units must be a name or a mapping, got {units!r}.")
    for name, unit in units.items():
        if name not in FACTORS:
            raise InputError(f"units names {name!r}; it can name {sorted(FACTORS)}.")
        if unit not in FACTORS[name]:
            raise InputError(f"Unknown unit {unit!r} of {name}; known are {list(FACTORS[name])}.")
    return dict(units)


def in_cgs(vessel: VesselResults, stated: Mapping[str, str]) -> VesselResults:
    """Convert results to CGS from the units that the caller, or else the file, states."""
    unit = {**SYSTEMS["cgs"], **vessel.units, **stated}
    factor = {name: FACTORS[name][unit[name]] for name in FACTORS}
    factor["area_undeformed"] = factor["area"]
    arrays: dict[str, Any] = {name: f * getattr(vessel, name) for name, f in factor.items()}
    period = None if vessel.period is None else vessel.period * factor["time"]
    return dataclasses.replace(vessel, **arrays, period=period)


def check_units(vessel: VesselResults, stated: set[str]) -> None:
    """Raise if numbers of unstated units are unusual for arteries in CGS units.

    Parameters
    ----------
    vessel : VesselResults
        Results, taken to be in CGS units.
    stated : set of str
        Quantities whose units are stated; these are not checked.

    Raises
    ------
    InputError
        If a number is unusual; the message suggests a unit in which it is usual.
    """
    area = float(np.median(vessel.area_undeformed))
    sizes = {
        "pressure": float(np.median(np.abs(vessel.pressure))),
        "flow": float(np.median(np.abs(vessel.flow))),
        "area": area,
        "z": float(np.ptp(vessel.z)),
        "time": float(np.ptp(vessel.time)),
    }
    doubts = [
        _doubt(name, what, sizes[name], low, high)
        for name, (what, low, high) in _USUAL.items()
        if name not in stated and sizes[name] > 0
    ]
    if not any(doubts):
        # Numbers that are usual each by itself may still be inconsistent.
        if not {"flow", "area"} <= stated and sizes["flow"] > 0:
            doubts.append(_doubt("flow", "flow over area", sizes["flow"], *_USUAL_SPEED, area))
        if not {"z", "area"} <= stated:
            what, diameter = "the length over the diameter", math.sqrt(4 / math.pi * area)
            doubts.append(_doubt("z", what, sizes["z"], *_USUAL_SLENDERNESS, diameter))
        if "area" not in stated and not 0.2 <= (ratio := np.median(vessel.area) / area) <= 5:
            doubts.append(f"the median area is {ratio:.3g} times the undeformed one")
    if found := [doubt for doubt in doubts if doubt]:
        raise InputError(
            f"this does not look like CGS units (cm, s, mL/s, cm², dyn/cm²): {'; '.join(found)}. "
            "State the units, or units='cgs' (--units cgs) if they are."
        )


def _doubt(name: str, what: str, size: float, low: float, high: float, over: float = 1.0) -> str:
    """Describe an unusual number and a unit in which it is usual; empty if it is usual."""
    if low <= size / over <= high:
        return ""
    usual = [unit for unit, f in FACTORS[name].items() if low <= f * size / over <= high]
    if not usual:
        return f"{what} is {size / over:.4g}, which is unusual in every known unit"
    return (
        f"{what} is {size / over:.4g}; in {usual[0]} it would be usual: "
        f"units={{'{name}': '{usual[0]}'}} (--units {name}={usual[0]})"
    )
