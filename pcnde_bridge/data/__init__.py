"""The data set: the container ``Cases``, its checks, grid, files, splits and indices.

Arrays have the axes (case, time, z) and CGS units; all data enter the package through ``Cases``.
"""

from pcnde_bridge.data.cases import Cases, Split
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import UNITS, VARIABLES

__all__ = ["UNITS", "VARIABLES", "Cases", "Grid", "Split", "UnitsWarning"]
