"""Reading data sets of HDF5 files."""

from __future__ import annotations

import h5py
import numpy as np

from pcnde_bridge._utils import hdf5


def test_large_numbers_stay_on_disk_where_they_are_stored(tmp_path, monkeypatch):
    """A data set that was never written has no place in the file; it is zero."""
    monkeypatch.setattr(hdf5, "SMALLEST_MAP", 1)
    values = np.arange(12.0).reshape(3, 4)
    with h5py.File(tmp_path / "a.h5", "w", userblock_size=512) as file:
        file["stored"] = values
        file.create_dataset("packed", data=values, compression="gzip")
        file.create_dataset("empty", (3, 4), "<f8")
    with h5py.File(tmp_path / "a.h5") as file:
        found = {name: hdf5.read_dataset(file, name) for name in file}
    for name, expected in (("stored", values), ("packed", values), ("empty", 0 * values)):
        assert np.array_equal(found[name], expected), name
        assert isinstance(found[name], np.memmap) == (name == "stored")
