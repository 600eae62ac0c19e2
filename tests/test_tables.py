"""CSV tables of waveforms and areas."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.io.tables import read_columns, read_cycle

TIME = np.arange(4) / 4


@pytest.fixture
def read(tmp_path):
    def read(text, expected=TIME, axis="time"):
        path = tmp_path / "table.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_columns(path, axis, expected, "s").to_numpy().T

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


@pytest.mark.parametrize("header", ["t,a", "z,a", "time", "Time,a", "a,time"])
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


def test_no_file(tmp_path):
    for path in (tmp_path / "nowhere.csv", tmp_path):
        with pytest.raises(FileError, match="Cannot read a table from"):
            read_columns(path, "time", TIME, "s")


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
    assert read_cycle(written(1.1 * time, flow), 0.0, 1.0)[0] == pytest.approx(1.155)
    with pytest.raises(InputError, match=r"first instant is 0\.5 s, the model's 0 s"):
        read_cycle(written(time[:-1] + 0.5, flow[:-1]), 0.0, 1.0)
