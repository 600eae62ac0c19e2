"""Names and units of the arrays of a data set."""

from __future__ import annotations

__all__ = ["MMHG", "SOLVER_LABELS", "UNITS", "VARIABLES"]

VARIABLES = ("flow", "area", "pressure")
"""Variables that a model predicts, each of shape (case, time, z)."""

UNITS = {
    "flow": "mL/s",
    "area": "cm^2",
    "pressure": "dyn/cm^2",
    "area_undeformed": "cm^2",
    "time": "s",
    "z": "cm",
}
"""Unit (CGS) of each array."""

MMHG = 1333.22
"""1 mmHg in dyn/cm²."""

SOLVER_LABELS = ("periodicity", "volume_balance")
"""Labels with which the 1D solver reports its accuracy; predictions do not have them."""
