"""Tidy tables: whole tables, and what their labels are."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from io_helpers import predicted

from pcnde_bridge import FileError, InputError, PCNDEError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import read_csv, to_cases
from pcnde_bridge.io.input_tables import read_columns
from pcnde_bridge.io.tables import read_frame


def test_tidy_tables_round_trip(prediction, tmp_path):
    prediction.save(tmp_path / "p.csv")
    found = read_csv(tmp_path / "p.csv", period=1.0)
    assert list(found.labels["patient"]) == ["patient 1", "patient 2", "patient 3"]
    for name in (*VARIABLES, "area_undeformed"):
        np.testing.assert_allclose(getattr(found, name), getattr(prediction, name), rtol=1e-14)
    prediction.save(tmp_path / "p.csv.gz")
    assert read_csv(tmp_path / "p.csv.gz", period=1.0) == found
    frame = read_frame(tmp_path / "p.csv").sample(frac=1.0, random_state=1)
    frame.to_csv(tmp_path / "shuffled.csv", index=False)
    assert read_csv(tmp_path / "shuffled.csv", period=1.0) == found


def test_an_unknown_blockage_comes_back_from_a_table(prediction, tmp_path):
    prediction.labels["blockage"] = [0.5, np.nan, np.nan]
    prediction.labels["age"] = [np.nan, 61.0, 70.0]
    prediction.save(tmp_path / "p.csv")
    found = read_csv(tmp_path / "p.csv", period=1.0)
    assert list(found.labels["blockage"].isna()) == [False, True, True]
    assert list(found.labels["age"].isna()) == [True, False, False]
    frame = prediction.to_frame()
    frame.loc[0, "patient"] = None
    frame.to_csv(tmp_path / "p.csv", index=False)
    with pytest.raises(InputError, match=r"a label is missing in the columns \['patient'\]"):
        read_csv(tmp_path / "p.csv", period=1.0)


def test_labels_of_which_a_part_would_be_lost_are_refused(prediction, tmp_path):
    prediction.save(tmp_path / "p.csv")
    prediction.to_frame().drop(columns="patient").to_csv(tmp_path / "q.csv", index=False)
    with pytest.raises(InputError, match=r"p\.csv.* has the labels .*'patient'.*q\.csv"):
        read_csv([tmp_path / "p.csv", tmp_path / "q.csv"], period=1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.drop(columns="area"), r"lacks the columns \['area'\]"),
        (lambda f: f.iloc[:-1], "419 rows, but 20 time points and 21 points make 420"),
        (lambda f: pd.concat([f, f]), "840 rows, .*columns that identify several"),
        (lambda f: f.assign(area_undeformed=0.1 + f["time"]), "area_undeformed changes with time"),
        (lambda f: f.assign(flow="x"), "line 2, column flow: not a number"),
        (lambda f: f.iloc[:0], "has no rows"),
    ],
)
def test_tables_that_are_not_whole(vessel, tmp_path, change, message):
    time, z = (grid.ravel() for grid in np.meshgrid(vessel.time, vessel.z, indexing="ij"))
    fields = {field: getattr(vessel, field).ravel() for field in VARIABLES}
    fields["area_undeformed"] = np.tile(vessel.area_undeformed, vessel.time.size)
    frame = pd.DataFrame({"time": time, "z": z, **fields})
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert read_csv(tmp_path / "a.csv") == to_cases([vessel])
    change(frame).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=message):
        read_csv(tmp_path / "a.csv")


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
    with pytest.raises(InputError, match=r"velocity changes within a case, .* Leave out"):
        read_csv(path, period=1.0)
    frame.drop(columns="waveform").to_csv(path, index=False)
    with pytest.raises(InputError, match=r"one with 1 row only.*too many values: velocity"):
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
        ({"encoding": "utf-16"}, "comma-separated values in UTF-8, or"),
    ],
)
def test_other_kinds_of_tables_are_told_what_to_do(prediction, tmp_path, options, message):
    path = tmp_path / "p.csv"
    prediction.to_frame().to_csv(path, index=False, **options)
    with pytest.raises(FileError, match=rf"p\.csv.*{message}"):
        read_csv(path)


def test_a_row_with_more_values_than_names_is_refused(prediction, tmp_path):
    """Such as a number with a comma in it; nothing of a row is cut off."""
    rows = prediction.to_frame().to_csv(index=False).splitlines()
    for row in (1, 7, len(rows) - 1):
        changed = [*rows[:row], rows[row].replace(".", ",", 1), *rows[row + 1 :]]
        (tmp_path / "p.csv").write_text("\n".join(changed))
        with pytest.raises(PCNDEError, match=r"line|fields"):
            read_csv(tmp_path / "p.csv", period=1.0)


@pytest.mark.parametrize("row", [0, 1, 2, 7])
def test_a_row_of_five_million_commas_is_refused_at_once(prediction, tmp_path, row):
    rows = prediction.to_frame().to_csv(index=False).splitlines()
    rows[row] += "," * 5_000_000
    (tmp_path / "p.csv").write_text("\n".join(rows))
    for read in (read_csv, lambda path: read_columns(path, "time", prediction.time)):
        with pytest.raises(FileError, match="5000010"):
            read(tmp_path / "p.csv")


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


def test_a_column_of_wall_shear_stress(sheared_vessel, tmp_path):
    expected = to_cases([sheared_vessel])
    expected.to_frame().to_csv(tmp_path / "a.csv", index=False)
    assert read_csv(tmp_path / "a.csv") == expected
    frame = expected.to_frame()
    frame["wall_shear_stress"] /= 10
    frame.to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=r"\(--units wall_shear_stress=Pa\), or"):
        read_csv(tmp_path / "a.csv")
    found = read_csv(tmp_path / "a.csv", units={"wall_shear_stress": "Pa"})
    np.testing.assert_allclose(found.wall_shear_stress, expected.wall_shear_stress, rtol=1e-14)
