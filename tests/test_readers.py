"""What other programs' files hold beside the results: labels, units, order, odd arrays.

The files are made as in :mod:`test_formats`.
"""

from __future__ import annotations

import itertools

import h5py
import numpy as np
import pandas as pd
import pytest
from test_formats import centreline, replaced, results_of, sv1d
from vtkmodules.vtkCommonCore import vtkBitArray, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkCellArray
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from pcnde_bridge import FileError, InputError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import (
    read_csv,
    read_hdf5,
    read_simvascular,
    read_sv1d,
    to_cases,
    write_pvd,
    write_vtp,
)
from pcnde_bridge.model.prediction import Prediction


@pytest.fixture(scope="module")
def vessel(small_cases):
    return results_of(small_cases, 6)


@pytest.fixture
def prediction(small_cases):
    return predicted(small_cases, [0, 6, 11])


def predicted(cases, chosen):
    few = cases.select(chosen)
    arrays = (getattr(few, name) for name in (*VARIABLES, "area_undeformed", "time", "z"))
    return Prediction(*arrays, period=1.0, labels=few.labels)


# ---- labels of tidy tables


@pytest.mark.parametrize(
    "patients",
    [
        ["007", "012", "100"],
        ["NA", "P2", "P3"],
        ["nan", "null", "None"],
        ["1", "1.0", "2"],
        ["1e3", "+5", "1_000"],
        ["12345678901234567890", "1", "2"],
        ["True", "1", "x"],
        ["0.50", "0.5", "1"],
    ],
)
def test_labels_of_text_come_back_as_they_are(prediction, tmp_path, patients):
    prediction.labels["patient"] = patients
    prediction.save(tmp_path / "p.csv")
    assert sorted(read_csv(tmp_path / "p.csv", period=1.0).labels["patient"]) == sorted(patients)


@pytest.mark.parametrize(
    ("ages", "kind"),
    [
        ([61, 62, 63], "i"),
        ([61.0, 0.1, 1e-5], "f"),
        ([np.nan, 61.0, 70.5], "f"),
        ([np.nan, np.nan, np.nan], "f"),
        ([True, False, True], "b"),
        ([1e16, -2.5, np.inf], "f"),
    ],
)
def test_labels_of_numbers_come_back_as_numbers(prediction, tmp_path, ages, kind):
    prediction.labels["age"] = ages
    prediction.save(tmp_path / "p.csv")
    found = read_csv(tmp_path / "p.csv", period=1.0).labels["age"].to_numpy()
    assert found.dtype.kind == kind
    assert np.array_equal(found, ages, equal_nan=kind == "f")


def test_numbers_may_be_written_in_any_way(prediction, tmp_path):
    prediction.labels["age"] = texts = ["61.50", "0.4", "1E+2"]
    prediction.save(tmp_path / "p.csv")
    found = read_csv(tmp_path / "p.csv", period=1.0).labels["age"]
    assert sorted(found) == sorted(map(float, texts))


def test_a_label_is_text_in_all_files_or_in_none(small_cases, tmp_path):
    files = []
    for case, patient in ((0, "12"), (6, "007")):
        part = predicted(small_cases, [case])
        part.labels["patient"] = patient
        files += part.save(tmp_path / f"{case}.csv")
    assert list(read_csv(files, period=1.0).labels["patient"]) == ["12", "007"]
    assert list(read_csv(files[:1], period=1.0).labels["patient"]) == [12]


def test_cases_are_in_the_order_of_numbers(small_cases, tmp_path):
    everything = predicted(small_cases, range(12))
    everything.labels["case"] = range(12)
    frame = everything.to_frame().drop(columns=["geometry", "waveform"])
    frame.to_csv(tmp_path / "p.csv", index=False)
    assert list(read_csv(tmp_path / "p.csv", period=1.0).labels["case"]) == list(range(12))


