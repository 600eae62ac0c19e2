"""Known units and their conversion to CGS."""

import re
from collections.abc import Mapping

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
    if not isinstance(units, Mapping):
        if units not in list(SYSTEMS):
            raise InputError(
                f"Unknown units {units!r}; give one of {sorted(SYSTEMS)}, or a mapping such as "
                "{'pressure': 'mmHg'}."
            )
        return dict(SYSTEMS[units])
    for name, unit in units.items():
        if name not in FACTORS:
            raise InputError(f"units names {name!r}; it can name {sorted(FACTORS)}.")
        if unit not in FACTORS[name]:
            raise InputError(f"Unknown unit {unit!r} of {name}; known are {list(FACTORS[name])}.")
    return dict(units)


def factors_to_cgs(units: Mapping[str, str]) -> dict[str, float]:
    """Return the factor to CGS of every quantity; quantities without a unit are in CGS."""
    unit = {**SYSTEMS["cgs"], **units}
    return {name: FACTORS[name][unit[name]] for name in FACTORS}


def usual_spelling(unit: str) -> str:
    """Return ``cm^3/s`` for ``cm3/s``, ``cm³/s`` or ``cm**3 / s``, and ``mL/s`` for ``ml/s``."""
    plain = "".join(unit.split()).replace("²", "2").replace("³", "3").replace("**", "^")
    return re.sub(r"\b(m?)l\b", r"\1L", re.sub(r"(?<=[a-z])(?=\d)", "^", plain))
