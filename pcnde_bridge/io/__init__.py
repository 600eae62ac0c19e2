"""Data sets by name, results of other programs, and prediction files.

Each format has its own module; every reader ends in :func:`to_cases`, which checks units,
direction of the flow, the cycle and the grid.
"""

from pcnde_bridge.io.assemble import to_cases
from pcnde_bridge.io.centerlines import write_pvd, write_vtp
from pcnde_bridge.io.csv import read_csv
from pcnde_bridge.io.datasets import download_published, find_published, load_cases
from pcnde_bridge.io.hdf5 import read_hdf5
from pcnde_bridge.io.simvascular import read_simvascular
from pcnde_bridge.io.svonedsolver import read_sv1d
from pcnde_bridge.io.svzerodsolver import ZeroDVessel, read_sv0d, write_sv0d
from pcnde_bridge.io.tables import read_labels
from pcnde_bridge.io.vessel_results import VesselResults

__all__ = [
    "VesselResults",
    "ZeroDVessel",
    "download_published",
    "find_published",
    "load_cases",
    "read_csv",
    "read_hdf5",
    "read_labels",
    "read_simvascular",
    "read_sv0d",
    "read_sv1d",
    "to_cases",
    "write_pvd",
    "write_sv0d",
    "write_vtp",
]
