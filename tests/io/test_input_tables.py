"""Tables of inflows and areas: columns, axes, pairs of columns, and rejected tables."""

from __future__ import annotations

import dataclasses
import os
import threading

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import FileError, InputError
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.io import read_csv
from pcnde_bridge.io.input_tables import read_columns, read_cycle, read_inputs
from pcnde_bridge.model.prediction import Prediction

GRID = Grid(np.arange(4) / 4, np.arange(3.0), 1.0)


@pytest.fixture
def read_both(tmp_path):
    """Read tables of constant columns; by their names, what each column holds."""

    def read_both(flows, areas, any_grid=False):
        for file, axis, values, columns in (
            ("inflow.csv", "time", GRID.time, flows),
            ("area.csv", "z", GRID.z, areas),
        ):
            table = {axis: values} | {k: np.full(values.size, float(v)) for k, v in columns.items()}
            pd.DataFrame(table).to_csv(tmp_path / file, index=False)
        return read_inputs(tmp_path / "inflow.csv", tmp_path / "area.csv", GRID, any_grid=any_grid)

    return read_both


@pytest.mark.parametrize("any_grid", [True, False])
def test_columns_of_the_same_names_belong_together(read_both, any_grid):
    found = read_both({"P1": 1, "P2": 2, "P3": 3}, {"P3": 30, "P1": 10, "P2": 20}, any_grid)
    assert found.names == ["P1", "P2", "P3"]
    assert np.array_equal(found.inflow, np.outer([1, 2, 3], np.ones(4)))
    assert np.array_equal(found.area_undeformed, np.outer([10, 20, 30], np.ones(3)))
    assert found.area_undeformed.flags.c_contiguous
    assert set(found.where) == ({"z", "period"} if any_grid else set())
    if any_grid:
        assert found.where["period"] == 1.0
        assert np.array_equal(found.where["z"], GRID.z)


def test_columns_of_other_names_are_paired_by_place(read_both):
    found = read_both({"q1": 1, "q2": 2}, {"s2": 20, "s1": 10})
    assert found.names == ["q1", "q2"]
    assert np.array_equal(found.area_undeformed[:, 0], [20, 10])


def test_one_column_goes_with_all(read_both):
    found = read_both({"P2": 2}, {"P1": 10, "P2": 20})
    assert found.names == ["P1", "P2"]
    assert (len(found.inflow), len(found.area_undeformed)) == (1, 2)
    for array in (found.inflow, found.area_undeformed):  # as engines take them
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
    found = read_both({"P1": 1, "P2": 2}, {"P2": 20})
    assert found.names == ["P1", "P2"]
    assert (len(found.inflow), len(found.area_undeformed)) == (2, 1)
    assert read_both({"rest": 1}, {"P1": 10}).names == ["rest"]


@pytest.mark.parametrize("areas", [{"P2": 2, "P3": 3}, {"P1": 1, "P2": 2, "P3": 3}])
def test_names_of_which_some_are_alike_are_refused(read_both, areas):
    with pytest.raises(InputError, match=r"inflow\.csv and .*area\.csv have .* P3 only one"):
        read_both({"P1": 1, "P2": 2}, areas)


