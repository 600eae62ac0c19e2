"""Single vessels of svZeroDSolver: its JSON file with an inlet and an outlet, read and written.

Boundary conditions are FLOW or PRESSURE at the inlet, and RESISTANCE, RCR or CORONARY at the
outlet.  The elements of a vessel with area S, slope dp/dS of its wall and stenoses of areas S_t in
the healthy area S_D are

    R_poiseuille = 8πμ·∫dz/S²,   C = ∫dz/(dp/dS),   L = ρ·∫dz/S,
    stenosis_coefficient = ΣK_t·ρ/2·(1/S_t − 1/S_D)².

The files have no units; CGS is expected (mL/s, dyn/cm², cm).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import read_json, reading, write_json
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.discretization import Inlet
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import CoronaryOutlet, Outlet, Windkessel
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.tube_laws import LinearWall
from pcnde_bridge.hemodynamics.waveform import Waveform

# Names of svZeroDSolver in the order of the fields.
_OUTLETS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "RESISTANCE": (Windkessel, ("R", "", "", "Pd")),
    "RCR": (Windkessel, ("Rp", "Rd", "C", "Pd")),
    "CORONARY": (CoronaryOutlet, ("Ra1", "Ra2", "Rv1", "Ca", "Cc", "Pim", "P_v")),
}
_INLETS: dict[str, tuple[Inlet, str]] = {"FLOW": ("flow", "Q"), "PRESSURE": ("pressure", "P")}
_ELEMENTS = ("R_poiseuille", "C", "L", "stenosis_coefficient")
_FORMAT = "an input file of svZeroDSolver"
_SAMPLES = 200  # of a period in a written file


@dataclass(frozen=True)
class ZeroDVessel:
    """Vessel of svZeroDSolver with its boundary conditions.

    Attributes
    ----------
    waveform : Waveform
        Flow, mL/s, or pressure, dyn/cm², at the inlet.
    outlet : Windkessel or CoronaryOutlet
        Outlet.
    length : float
        Length, cm.
    elements : dict of str to float
        ``R_poiseuille`` (dyn·s/cm⁵), ``C`` (cm⁵/dyn), ``L`` (dyn·s²/cm⁵) and
        ``stenosis_coefficient``, pressure per Q·|Q| (dyn·s²/cm⁸); those absent are zero.
    inlet : {'flow', 'pressure'}
        Quantity of the waveform.
    name : str
        Name of the vessel.
    """

    waveform: Waveform
    outlet: Outlet
    length: float
    elements: dict[str, float] = field(default_factory=dict)
    inlet: Inlet = "flow"
    name: str = "vessel"

    @classmethod
    def of(
        cls, vessel: Vessel, waveform: Waveform, outlet: Outlet, tube: Tube1D, inlet: Inlet = "flow"
    ) -> ZeroDVessel:
        """Return the elements of an idealized vessel with the solver's blood and wall."""
        from scipy.integrate import trapezoid

        z = vessel.grid(1001)
        area = vessel.area_undeformed(z)
        loss = sum((1.0 / (1.0 - s.blockage) - 1.0) ** 2 for s in vessel.stenoses)
        values = (
            8.0 * np.pi * tube.viscosity * trapezoid(area**-2.0, z),
            trapezoid(1.0 / tube.wall.pressure_slope(area, area), z),
            tube.density * trapezoid(1.0 / area, z),
            tube.turbulent_coefficient * tube.density / 2.0 / vessel.healthy_area**2 * loss,
        )
        elements = dict(zip(_ELEMENTS, map(float, values), strict=True))
        return cls(waveform, outlet, vessel.length, elements, inlet)

    def geometry(self, tube: Tube1D, stenosis_length: float = 0.5) -> tuple[Vessel, LinearWall]:
        """Return a straight vessel and a wall with these elements and the solver's blood.

        The diameter follows from R_poiseuille, the wall's stiffness from C, and a stenosis in
        the middle from the stenosis coefficient; L is not used.

        Raises
        ------
        InputError
            If length, R_poiseuille or C is not positive.
        """
        resistance, capacity, _, loss = (self.elements.get(name, 0.0) for name in _ELEMENTS)
        if min(resistance, capacity, self.length) <= 0.0:
            raise InputError(f"{self.name} needs positive R_poiseuille, C and length, got {self}.")
        area = (8.0 * np.pi * tube.viscosity * self.length / resistance) ** 0.5
        radius, stiffness = float((area / np.pi) ** 0.5), 2.0 * area * self.length / capacity
        excess = area * (2.0 * loss / tube.turbulent_coefficient / tube.density) ** 0.5
        stenosis = Stenosis(float(excess / (1.0 + excess)), self.length / 2.0, stenosis_length)
        vessel = Vessel((stenosis,) if loss else (), self.length, 2.0 * radius)
        # The linear law depends on E, h and r₀ through k = 4/3·E·h/r₀ only; dS/dp = 2·S_u/k.
        return vessel, LinearWall(0.75 * stiffness, radius, radius)


