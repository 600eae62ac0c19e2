"""Inflows and areas of several cases: which column goes with which, and what is refused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge.data.grid import Grid
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.io import read_csv
from pcnde_bridge.io.tables import (
    read_columns,
    read_cycle,
    read_inputs,
)
from pcnde_bridge.model.prediction import Prediction

GRID = Grid(np.arange(4) / 4, np.arange(3.0), 1.0)


@pytest.fixture
def read(tmp_path):
    """Read tables of constant columns; by their names, what each column holds."""

    def read(flows, areas, any_grid=False):
        for file, axis, values, columns in (
            ("inflow.csv", "time", GRID.time, flows),
            ("area.csv", "z", GRID.z, areas),
        ):
            table = {axis: values} | {k: np.full(values.size, float(v)) for k, v in columns.items()}
            pd.DataFrame(table).to_csv(tmp_path / file, index=False)
        return read_inputs(tmp_path / "inflow.csv", tmp_path / "area.csv", GRID, any_grid=any_grid)

    return read


@pytest.mark.parametrize("any_grid", [True, False])
def test_columns_of_the_same_names_belong_together(read, any_grid):
    found = read({"P1": 1, "P2": 2, "P3": 3}, {"P3": 30, "P1": 10, "P2": 20}, any_grid)
    assert found.names == ["P1", "P2", "P3"]
    assert np.array_equal(found.inflow, np.outer([1, 2, 3], np.ones(4)))
    assert np.array_equal(found.area_undeformed, np.outer([10, 20, 30], np.ones(3)))
    assert found.area_undeformed.flags.c_contiguous
    assert set(found.where) == ({"z", "period"} if any_grid else set())
    if any_grid:
        assert found.where["period"] == 1.0
        assert np.array_equal(found.where["z"], GRID.z)


def test_columns_of_other_names_are_paired_by_place(read):
    found = read({"q1": 1, "q2": 2}, {"s2": 20, "s1": 10})
    assert found.names == ["q1", "q2"]
    assert np.array_equal(found.area_undeformed[:, 0], [20, 10])


def test_one_column_goes_with_all(read):
    found = read({"P2": 2}, {"P1": 10, "P2": 20})
    assert found.names == ["P1", "P2"]
    assert (len(found.inflow), len(found.area_undeformed)) == (1, 2)
    for array in (found.inflow, found.area_undeformed):  # as engines take them
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
    found = read({"P1": 1, "P2": 2}, {"P2": 20})
    assert found.names == ["P1", "P2"]
    assert (len(found.inflow), len(found.area_undeformed)) == (2, 1)
    assert read({"rest": 1}, {"P1": 10}).names == ["rest"]


@pytest.mark.parametrize("areas", [{"P2": 2, "P3": 3}, {"P1": 1, "P2": 2, "P3": 3}])
def test_names_of_which_some_are_alike_are_refused(read, areas):
    with pytest.raises(InputError, match=r"inflow\.csv and .*area\.csv name some .* P3 only one"):
        read({"P1": 1, "P2": 2}, areas)


def test_predictions_take_the_names(read, tmp_path):
    found = read({"007": 1, "012": 2, "x": 3}, {"x": 30, "007": 10, "012": 20})
    one = np.ones((2, 4, 3))
    labels = pd.DataFrame({"case": [1, 2]})  # of a batch that begins with the second
    part = Prediction(one, 0.1 * one, 5e4 * one, 0.1 * one[:, 0], GRID.time, GRID.z, 1.0, labels)
    named = found.named(part)
    assert named.labels.to_dict("list") == {"case": [1, 2], "name": ["012", "x"]}
    assert list(part.labels) == ["case"]
    named.save(tmp_path / "p.csv")
    back = read_csv(tmp_path / "p.csv", period=1.0, units="cgs")
    assert list(back.labels["name"]) == ["012", "x"]


@pytest.mark.parametrize("off", [0.0, 1e-15, 3e-7])
def test_an_end_point_that_round_off_tells_from_the_start_is_found(tmp_path, off):
    time = np.arange(101) / 100
    flow = 1.3 + 0.3 * np.sin(2 * np.pi * time - 0.7)
    flow[-1] = flow[0] + 0.6 * off
    pd.DataFrame({"time": time, "q": flow}).to_csv(tmp_path / "q.csv", index=False)
    with pytest.raises(InputError, match="line 102: the cycle's end repeats its start"):
        read_cycle(tmp_path / "q.csv", 0.0, 1.0)


def test_an_end_point_counts_by_the_range_of_each_waveform(tmp_path):
    """A small oscillation about a large mean is no repetition, nor one that ends elsewhere."""
    time = np.arange(101) / 100
    small = 1e3 + 1e-4 * np.sin(6 * time)
    pd.DataFrame({"time": time, "q": small}).to_csv(tmp_path / "q.csv", index=False)
    assert read_cycle(tmp_path / "q.csv", 0.0, 1.0)[0] == pytest.approx(1.01)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("time;a\n0;1\n0,25;2\n", FileError, "separated by semicolons: save it with commas"),
        ("time;a\n0;1,5\n0,25;2,5,1\n", FileError, "separated by semicolons"),
        ("time\ta\n0\t1\n", FileError, "separated by tabs: save it with commas"),
        ("time,a\n".encode("utf-16"), FileError, "not UTF-8 text .* Save it as CSV in UTF-8"),
        ("\n\n \ntime,a\n0,1\n\n0.25,x\n", InputError, "line 7, column a: not a number"),
        ("\ntime,a\n0,1\n0.3,1\n0.5,1\n0.75,1\n", InputError, "line 4: time is 0.3 s"),
    ],
)
def test_tables_of_another_kind_are_told_what_to_do(tmp_path, text, error, message):
    path = tmp_path / "q.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(error, match=message):
        read_columns(path, "time", GRID.time, "s")


def test_blanks_after_commas_belong_to_nothing(tmp_path):
    (tmp_path / "q.csv").write_text("time, a, b\n0, 1, 2\n0.25, 1, 2\n0.5, 1, 2\n0.75, 1, 2\n")
    found = read_columns(tmp_path / "q.csv", "time", GRID.time, "s").to_numpy().T
    assert np.array_equal(found, [[1] * 4, [2] * 4])