def test_predictions_take_the_names(read_both, tmp_path):
    found = read_both({"007": 1, "012": 2, "x": 3}, {"x": 30, "007": 10, "012": 20})
    one = np.ones((2, 4, 3))
    labels = pd.DataFrame({"case": [1, 2]})  # of a batch that begins with the second
    part = Prediction(one, 0.1 * one, 5e4 * one, 0.1 * one[:, 0], GRID.time, GRID.z, 1.0, labels)
    named = dataclasses.replace(part, labels=found.name_labels(part.labels))
    assert named.labels.to_dict("list") == {"case": [1, 2], "name": ["012", "x"]}
    assert list(part.labels) == ["case"]
    named.save(tmp_path / "p.csv")
    back = read_csv(tmp_path / "p.csv", period=1.0, units="cgs,area=cm^2")
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
    assert read_cycle(tmp_path / "q.csv", 0.0, np.nan)[0] == pytest.approx(1.01)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("time;a\n0;1\n0,25;2,5,1\n0,5;1\n0,75;1\n", InputError, "line 3, column a: not a num"),
        ("time (ms),a\n0,1\n", InputError, "gives time in ms: .*--units time=ms"),
        ("time,Velocity_1\n0,1\n", InputError, r"Velocity_1: flow is expected, not velocity\.$"),
        ("time,a\n0,True\n0.25,False\n", InputError, "line 2, column a: not a number"),
        ("time,a\n".encode("utf-16"), FileError, "comma-separated values in UTF-8, or"),
        ("\n\n \ntime,a\n0,1\n\n0.25,x\n", InputError, "line 7, column a: not a number"),
        ("\ntime,a\n0,1\n0.3,1\n0.5,1\n0.75,1\n", InputError, "line 4: time is 0.3 s"),
    ],
)
def test_tables_of_another_kind_are_told_what_to_do(tmp_path, text, error, message):
    path = tmp_path / "q.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(error, match=message):
        read_columns(path, "time", GRID.time)


def test_blanks_after_commas_belong_to_nothing(tmp_path):
    (tmp_path / "q.csv").write_text("time, a, b\n0, 1, 2\n0.25, 1, 2\n0.5, 1, 2\n0.75, 1, 2\n")
    found = read_columns(tmp_path / "q.csv", "time", GRID.time).to_numpy().T
    assert np.array_equal(found, [[1] * 4, [2] * 4])


TIME = np.arange(4) / 4


@pytest.fixture
def read(tmp_path):
    def read(text, expected=TIME, axis="time"):
        path = tmp_path / "table.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_columns(path, axis, expected).to_numpy().T

    return read


def test_columns_are_cases(read):
    found = read("time,a,b\n0,1,10\n0.25,2,20\n0.5,3,30\n0.75,4.5,1e3\n")
    assert np.array_equal(found, [[1, 2, 3, 4.5], [10, 20, 30, 1000]])


def test_one_column_names_of_any_kind_and_line_ends(read):
    found = read(b"\xef\xbb\xbftime,3\r\n0,1\r\n0.25,2\r\n0.5,3\r\n0.75,4\r\n")
    assert np.array_equal(found, [[1, 2, 3, 4]])


def test_numbers_written_with_few_digits_are_the_axis(read):
    expected = np.arange(3) / 3
    assert read("time,a\n0,1\n0.3333333,2\n0.6666667,3\n", expected).shape == (1, 3)


@pytest.mark.parametrize("header", ["tt,a", "z,a", "time", "a,time"])
def test_the_first_column_must_be_the_axis(read, header):
    rows = "".join(f"{t}" + ",1" * header.count(",") + "\n" for t in TIME)
    with pytest.raises(InputError, match=r"table\.csv must have the columns time, then one"):
        read(f"{header}\n{rows}")


@pytest.mark.parametrize("bad", ["x", "", "1;2", "nan"])
@pytest.mark.parametrize("line", [2, 4, 5])
def test_what_is_not_a_number_is_named_by_line_and_column(read, bad, line):
    rows = [f"{t},1,2" for t in TIME]
    rows[line - 2] = f"{TIME[line - 2]},1,{bad}"
    with pytest.raises(InputError, match=f"line {line}, column q2: not a number"):
        read("time,q1,q2\n" + "\n".join(rows) + "\n")


def test_another_number_of_rows(read):
    with pytest.raises(InputError, match=r"3 rows, but the model works on 4 .*0 to 0\.75 s"):
        read("time,a\n0,1\n0.25,1\n0.5,1\n")
    with pytest.raises(InputError, match="table"):
        read("time,a\n")


@pytest.mark.parametrize("value", ["0.51", "inf", "-0.5"])
def test_another_axis(read, value):
    with pytest.raises(InputError, match=r"line 4: time is .* works at 0\.5 s"):
        read(f"time,a\n0,1\n0.25,1\n{value},1\n0.75,1\n")


