"""Files of other programs: results in, predictions out; one file for each format.

What all readers share stands in :mod:`~pcnde_bridge.io.vessel_results`, and for it in
:mod:`~pcnde_bridge.io.units` and :mod:`~pcnde_bridge.io.resampling`.
"""

from __future__ import annotations

from pcnde_bridge.io.csv import read_csv
from pcnde_bridge.io.hdf5 import read_hdf5
from pcnde_bridge.io.simvascular import (
    read_simvascular,
    write_pvd,
    write_vtp,
)
from pcnde_bridge.io.svonedsolver import read_sv1d
from pcnde_bridge.io.vessel_results import (
    VesselResults,
    read_labels,
    to_cases,
)

__all__ = [
    "VesselResults",
    "read_csv",
    "read_hdf5",
    "read_labels",
    "read_simvascular",
    "read_sv1d",
    "to_cases",
    "write_pvd",
    "write_vtp",
]
