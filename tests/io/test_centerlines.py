"""Predictions written as centerlines and animations."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from io_helpers import predicted, replaced
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from pcnde_bridge import FileError
from pcnde_bridge.io import read_simvascular, write_pvd, write_vtp


def test_centerlines_round_trip(prediction, tmp_path):
    paths = write_vtp(prediction, tmp_path / "p.vtp")
    assert [path.name for path in paths] == ["p_000.vtp", "p_001.vtp", "p_002.vtp"]
    found = read_simvascular(paths)
    assert found == prediction.to_cases()
    assert read_simvascular(paths[1]) == prediction.to_cases().select([1])


def test_a_label_may_be_a_truth_value(prediction, tmp_path):
    labels = prediction.labels.assign(treated=[True, False, True])
    paths = write_vtp(replaced(prediction, labels=labels), tmp_path / "p.vtp")
    assert read_simvascular(paths).labels["treated"].tolist() == [1, 0, 1]


def test_the_animation_has_a_file_for_each_step(prediction, tmp_path):
    write_pvd(prediction, tmp_path / "p & <q>.pvd")
    rows = list(ET.parse(tmp_path / "p & <q>.pvd").getroot().iter("DataSet"))
    assert len(rows) == 3 * 20
    assert {float(row.get("timestep")) for row in rows} == set(prediction.time.tolist())
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / rows[4].get("file")))
    reader.Update()
    case, step = int(rows[4].get("part")), 1
    pressure = reader.GetOutput().GetPointData().GetArray("pressure")
    found = [pressure.GetValue(i) for i in range(pressure.GetNumberOfValues())]
    assert found == prediction.pressure[case, step].tolist()


def test_centerlines_of_an_earlier_prediction_are_removed(small_cases, tmp_path):
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
def test_all_centerlines_are_written_or_none(small_cases, prediction, tmp_path, suffix):
    old = predicted(small_cases, [0, 5]).save(tmp_path / f"p{suffix}")
    before = {path: path.read_bytes() for path in old}
    blocked = tmp_path / ("p_002.vtp" if suffix == ".vtp" else "p/p_002_0019.vtp")
    blocked.mkdir()
    with pytest.raises(FileError, match="cannot write"):
        prediction.save(tmp_path / f"p{suffix}")
    left = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert {path: path.read_bytes() for path in left} == before