@pytest.mark.parametrize(
    "content", [b"", b"\n\n", b"\xff\xfe\x00\x01", b'time,a\n0,"1\n', b"a,b\n1,2\n1,2,3,4\n"]
)
def test_no_table(read, content):
    with pytest.raises((FileError, InputError), match=r"table\.csv"):
        read(content)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_read_once(tmp_path):
    path = tmp_path / "q.csv"
    os.mkfifo(path)
    text = "time,a\n0,1\n0.25,2\n0.5,3\n0.75,4\n"
    writer = threading.Thread(target=path.write_text, args=(text,), daemon=True)
    writer.start()
    assert np.array_equal(read_columns(path, "time", TIME)["a"], [1, 2, 3, 4])
    writer.join()
    with pytest.raises(FileError, match="is a pipe"):
        read_csv(path)


def test_no_file(tmp_path):
    for path in (tmp_path / "nowhere.csv", tmp_path):
        with pytest.raises(FileError, match=r"There is no file|is a folder"):
            read_columns(path, "time", TIME)


def test_a_cycle_begins_where_the_models_does_and_has_no_end_point(tmp_path):
    time = np.arange(21) / 20
    flow = 1 + np.sin(2 * np.pi * time)
    flow[-1] = flow[0]
    path = tmp_path / "q.csv"

    def written(time, flow):
        pd.DataFrame({"time": time, "q": flow}).to_csv(path, index=False)
        return path

    period, columns = read_cycle(written(time[:-1], flow[:-1]), 0.0, 1.0)
    assert period == pytest.approx(1.0)
    assert np.array_equal(columns, flow[:-1, None])
    with pytest.raises(InputError, match="the cycle's end repeats its start"):
        read_cycle(written(time, flow), 0.0, 1.0)
    # What is a whole cycle of another period, flat at its end, is taken.
    with pytest.raises(InputError, match=r"end repeats its start.*\(--period 1\.1\)"):
        read_cycle(written(1.1 * time, flow), 0.0, 1.0)
    assert read_cycle(written(1.1 * time, flow), 0.0, 1.0, period=1.155)[0] == 1.155
    with pytest.raises(InputError, match=r"time starts at 0\.5 s, but it must start at 0 s"):
        read_cycle(written(time[:-1] + 0.5, flow[:-1]), 0.0, 1.0)


@pytest.mark.parametrize("part", [0.5, 0.9, 0.99])
def test_a_part_of_a_cycle_needs_its_period(tmp_path, part):
    time = np.arange(round(100 * part)) / 100
    path = tmp_path / "q.csv"
    pd.DataFrame({"time": time, "q": 1 + np.sin(2 * np.pi * time)}).to_csv(path, index=False)
    with pytest.raises(InputError, match=rf"a cycle of {part:g} s, .* 1 s.*--period {part:g} if"):
        read_cycle(path, 0.0, 1.0)
    assert read_cycle(path, 0.0, 1.0, period=part)[0] == part


def test_an_end_point_that_is_nearly_the_start_is_suggested(tmp_path):
    time = np.linspace(0, 1, 41)
    flow = 1 + np.sin(2 * np.pi * time - 0.7) + 1e-3 * time
    pd.DataFrame({"time": time, "q": flow}).to_csv(tmp_path / "q.csv", index=False)
    with pytest.raises(InputError, match=r"includes the cycle's end, pass --period 1; or pass"):
        read_cycle(tmp_path / "q.csv", 0.0, 1.0)


def test_a_number_of_400_digits_is_refused(read):
    """In a column of whole numbers, which pandas reads as Python's; older ones as no number."""
    with pytest.raises(InputError, match=r"line 2(: time is inf s|, column time: not a number)"):
        read(f"time,a\n{'9' * 400},1\n0,1\n1,1\n2,1\n")


