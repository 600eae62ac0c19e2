"""Known units and their conversion to CGS."""

import math
import re
from collections.abc import Mapping
from typing import Any

from pcnde_bridge.data.variables import MMHG
from pcnde_bridge.errors import InputError

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
    "pressure": {"dyn/cm^2": 1.0, "Pa": 10.0, "kPa": 1e4, "mmHg": MMHG},
    "wall_shear_stress": {"dyn/cm^2": 1.0, "Pa": 10.0},
    "z": {"cm": 1.0, "mm": 0.1, "m": 100.0},
    "time": {"s": 1.0, "ms": 1e-3},
}
"""Known units of each quantity and their factors to CGS (cm, s, mL/s, cm², dyn/cm²)."""

_SYSTEMS = {
    "cgs": ("mL/s", "cm^2", "dyn/cm^2", "dyn/cm^2", "cm", "s"),
    "mm-g-s": ("mm^3/s", "mm^2", "Pa", "Pa", "mm", "s"),
    "si": ("m^3/s", "m^2", "Pa", "Pa", "m", "s"),
}

SYSTEMS: Mapping[str, Mapping[str, str]] = {
    name: dict(zip(FACTORS, units, strict=True)) for name, units in _SYSTEMS.items()
}
"""Systems of units by name."""


QUANTITIES = {"area_undeformed": "area", "period": "time"}
"""Quantities of arrays that have other names."""

SHAPES: Mapping[str, float] = {"area": 1.0, "radius": math.pi, "diameter": math.pi / 4}
"""Readings of a column of areas, with the area of a circle divided by the square of the length."""


def stated_units(units: str | Mapping[str, str] | None) -> dict[str, str]:
    """Return the units that the caller states, by quantity.

    A mapping also states the ``shape`` of an area: ``area``, ``radius`` or ``diameter``.

    Parameters
    ----------
    units : str, mapping or None
        Name of a system of units, or units by quantity; ``{"radius": "mm"}`` or
        ``{"diameter": "mm"}`` for lengths in place of areas.  As a text: ``"radius=mm,z=mm"``,
        or a system with additions and exceptions, ``"cgs,pressure=mmHg"``.

    Raises
    ------
    InputError
        If the system, a quantity or a unit is unknown.
    """
    if units is None:
        return {}
    stated: dict[str, str] = {}
    if not isinstance(units, Mapping):
        system, *pairs = (part.strip() for part in str(units).split(","))
        if "=" in system:
            pairs = [system, *pairs]
        elif system.lower() in SYSTEMS:
            stated |= SYSTEMS[system.lower()]
        else:
            raise InputError(
                f"Unknown units {units!r}; give one of {sorted(SYSTEMS)}, or a mapping such as "
                "{'pressure': 'mmHg'}."
            )
        if not all(all(pair.partition("=")) for pair in pairs):
            raise InputError(
                f"units= or --units must look like flow=mL/s,pressure=mmHg, got {units!r}."
            )
        names = [pair.partition("=")[0] for pair in pairs]
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(f"units names {twice[0]} twice, got {units!r}.")
        units = dict(pair.partition("=")[::2] for pair in pairs)
    known = {**FACTORS, **dict.fromkeys([*SHAPES][1:], FACTORS["z"])}
    for name, given in units.items():
        if name not in known:
            raise InputError(f"units names {name!r}; it can name {sorted(known)}.")
        unit = usual_spelling(str(given))
        if unit not in known[name]:
            raise InputError(f"Unknown unit {given!r} of {name}; known are {list(known[name])}.")
        if name not in SHAPES:
            stated[name] = unit
            continue
        if "shape" in stated:
            raise InputError(f"units names {stated['shape']} and {name}: an area has one unit.")
        stated |= {"shape": name, "area": unit if name == "area" else f"{unit}^2"}
    return stated


def in_cgs(name: str, values: Any, units: Mapping[str, str]) -> Any:
    """Convert the values of a quantity to CGS; quantities without a unit are in CGS.

    Parameters
    ----------
    name : str
        Name of the quantity.
    values : array or float
        Values; of an area, what the shape that the units state says.
    units : mapping of str to str
        Result of :func:`stated_units`.
    """
    factor = FACTORS[name][units.get(name, SYSTEMS["cgs"][name])]
    if name == "area" and (shape := units.get("shape", "area")) != "area":
        return SHAPES[shape] * factor * values**2
    return factor * values


def text_of(stated: Mapping[str, str], system: str = "") -> str:
    """Return the text that states units, the inverse of :func:`stated_units`.

    Parameters
    ----------
    stated : mapping of str to str
        Units by quantity and the shape of an area.  Empty units are known and not stated.
    system : str
        System that states further units.
    """
    pairs = {name: unit for name, unit in stated.items() if unit and name != "shape"}
    shape = stated.get("shape")
    if pairs.keys() >= FACTORS.keys():  # areas without a shape have the unit of their system
        named = {n: s for n, s in SYSTEMS.items() if shape or s["area"] == pairs["area"]}
        system = max(named, key=lambda name: len(named[name].items() & pairs.items()))
    parts = [system] * bool(system)
    for name, unit in pairs.items():
        if name == "area" and shape:
            parts.append(f"{shape}={unit if shape == 'area' else unit.removesuffix('^2')}")
        elif SYSTEMS.get(system, {}).get(name) != unit:
            parts.append(f"{name}={unit}")
    return ",".join(parts)


def option_of(stated: Mapping[str, str], quantity: str, unit: str) -> str:
    """Return the option that states a unit beside others, which are stated already.

    Areas in a unit of length are radii or diameters.
    """
    if quantity == "area" and unit in FACTORS["z"]:
        radius, diameter = (option_of(stated, shape, unit) for shape in ("radius", "diameter"))
        return f"{radius} for radii, or {diameter} for diameters"
    return f"--units {text_of({**stated, **stated_units({quantity: unit})})}"


def usual_spelling(unit: str) -> str:
    """Return ``cm^3/s`` for ``cm3/s``, ``cm³/s`` or ``cm**3 / s``, and ``mL/s`` for ``ml/s``."""
    plain = "".join(unit.split()).replace("²", "2").replace("³", "3").replace("**", "^")
    return re.sub(r"\b(m?)l\b", r"\1L", re.sub(r"(?<=[a-z])(?=\d)", "^", plain))