def read_sv0d(path: StrPath, vessel: str | None = None) -> ZeroDVessel:
    """Read a vessel of svZeroDSolver's JSON file with its inlet and outlet.

    Parameters
    ----------
    path : path-like
        Input file of svZeroDSolver.
    vessel : str, optional
        Name of the vessel; may be left out if there is one.

    Raises
    ------
    FileError
        If the file is missing, damaged or of another format.
    InputError
        If there are several vessels and none is named, or it is not between two boundary
        conditions of the known types.
    """
    content = read_json(path, _FORMAT)
    with reading(path, _FORMAT):
        vessels = {str(entry["vessel_name"]): entry for entry in content["vessels"]}
        if vessel is None and len(vessels) == 1:
            (vessel,) = vessels
        if vessel not in vessels:
            raise InputError(f"name one of its vessels, {list(vessels)}, got {vessel!r}.")
        entry = vessels[vessel]
        conditions = {given["bc_name"]: given for given in content["boundary_conditions"]}
        ends = entry.get("boundary_conditions", {})
        inlet, outlet = (conditions.get(ends.get(end), {}) for end in ("inlet", "outlet"))
        kinds = inlet.get("bc_type"), outlet.get("bc_type")
        if kinds[0] not in _INLETS or kinds[1] not in _OUTLETS:
            raise InputError(
                f"{vessel} has the inlet {kinds[0]} and the outlet {kinds[1]}; the inlet must be "
                f"one of {list(_INLETS)}, the outlet one of {list(_OUTLETS)}."
            )
        (quantity, key), (law, keys) = _INLETS[kinds[0]], _OUTLETS[kinds[1]]
        period = float(np.ravel(inlet["bc_values"].get("t", 1.0))[-1])
        driven, *values = (
            _value(inlet["bc_values"], key, period),
            *(_value(outlet["bc_values"], key, period) for key in keys),
        )
        waveform = driven if isinstance(driven, Waveform) else Waveform(driven, period=period)
        elements = {k: float(v) for k, v in entry.get("zero_d_element_values", {}).items()}
        length = float(entry.get("vessel_length", 0.0))
        return ZeroDVessel(waveform, law(*values), length, elements, quantity, vessel)


def write_sv0d(path: StrPath, vessel: ZeroDVessel, *, cycles: int = 10) -> None:
    """Write a vessel as a JSON file that svZeroDSolver reads, atomically.

    Parameters
    ----------
    path : path-like
        File to write.
    vessel : ZeroDVessel
        Vessel with its boundary conditions; see :meth:`ZeroDVessel.of`.
    cycles : int
        Cardiac cycles that svZeroDSolver computes.

    Raises
    ------
    InputError
        If svZeroDSolver does not have the outlet.
    FileError
        If the file cannot be written.
    """
    outlet, period = vessel.outlet, vessel.waveform.period
    kind = "CORONARY" if isinstance(outlet, CoronaryOutlet) else "RCR"
    if isinstance(outlet, Windkessel) and not np.any(outlet.distal_resistance):
        kind = "RESISTANCE"
    law, keys = _OUTLETS[kind]
    if not isinstance(outlet, law):
        raise InputError(f"svZeroDSolver has no outlet {outlet!r}.")
    given = [getattr(outlet, entry.name) for entry in fields(outlet)]
    inlet, key = next((kind, key) for kind, (of, key) in _INLETS.items() if of == vessel.inlet)
    conditions = (
        ("INLET", inlet, _samples({key: vessel.waveform}, period)),
        ("OUTLET", kind, _samples(dict(zip(keys, given, strict=True)), period)),
    )
    content = {
        "boundary_conditions": [
            dict(zip(("bc_name", "bc_type", "bc_values"), condition, strict=True))
            for condition in conditions
        ],
        "simulation_parameters": {
            "number_of_cardiac_cycles": cycles,
            "number_of_time_pts_per_cardiac_cycle": _SAMPLES + 1,
        },
        "vessels": [
            {
                "boundary_conditions": {"inlet": "INLET", "outlet": "OUTLET"},
                "vessel_id": 0,
                "vessel_length": vessel.length,
                "vessel_name": vessel.name,
                "zero_d_element_type": "BloodVessel",
                "zero_d_element_values": vessel.elements,
            }
        ],
    }
    write_json(path, content)


def _value(values: dict[str, Any], key: str, period: float) -> float | Waveform:
    """Return a number, or the waveform of values that vary in time."""
    numbers = np.ravel(values[key] if key else 0.0).astype(float)
    if (numbers == numbers[0]).all():
        return float(numbers[0])
    return Waveform.from_samples(numbers, np.ravel(values["t"]), period, n_terms=None)


def _samples(values: dict[str, Any], period: float) -> dict[str, Any]:
    """Return values for the file: numbers, or lists with their times ``t``."""
    time = np.linspace(0.0, period, _SAMPLES + 1)
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Waveform):
            found |= {key: value.flow(time).tolist(), "t": time.tolist()}
        elif key:
            if np.size(value) != 1:
                raise InputError(f"A file of svZeroDSolver has one value of {key}, not {value!r}.")
            found[key] = float(np.ravel(value)[0])
    return found