def test_an_unknown_blockage_may_be_written_in_words(prediction, tmp_path):
    frame = prediction.to_frame().assign(blockage="NA")
    frame.to_csv(tmp_path / "p.csv", index=False)
    assert read_csv(tmp_path / "p.csv", period=1.0).labels["blockage"].isna().all()


def test_columns_that_are_no_labels_are_refused_at_once(prediction, tmp_path, monkeypatch):
    path = tmp_path / "p.csv"
    frame = pd.concat([prediction.to_frame()] * 20, ignore_index=True)
    frame["waveform"] = np.repeat(np.arange(20), len(prediction.to_frame()))
    frame["velocity"] = frame["flow"] / frame["area"] + 1e-9 * np.arange(len(frame))
    frame.to_csv(path, index=False)
    # Before a single one of their many cases is made, which would take hours.
    monkeypatch.setattr("pcnde_bridge.io.csv._vessel", lambda *_: pytest.fail("made"))
    with pytest.raises(InputError, match=r"velocity changes within a case, .* left out"):
        read_csv(path, period=1.0)
    frame.drop(columns="waveform").to_csv(path, index=False)
    with pytest.raises(InputError, match=r"apart, one with 1 row only.*too many values: velocity"):
        read_csv(path, period=1.0)
    monkeypatch.undo()
    # Names given by the caller need no geometry and waveform in the file.
    each = prediction.to_frame().assign(geometry=0, waveform=0)
    each["who"] = np.repeat(["a", "b", "c"], len(each) // 3)
    each.drop(columns=["patient", "blockage"]).to_csv(path, index=False)
    names = {"geometry": [4, 5, 6], "waveform": [0, 0, 0]}
    assert list(read_csv(path, period=1.0, labels=names).labels["geometry"]) == [4, 5, 6]
    with pytest.raises(InputError, match="who changes within a case"):
        read_csv(path, period=1.0)


def test_columns_without_a_name_are_left_alone(prediction, tmp_path):
    prediction.to_frame().to_csv(tmp_path / "p.csv")  # with the numbers of the rows
    assert read_csv(tmp_path / "p.csv", period=1.0).n_cases == 3


def test_blanks_after_commas_belong_to_nothing(prediction, tmp_path):
    text = prediction.to_frame().to_csv(index=False)
    (tmp_path / "p.csv").write_text(text)
    (tmp_path / "q.csv").write_text(text.replace(",", ", "))
    expected = read_csv(tmp_path / "p.csv", period=1.0)
    assert read_csv(tmp_path / "q.csv", period=1.0) == expected


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sep": ";"}, "separated by semicolons: save it with commas"),
        ({"sep": ";", "decimal": ","}, "separated by semicolons: save it with commas"),
        ({"sep": "\t"}, "separated by tabs: save it with commas"),
        ({"encoding": "utf-16"}, "not UTF-8 text .* Save it as CSV in UTF-8"),
    ],
)
def test_other_kinds_of_tables_are_told_what_to_do(prediction, tmp_path, options, message):
    path = tmp_path / "p.csv"
    prediction.to_frame().to_csv(path, index=False, **options)
    with pytest.raises(FileError, match=rf"Cannot read a table from .*p\.csv.*{message}"):
        read_csv(path)


@pytest.mark.parametrize("name", ["p.csv", "p.csv.gz"])
def test_blank_lines_count(prediction, tmp_path, name):
    frame = prediction.to_frame()
    frame["flow"] = frame["flow"].astype(object)
    frame.loc[1, "flow"] = "x"
    whole = pd.Series(["", "  "]).str.cat(sep="\n") + "\n" + frame.to_csv(index=False)
    with pd.io.common.get_handle(tmp_path / name, "w", compression="infer") as file:
        file.handle.write(whole)
    with pytest.raises(InputError, match="line 5, column flow: not a number"):
        read_csv(tmp_path / name)


# ---- centrelines


