"""The data set: the container ``Cases``, its checks, grid, files and splits.

Arrays are (case, time, z) in CGS units; every entry of data into the package ends here.
"""

from pcnde_bridge.data.cases import Cases, Split
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import UNITS, VARIABLES

__all__ = ["UNITS", "VARIABLES", "Cases", "Grid", "Split", "UnitsWarning"]
