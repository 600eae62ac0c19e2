"""Names and units of the arrays of a data set."""

VARIABLES = ("flow", "area", "pressure")
"""Variables that every model predicts, each of shape (case, time, z)."""

FIELDS = (*VARIABLES, "wall_shear_stress")
"""All variables, including the wall shear stress, which data sets and predictions may lack."""

UNITS = {
    "flow": "mL/s",
    "area": "cm^2",
    "pressure": "dyn/cm^2",
    "area_undeformed": "cm^2",
    "time": "s",
    "z": "cm",
    "wall_shear_stress": "dyn/cm^2",
}
"""Unit (CGS) of each array, in the order of the arguments of :class:`pcnde_bridge.Cases`."""

MMHG = 1333.22
"""1 mmHg in dyn/cm²."""

SOLVER_LABELS = ("periodicity", "volume_balance")
"""Labels with which the 1D solver reports its accuracy; predictions do not have them."""
