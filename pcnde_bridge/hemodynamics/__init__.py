"""Vessel, inflow waveform, tube laws, pressure losses, outlets and the 1D solver.

Nothing is learned here: these are the equations of the field with known coefficients.
"""

from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import CoronaryOutlet, Reflection, Windkessel
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.synthetic import synthetic
from pcnde_bridge.hemodynamics.tube_laws import LinearWall, OlufsenWall
from pcnde_bridge.hemodynamics.waveform import Waveform, coronary

__all__ = [
    "CoronaryOutlet",
    "LinearWall",
    "OlufsenWall",
    "Reflection",
    "Stenosis",
    "Tube1D",
    "Vessel",
    "Waveform",
    "Windkessel",
    "coronary",
    "synthetic",
]