def test_a_missing_row_does_not_change_the_period(tmp_path):
    """Without it the mean step is another one."""
    time = np.delete(np.arange(100) / 100, 40)
    frame = pd.DataFrame({"time": time, "q": 1.2 + np.sin(2 * np.pi * time)})
    frame.to_csv(tmp_path / "q.csv", index=False)
    assert read_cycle(tmp_path / "q.csv", 0.0, 1.0, time_points=50)[0] == 1.0


@pytest.mark.parametrize("names", [("B", "A"), (" b", "a "), ("b", "a")])
def test_columns_are_paired_by_names_in_any_case_and_with_blanks(tmp_path, names):
    pd.DataFrame({"time": TIME, "a": 1.0, "b": 2.0}).to_csv(tmp_path / "q.csv", index=False)
    table = pd.DataFrame({"z": GRID.z, names[0]: 0.2, names[1]: 0.1})
    table.to_csv(tmp_path / "s.csv", index=False)
    found = read_inputs(tmp_path / "q.csv", tmp_path / "s.csv", GRID, any_grid=False)
    assert found.inflow[:, 0].tolist() == [1.0, 2.0]
    assert found.area_undeformed[:, 0].tolist() == [0.1, 0.2]


@pytest.mark.parametrize(
    ("axis", "column", "message"),
    [
        ("time", "a (L/min)", r"flow in mL/s is expected.*pass --units flow=L/min\."),
        ("time", "Q [ml/min]", r"pass --units flow=mL/min\."),
        ("time", "Q (cm/s)", r"column Q \(cm/s\): flow in mL/s is expected\.$"),
        ("time", "patient (1)", None),
        ("time", "Q (cm³/s)", None),
        ("z", "S (mm2)", r"pass --units area=mm\^2\."),
        ("z", "d (mm)", r"area in cm\^2 is expected.*--units radius=mm .*diameter=mm "),
    ],
)
def test_units_in_the_names_of_columns(tmp_path, axis, column, message):
    expected = {"time": TIME, "z": GRID.z}[axis]
    pd.DataFrame({axis: expected, column: 1.0}).to_csv(tmp_path / "a.csv", index=False)
    if message is None:
        assert list(read_columns(tmp_path / "a.csv", axis, expected)) == [column]
        return
    with pytest.raises(InputError, match=message):
        read_columns(tmp_path / "a.csv", axis, expected)


def test_units_in_names_that_are_stated(tmp_path):
    both = tmp_path / "q.csv", tmp_path / "s.csv"

    def read(time, flow, z, area, units):
        pd.DataFrame({time: 1000 * GRID.time, flow: 60.0}).to_csv(both[0], index=False)
        pd.DataFrame({z: 10 * GRID.z, area: 3.0}).to_csv(both[1], index=False)
        for any_grid in (False, True):
            found = read_inputs(*both, GRID, any_grid=any_grid, units=units)
            assert (found.inflow == 60.0).all()
            assert (found.area_undeformed == 3.0).all()

    units = "time=ms,flow=mL/min,z=mm,"
    for area, stated in (
        ("S (mm²)", "area=mm2"),
        ("radius (mm)", "radius=mm"),
        ("d", "diameter=mm"),
    ):
        read("time (ms)", "Q (mL/min)", "z (mm)", area, units + stated)
    for names, message in (
        (("time (s)", "Q", "z", "S"), r"pass --units time=s,flow=mL/min,z=mm,area=mm\^2\."),
        (("time", "Q", "z (inch)", "S"), r"gives z in inch: known are \['cm', 'mm', 'm'\]"),
        (("time", "Q (mL/s)", "z", "S"), r"flow in mL/min is expected. If it is in mL/s, pass"),
        (("time", "Q", "z", "S (cm^2)"), r"area in mm\^2 is expected. If it is in cm\^2, pass"),
        (("time", "Q", "z", "radius"), r"not radius\. State its unit, such as \S+ \S+,radius=mm\."),
        (
            ("time", "Q", "z", "S (mm)"),
            r"--units \S+,radius=mm for radii, or --units \S+,diameter=mm f",
        ),
    ):
        with pytest.raises(InputError, match=message):
            read(*names, units + "area=mm^2")
    with pytest.raises(InputError, match=r"area in mm is expected. If it is in mm\^2, pass"):
        read("time", "Q", "z", "S (mm2)", units + "radius=mm")