def edited(path, edit, compressor=None, ascii_=False):
    """Have VTK read a file, change it and write it again."""
    reader, writer = vtkXMLPolyDataReader(), vtkXMLPolyDataWriter()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    edit(data)
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    if compressor:
        getattr(writer, f"SetCompressorTypeTo{compressor}")()
    if ascii_:
        writer.SetDataModeToAscii()
    assert writer.Write()
    return path


def lines(*rows):
    def replace(data):
        cells = vtkCellArray()
        for row in rows:
            cells.InsertNextCell(len(row), [int(i) for i in row])
        data.SetLines(cells)

    return replace


def stored(vessel, order):
    """The vessel with its points stored in another order."""
    fields = {name: getattr(vessel, name)[:, order] for name in VARIABLES}
    fields |= {name: getattr(vessel, name)[order] for name in ("z", "area_undeformed")}
    return replaced(vessel, **fields)


@pytest.mark.parametrize("kind", ["reversed", "shuffled"])
@pytest.mark.parametrize("drop", [("Path",), ("Path", "BranchId"), ()])
def test_points_are_ordered_along_the_vessel(vessel, tmp_path, kind, drop):
    n = vessel.z.size
    order = np.arange(n)[::-1] if kind == "reversed" else np.random.default_rng(0).permutation(n)
    path = centreline(tmp_path / "a.vtp", stored(vessel, order), drop=drop)
    place = np.argsort(order)  # of each point, from the inlet on
    pairs = list(itertools.pairwise(place))
    for cells in ([place], pairs, pairs[::-1], [place[:5], place[4:], place[2:9]]):
        found = read_simvascular(edited(path, lines(*cells)))
        np.testing.assert_allclose(found.z, vessel.z, rtol=1e-3, atol=1e-12)
        assert np.array_equal(found.area_undeformed[0], vessel.area_undeformed)
        for name in VARIABLES:
            assert np.array_equal(getattr(found, name)[0], getattr(vessel, name))


@pytest.mark.parametrize(
    "cells",
    [
        [],
        [range(10)],
        [range(10), range(10, 21)],
        [range(21), (4, 20)],
        [[*range(21), 0]],
        [[0, 1, 2, 0], range(3, 21)],
    ],
)
def test_points_without_an_order_are_refused(vessel, tmp_path, cells):
    path = centreline(tmp_path / "a.vtp", vessel, drop=("Path",))
    with pytest.raises(InputError, match=r"no array Path, and no line .* points of branch 0: .*"):
        read_simvascular(edited(path, lines(*cells)))


def test_a_branch_follows_its_own_part_of_the_lines(vessel, tmp_path):
    branches = np.array([1] * 11 + [-1] * 2 + [0] * 8)
    order = np.arange(21)[::-1]
    path = centreline(tmp_path / "a.vtp", stored(vessel, order), branches=branches, drop=("Path",))
    found = read_simvascular(edited(path, lines(order)), branch=1)
    assert np.array_equal(found.flow[0], vessel.flow[:, 10:])


def field(array, name, *values):
    array.SetName(name)
    for value in values:
        array.InsertNextValue(value)
    return lambda data: data.GetFieldData().AddArray(array)


@pytest.mark.parametrize("ascii_", [True, False])
def test_field_data_that_say_nothing_of_the_vessel_are_skipped(vessel, tmp_path, ascii_):
    path = centreline(tmp_path / "a.vtp", vessel)
    edited(path, field(vtkBitArray(), "flags", 1, 0, 1), ascii_=ascii_)
    edited(path, field(vtkStringArray(), "period", "one second"), ascii_=ascii_)
    assert read_simvascular(path) == to_cases([vessel])
    text = path.read_bytes().replace(b'type="Bit"', b'type="Variant"')
    path.write_bytes(text)
    assert read_simvascular(path) == to_cases([vessel])


