"""Names and units of a data set's arrays."""

from __future__ import annotations

__all__ = ["SOLVER_LABELS", "UNITS", "VARIABLES"]

VARIABLES = ("flow", "area", "pressure")
"""What a model predicts, each (case, time, z)."""

UNITS = {
    "flow": "mL/s",
    "area": "cm^2",
    "pressure": "dyn/cm^2",
    "area_undeformed": "cm^2",
    "time": "s",
    "z": "cm",
}
"""The units of every array (CGS)."""

SOLVER_LABELS = ("periodicity", "volume_balance")
"""Labels by which the 1D solver judges its cases; they say nothing of a prediction of these."""