@pytest.mark.parametrize("period", [0.8, 1.0, 1.1])
def test_an_end_point_is_found_whatever_the_period(tmp_path, period):
    time = np.linspace(0, period, 81)
    flow = 1 + np.sin(2 * np.pi * time / period - 0.7)
    path = tmp_path / "q.csv"
    pd.DataFrame({"time": time, "q": flow}).to_csv(path, index=False)
    with pytest.raises(InputError, match=rf"end repeats its start.*--period {period:g}\)"):
        read_cycle(path, 0.0, 1.0)
    found, columns = read_cycle(path, 0.0, 1.0, period=period)
    assert (found, len(columns)) == (period, 80)
    with pytest.raises(InputError, match=r"not one cycle of 0\.5 s"):
        read_cycle(path, 0.0, 1.0, period=0.5)
    pd.DataFrame({"time": 1000 * time, "q": flow}).to_csv(path, index=False)
    with pytest.raises(InputError, match=rf"end repeats its start.*--period {period:g}\)"):
        read_cycle(path, 0.0, 1.0, units="time=ms")
    assert read_cycle(path, 0.0, 1.0, period=period, units="time=ms")[0] == period


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("time,a", "{},{}"),
        ("t,a", "{},{}"),
        ("Time [s],a", "{},{}"),
        ("time;a", "{};{}"),
        ("time\ta", "{}\t{}"),
    ],
)
@pytest.mark.parametrize("comma", [False, True])
def test_columns_as_other_programs_write_them(read, header, row, comma):
    rows = "\n".join(row.format(t, q) for t, q in zip(TIME, (1, 2, 3, 4.5), strict=True))
    if ";" in row and comma:
        rows = rows.replace(".", ",")
    assert np.array_equal(read(f"{header}\n{rows}\n"), [[1, 2, 3, 4.5]])


def test_waveforms_without_names_of_columns(tmp_path):
    time = np.linspace(0, 0.8, 81)
    flow = 1.3 + np.sin(2 * np.pi * time / 0.8 - 0.7)
    for name, sign, mark in (("in.flow", -1, " "), ("in.dat", 1, "\t"), ("in.flow", -1, ",")):
        np.savetxt(tmp_path / name, np.stack([time, sign * flow], axis=1), delimiter=mark)
        period, columns = read_cycle(tmp_path / name, 0.0, 1.0)
        assert period == pytest.approx(0.8)
        np.testing.assert_allclose(columns.to_numpy()[:, 0], flow[:-1])


def test_unequal_steps_are_interpolated_on_request(tmp_path):
    time = np.sort(np.random.default_rng(0).uniform(0, 1, 400))
    time[0] = 0.0
    flow = 1.3 + np.sin(2 * np.pi * time)
    pd.DataFrame({"time": time, "q": flow}).to_csv(tmp_path / "q.csv", index=False)
    with pytest.raises(InputError, match=r"not equally spaced.*--interpolate"):
        read_cycle(tmp_path / "q.csv", 0.0, 1.0, period=1.0)
    _, columns = read_cycle(tmp_path / "q.csv", 0.0, 1.0, period=1.0, time_points=50)
    expected = 1.3 + np.sin(2 * np.pi * np.arange(50) / 50)
    np.testing.assert_allclose(columns["q"], expected, atol=2e-3)