def test_a_compressor_that_is_not_used_does_not_matter(vessel, tmp_path):
    path = centreline(tmp_path / "a.vtp", vessel)
    edited(path, lambda data: None, "LZ4", ascii_=True)
    assert b"vtkLZ4DataCompressor" in path.read_bytes()
    np.testing.assert_allclose(read_simvascular(path).flow[0], vessel.flow)
    with pytest.raises(FileError, match="vtkLZ4DataCompressor is not known"):
        read_simvascular(edited(path, lambda data: None, "LZ4"))


@pytest.mark.parametrize("step", ["0.001", True, 0, np.nan, [1.0]])
def test_a_time_step_is_a_positive_number(vessel, tmp_path, step):
    path = centreline(tmp_path / "a.vtp", vessel, steps=range(20), suffix="{:05d}".format)
    with pytest.raises(InputError, match="time_step must be"):
        read_simvascular(path, time_step=step)
    assert read_simvascular(path, time_step=np.float32(0.05)).n_times == 20


# ---- HDF5


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
    with pytest.raises(InputError, match=r"names\['flow'\] must be the path .* got 3"):
        read_hdf5(path, names={"flow": 3})


# ---- svOneDSolver


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: text.encode("utf-8-sig"),
        lambda text: text.replace("# A model", "# Gefäß").encode("latin-1"),
    ],
)
def test_input_files_of_the_solver_in_any_encoding(vessel, tmp_path, encode):
    path = sv1d(tmp_path, vessel)
    expected = read_sv1d(path, period=1.0)
    path.write_bytes(encode(path.read_text().removeprefix("\n")))
    assert read_sv1d(path, period=1.0) == expected
    path.write_bytes(encode("\n".join(path.read_text("latin-1").splitlines()[1:])))
    assert read_sv1d(path, period=1.0) == expected


def test_one_segment_may_be_named_by_itself(vessel, tmp_path):
    path = sv1d(tmp_path, vessel)
    one = read_sv1d(path, segments="Group1_Seg0", period=1.0)
    assert one == read_sv1d(path, segments=["Group1_Seg0"], period=1.0)


# ---- predictions out


def test_centrelines_of_an_earlier_prediction_are_removed(small_cases, tmp_path):
    write_vtp(predicted(small_cases, [0, 5, 6, 11]), tmp_path / "p.vtp")
    others = ["p_abc.vtp", "p_01.vtp", "q_003.vtp", "p_007.vtp", "p_003.vtp.old", "pp_003.vtp"]
    for name in others:
        (tmp_path / name).write_text("someone else's")
    paths = write_vtp(predicted(small_cases, [0, 6]), tmp_path / "p.vtp")
    assert sorted(tmp_path.iterdir()) == sorted([*paths, *(tmp_path / name for name in others)])
    write_vtp(predicted(small_cases, [0]), tmp_path / "p.vtp")
    assert {path.name for path in tmp_path.iterdir()} == {"p.vtp", *others}


def test_steps_of_an_earlier_animation_are_removed(small_cases, tmp_path):
    write_pvd(predicted(small_cases, [0, 5, 6]), tmp_path / "p.pvd")
    mine = tmp_path / "p" / "p_002_0000_notes.vtp"
    mine.write_text("someone else's")
    paths = write_pvd(predicted(small_cases, [0, 6]), tmp_path / "p.pvd")
    assert len(paths) == 41
    assert set((tmp_path / "p").iterdir()) == {mine, *paths[1:]}


@pytest.mark.parametrize("suffix", [".vtp", ".pvd"])
def test_all_centrelines_are_written_or_none(small_cases, prediction, tmp_path, suffix):
    old = predicted(small_cases, [0, 5]).save(tmp_path / f"p{suffix}")
    before = {path: path.read_bytes() for path in old}
    blocked = tmp_path / ("p_002.vtp" if suffix == ".vtp" else "p/p_002_0019.vtp")
    blocked.mkdir()
    with pytest.raises(FileError, match="cannot write"):
        prediction.save(tmp_path / f"p{suffix}")
    left = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert {path: path.read_bytes() for path in left} == before
