"""Files of a data set: round trips, damage, versions."""

from __future__ import annotations

import contextlib

import h5py
import numpy as np
import pandas as pd
import pytest

from pcnde_bridge._utils import hdf5
from pcnde_bridge.data import files as case_files
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.files import FORMAT_VERSION
from pcnde_bridge.errors import DataNotFoundError, FileError

SUFFIXES = (".npz", ".h5", ".hdf5")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", ["small_cases", "sheared_cases"])
def test_round_trip(request, tmp_path, suffix, name):
    cases = request.getfixturevalue(name)
    path = tmp_path / f"data{suffix}"
    path.write_text("something older")
    cases.save(path)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    again = Cases.load(str(path))
    assert again == cases
    assert again.variables().keys() == cases.variables().keys()
    pd.testing.assert_frame_equal(again.labels, cases.labels)


def test_h5_names_its_units(small_cases, sheared_cases, tmp_path):
    small_cases.save(tmp_path / "data.h5")
    with h5py.File(tmp_path / "data.h5") as file:
        assert file.attrs["format"] == b"pcnde-cases"
        assert file.attrs["format_version"] == FORMAT_VERSION
        assert {name: file[name].attrs["units"].decode() for name in file if name != "labels"} == {
            "flow": "mL/s",
            "area": "cm^2",
            "pressure": "dyn/cm^2",
            "area_undeformed": "cm^2",
            "time": "s",
            "z": "cm",
            "period": "s",
        }
        assert list(file["labels"]) == ["geometry", "waveform", "blockage", "patient"]
    sheared_cases.save(tmp_path / "data.h5")
    with h5py.File(tmp_path / "data.h5") as file:
        attributes = dict(file["wall_shear_stress"].attrs)
    assert attributes == {"units": b"dyn/cm^2", "axes": b"case, time, z"}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_truncated_and_foreign_files(small_cases, tmp_path, suffix):
    path = tmp_path / f"data{suffix}"
    small_cases.save(path)
    whole = path.read_bytes()
    for length in (9, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(FileError, match=r"truncated or damaged .* or copy or create it again"):
            Cases.load(path)
    for other in (b"", b"hello, I am a text file", b"\x80\x04K\x01."):
        path.write_bytes(other)
        with pytest.raises(FileError, match=r"is not an (\.npz|HDF5) file that Cases\.save wrote"):
            Cases.load(path)


@pytest.mark.filterwarnings("ignore::pcnde_bridge.UnitsWarning")
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_every_damaged_byte_is_noticed(small_cases, tmp_path, suffix):
    """A file with a flipped byte is rejected, unless the byte is unused."""
    path = tmp_path / f"data{suffix}"
    small_cases.select([0, 5]).save(path)
    whole, saved = path.read_bytes(), Cases.load(path)
    for place in np.random.default_rng(0).integers(0, len(whole), size=100):
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        with contextlib.suppress(FileError):
            assert Cases.load(path) == saved


def test_newer_h5(small_cases, tmp_path, monkeypatch):
    path = tmp_path / "data.h5"
    monkeypatch.setattr(case_files, "FORMAT_VERSION", 7)
    small_cases.save(path)
    monkeypatch.undo()
    with pytest.raises(FileError, match=r"a newer pcnde_bridge \(format 7; this one reads up to 1"):
        Cases.load(path)


def test_paths_that_do_not_work(small_cases, tmp_path):
    for path in (tmp_path / "data.csv", tmp_path / "data"):
        with pytest.raises(FileError, match=r"must end in one of \.npz, \.h5, \.hdf5"):
            small_cases.save(path)
        with pytest.raises(FileError, match=r"must end in one of \.npz, \.h5, \.hdf5"):
            Cases.load(path)
    with pytest.raises(DataNotFoundError, match="There is no file"):
        Cases.load(tmp_path / "absent.npz")
    with pytest.raises(FileError, match="does not exist; create it first"):
        small_cases.save(tmp_path / "absent" / "data.npz")


@pytest.fixture
def on_disk(sheared_cases, tmp_path, monkeypatch):
    """The cases in a file whose arrays stay on disk."""
    sheared_cases.save(tmp_path / "cases.h5")
    monkeypatch.setattr(hdf5, "SMALLEST_MAP", 1)
    return Cases.load(tmp_path / "cases.h5")


def test_large_arrays_stay_on_disk(on_disk, sheared_cases):
    assert isinstance(on_disk.flow, np.memmap)
    assert on_disk == sheared_cases
    ranges = [*on_disk.batches(5)]
    assert [(rows.start, rows.stop) for rows, _ in ranges] == [(0, 4), (4, 8), (8, 12)]
    for rows, part in ranges:
        assert np.shares_memory(part.flow, on_disk.flow)
        assert part == sheared_cases[rows]
    assert on_disk[[3, 1]] == sheared_cases[[3, 1]]


def test_large_arrays_are_checked(on_disk, small_cases, tmp_path):
    path = tmp_path / "cases.h5"
    with h5py.File(path, "r+") as file:
        file["area"][7, 3, 2] = -1.0
    with pytest.raises(FileError, match=r"area\[7, 3, 2\] is -1"):
        Cases.load(path)
    with h5py.File(path, "r+") as file:
        file["area"][7, 3, 2] = on_disk.area[6, 3, 2]
    with pytest.raises(FileError, match="was changed after it was saved"):
        Cases.load(path)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(FileError, match=r"cases\.h5"):
        Cases.load(path)