@pytest.mark.parametrize("any_grid", [True, False])
def test_tables_in_other_units(tmp_path, any_grid):
    grid = Grid(np.arange(20) / 20, np.linspace(0, 4, 11), 1.0)
    pd.DataFrame({"time": 1e3 * grid.time, "q": 1.0}).to_csv(tmp_path / "q.csv", index=False)
    pd.DataFrame({"z": 10 * grid.z, "s": 12.0}).to_csv(tmp_path / "s.csv", index=False)
    units = {"time": "ms", "z": "mm", "area": "mm^2"}
    both = tmp_path / "q.csv", tmp_path / "s.csv", grid
    found = read_inputs(*both, any_grid=any_grid, units=units, period=1.0)
    assert np.array_equal(found.area_undeformed, np.full((1, 11), 12.0))
    if any_grid:
        assert found.where["period"] == pytest.approx(1000.0)
        assert np.array_equal(found.where["z"], 10 * grid.z)
    fine = read_inputs(*both, any_grid=any_grid, units=units, interpolate=True)
    assert fine.inflow.shape == (1, 20)


def test_messages_for_a_model_of_one_grid(read):
    rows = [f"{t},{v}" for t, v in ((0, 1), (0.25, 2), (0.5, 1), (0.75, 3), (1, 1))]
    table = "time,a\n" + "\n".join(rows)
    with pytest.raises(InputError, match=r"line 6: the cycle's end repeats its start: leave"):
        read(table)
    with pytest.raises(InputError, match=r"This looks like ms: pass --units time=ms"):
        read("time,a\n0,1\n250,1\n500,1\n750,1\n")
    with pytest.raises(InputError, match=r"works at 0\.25 s: sort the rows by time"):
        read("time,a\n0,1\n0.5,1\n0.25,1\n0.75,1\n")
    with pytest.raises(InputError, match=r"works at 0\.25 s: pass --interpolate"):
        read("time,a\n0,1\n0.3,1\n0.5,1\n0.75,1\n")
    with pytest.raises(InputError, match=r"predicts cycles of 1 s only, .* the preset physics"):
        read("time,a\n0,1\n0.2,1\n0.4,1\n0.6,1\n")
    assert np.array_equal(read("t,Q\n0,1\n0.25,1\n0.5,1\n0.75,1\n"), np.ones((1, 4)))


@pytest.mark.parametrize("options", [{"interpolate": True}, {"period": 0.9}, {}])
def test_a_model_of_one_period_refuses_others_at_once(tmp_path, options):
    grid = Grid(np.arange(20) / 20, np.linspace(0, 4, 11), 1.0)
    pd.DataFrame({"time": 0.9 * grid.time, "q": 1.0}).to_csv(tmp_path / "q.csv", index=False)
    pd.DataFrame({"z": grid.z[::-1], "s": 0.1}).to_csv(tmp_path / "s.csv", index=False)
    both = tmp_path / "q.csv", tmp_path / "s.csv", grid
    with pytest.raises(InputError, match=r"this model predicts cycles of 1 s only.*physics"):
        read_inputs(*both, any_grid=False, **options)
    with pytest.raises(InputError, match=r"s\.csv, line 3: z must increase: sort the rows by z"):
        read_inputs(*both, any_grid=True, period=0.9)


def test_messages_for_a_model_of_any_grid(tmp_path):
    def read(text, **options):
        (tmp_path / "cycle.csv").write_text(text)
        return read_cycle(tmp_path / "cycle.csv", 0.0, 1.0, **options)

    with pytest.raises(InputError, match=r"line 4: time must increase: sort the rows by time"):
        read("t,Q\n0,1\n0.5,1\n0.25,1\n0.75,1\n")
    with pytest.raises(InputError, match=r"--interpolate, or in Python a Waveform.from_samples"):
        read("t,Q\n0,1\n0.3,1\n0.5,1\n0.75,1\n")
    with pytest.raises(InputError, match=r"correct --period. This looks like ms: pass --units"):
        read("t,Q\n0,1\n250,2\n500,1\n750,1\n", period=1.0)


def test_a_damaged_sample_is_found_before_it_is_interpolated(tmp_path):
    path, time = tmp_path / "inflow.csv", np.arange(1000) / 1000
    flow = 1.3 + np.cos(2 * np.pi * time)
    flow[300] *= 1.5
    pd.DataFrame({"time": time, "a": flow}).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"inflow\.csv: the flow is .* at 0\.3 s .*, case 0"):
        read_cycle(path, 0.0, 1.0, time_points=100)
