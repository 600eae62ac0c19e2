"""Files of other programs: results in, predictions out; one file for each format.

What all readers share stands in :mod:`~pcnde_bridge.formats.results`, and for it in
:mod:`~pcnde_bridge.formats.units` and :mod:`~pcnde_bridge.formats.resampling`.
"""

from __future__ import annotations

from pcnde_bridge.formats.csv import read_csv
from pcnde_bridge.formats.hdf5 import read_hdf5
from pcnde_bridge.formats.results import VesselResults, read_labels, to_cases
from pcnde_bridge.formats.simvascular import read_simvascular, write_pvd, write_vtp
from pcnde_bridge.formats.sv1d import read_sv1d

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
