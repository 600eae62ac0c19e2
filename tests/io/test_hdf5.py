"""HDF5 files of other programs."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from pcnde_bridge import InputError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import read_hdf5, to_cases


def test_reads_hdf5_of_others_and_of_ours(small_cases, vessel, tmp_path):
    small_cases.save(tmp_path / "ours.h5")
    assert read_hdf5(tmp_path / "ours.h5") == small_cases
    with h5py.File(tmp_path / "theirs.h5", "w") as file:
        file["results/Q"] = vessel.flow
        file["results/S"] = vessel.area
        file["p"] = vessel.pressure / 1333.22
        file["p"].attrs["units"] = "mmHg"
        file["A0"], file["t"], file["s"] = vessel.area_undeformed, vessel.time, vessel.z
    with pytest.raises(InputError, match=r"lacks the data sets \['flow', .*--names flow=path"):
        read_hdf5(tmp_path / "theirs.h5")
    names = {"flow": "/results/Q", "area": "results/S", "pressure": "p"}
    names |= {"area_undeformed": "A0", "time": "t", "z": "s"}
    found = read_hdf5(tmp_path / "theirs.h5", names=names)
    np.testing.assert_allclose(found.pressure[0], vessel.pressure, rtol=1e-14)
    with pytest.raises(InputError, match=r"theirs.h5: it has no array flw \(.*; it has \['A0'"):
        read_hdf5(tmp_path / "theirs.h5", names={**names, "wall_shear_stress": "flw"})


def test_text_of_hdf5_is_unicode_however_it_is_stored(vessel, tmp_path):
    with h5py.File(tmp_path / "cases.h5", "w") as file:
        for name in (*VARIABLES, "area_undeformed", "time", "z"):
            file[name] = getattr(vessel, name)
        file["labels/patient"] = ["Müller"]  # of variable length
        file["labels/surgeon"] = np.char.encode(["Søren"], "utf-8")  # of fixed length
    labels = read_hdf5(tmp_path / "cases.h5").labels
    assert labels.loc[0, ["patient", "surgeon"]].tolist() == ["Müller", "Søren"]


@pytest.fixture
def file(vessel, tmp_path):
    """File of one vessel, and a way to give a data set a unit."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as made:
        for name in (*VARIABLES, "area_undeformed", "time", "z"):
            made[name] = getattr(vessel, name)

    def write(name, unit):
        with h5py.File(path, "r+") as made:
            made[name].attrs["units"] = unit
        return path

    return write


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("flow", "cm3/s"),
        ("flow", "cm³ / s"),
        ("flow", "cm**3/s"),
        ("flow", "ml/s"),
        ("area", "cm²"),
        ("area_undeformed", "cm2"),
        ("pressure", b"dyn/cm2"),
        ("pressure", np.array([b"dyn/cm^2"])),
        ("z", ["cm"]),
    ],
)
def test_units_may_be_spelled_otherwise(vessel, file, name, unit):
    assert read_hdf5(file(name, unit)) == to_cases([vessel])


def test_areas_in_a_unit_of_length_are_radii_or_diameters(file):
    with pytest.raises(
        InputError, match=r"area is in mm: pass --units radius=mm .*diameter=mm for"
    ):
        read_hdf5(file("area", "mm"))


def test_units_of_the_caller_count_before_those_of_the_file(vessel, file):
    path = file("flow", "ccm per second")
    with pytest.raises(
        InputError, match=r"flow has the unknown unit 'ccm .*'mL/s'.*--units flow=.*--units cgs"
    ):
        read_hdf5(path)
    for units in ("cgs", {"flow": "mL/s"}):
        assert read_hdf5(path, units=units) == to_cases([vessel])
    with pytest.raises(InputError, match="unknown unit"):
        read_hdf5(path, units={"area": "cm^2"})
    file("flow", "mL/s")
    file("area", "mm^2")
    file("area_undeformed", "cm^2")
    assert read_hdf5(path, units={"area": "cm^2"}) == to_cases([vessel])


def test_names_are_paths(file):
    path = file("flow", "mL/s")
    with pytest.raises(InputError, match="names has 'flow': 3; give the path of an array"):
        read_hdf5(path, names={"flow": 3})


def test_labels_beside_the_other_arrays(small_cases, tmp_path):
    """They are also read without the group of labels, and under names of the caller's."""
    small_cases.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["geometry"], file["patient"] = file["labels/geometry"][()], file["labels/waveform"][()]
        del file["labels"], file.attrs["format"]
    names = {"waveform": "/patient", "patient": "patient"}
    found = read_hdf5(tmp_path / "a.h5", names=names).labels
    keys = ["geometry", "waveform"]
    assert found[keys].equals(small_cases.labels[keys])
    assert found["patient"].equals(found["waveform"].rename("patient"))


def test_wall_shear_stress_has_a_name_and_a_unit(sheared_vessel, tmp_path):
    expected = to_cases([sheared_vessel])
    expected.save(tmp_path / "a.h5")
    assert read_hdf5(tmp_path / "a.h5") == expected
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file.attrs["format"]
        file["tau"] = file["wall_shear_stress"][0] / 10
        file["tau"].attrs["units"] = "Pa"
        del file["wall_shear_stress"]
    assert read_hdf5(tmp_path / "a.h5").wall_shear_stress is None
    found = read_hdf5(tmp_path / "a.h5", names={"wall_shear_stress": "tau"})
    np.testing.assert_allclose(found.wall_shear_stress, expected.wall_shear_stress, rtol=1e-14)
