from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import pickle
import re
import warnings

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcnde_bridge.data import files as case_files
from pcnde_bridge.data.cases import Cases, Split
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.data.files import FORMAT_VERSION
from pcnde_bridge.errors import (
    DataNotFoundError,
    FileError,
    InputError,
)

SUFFIXES = (".npz", ".h5", ".hdf5")


def arguments(cases, **changes):
    """What a data set was made of, with changes."""
    names = ("flow", "area", "pressure", "area_undeformed", "time", "z")
    given = {name: np.array(getattr(cases, name)) for name in names}
    return given | {"period": cases.period, "labels": cases.labels} | changes


def changed(cases, name, place, value):
    array = np.array(getattr(cases, name))
    array[place] = value
    return Cases(**arguments(cases, **{name: array}))


def pairs(cases):
    return list(zip(cases.labels["geometry"], cases.labels["waveform"], strict=True))


# ---- what it holds


def test_holds_read_only_copies(small_cases):
    given = arguments(small_cases)
    given["flow"] = np.asfortranarray(given["flow"].astype(np.float32))
    made = Cases(**given)
    given["flow"][:] = 0
    given["area"][:] = 0
    for name in ("flow", "area", "pressure", "area_undeformed", "time", "z"):
        array = getattr(made, name)
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
        assert not array.flags.writeable
        assert np.all(array[name == "z" :] != 0) or name == "time"
    with pytest.raises(ValueError, match="read-only"):
        made.flow[0, 0, 0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.flow = given["flow"]
    labels = made.labels
    labels["geometry"] = 0
    assert list(made.labels["geometry"]) == list(small_cases.labels["geometry"])


def test_sizes_inflow_and_repr(small_cases):
    assert len(small_cases) == small_cases.n_cases == 12
    assert (small_cases.n_times, small_cases.n_points) == (20, 21)
    assert np.array_equal(small_cases.inflow, small_cases.flow[:, :, 0])
    assert not small_cases.inflow.flags.writeable
    assert repr(small_cases) == (
        "Cases(12 cases: 3 geometries, 4 waveforms; 20 time points over 1 s; "
        "21 points, z from 0 to 4 cm)"
    )
    assert repr(small_cases.select(0)).startswith("Cases(1 case: 1 geometry, 1 waveform;")


def test_equality_hash_and_copies(small_cases):
    same = Cases(**arguments(small_cases))
    assert same == small_cases
    assert hash(same) == hash(small_cases)
    assert same.fingerprint() == small_cases.fingerprint()
    assert re.fullmatch("[0-9a-f]{64}", same.fingerprint())
    assert small_cases != changed(small_cases, "flow", (3, 4, 5), 1.0)
    assert small_cases != Cases(**arguments(small_cases, labels=None))
    assert small_cases != "something else"
    for twin in (copy.copy(same), copy.deepcopy(same), pickle.loads(pickle.dumps(same))):  # noqa: S301
        assert twin == small_cases
        assert not twin.flow.flags.writeable


FINGERPRINT = "0a3702f9973f473c4911ec9e30ecca9b93073bd9be8e4957d399b81540935744"


def test_fingerprint_is_the_same_on_every_machine_and_version():
    """A change here makes the checksums in all model files wrong."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitsWarning)
        made = Cases(
            np.arange(12).reshape(1, 4, 3),
            np.ones((1, 4, 3)),
            np.ones((1, 4, 3)),
            [[1, 0.5, 1]],
            [0, 1, 2, 3],
            [0, 1, 2],
            labels={"geometry": [1], "waveform": [2], "name": ["é"], "old": [True], "n": [3]},
        )
    assert made.fingerprint() == FINGERPRINT


def test_defaults(small_cases):
    made = Cases(**arguments(small_cases, period=None, labels=None))
    assert made.period == pytest.approx(1.0, rel=1e-12)
    assert list(made.labels.columns) == ["geometry", "waveform", "blockage"]
    assert list(made.labels["geometry"]) == list(range(12))
    assert set(made.labels["waveform"]) == {0}
    undeformed = small_cases.area_undeformed
    assert np.array_equal(made.labels["blockage"], 1 - undeformed.min(axis=1) / undeformed[:, 0])
    assert made.labels["blockage"][0] == pytest.approx(0.4, abs=1e-6)


def test_labels_are_cleaned(small_cases):
    given = pd.DataFrame(
        {
            "note": pd.Series(["a", "b"] * 6, dtype="category"),
            "blockage": [None, 0.5] * 6,
            "waveform": np.arange(12.0),
            "geometry": np.ones(12, dtype=np.uint8),
            "age": np.arange(12, dtype=np.int16),
            "score": np.linspace(0, 1, 12, dtype=np.float32),
            "ill": [True, False] * 6,
        }
    ).set_axis(range(100, 112))
    labels = Cases(**arguments(small_cases, labels=given)).labels
    assert list(labels.columns) == [
        *("geometry", "waveform", "blockage", "note", "age", "score", "ill")
    ]
    assert isinstance(labels.index, pd.RangeIndex)
    assert labels.index[0] == 0
    kinds = {name: labels[name].dtype.kind for name in labels.columns if name != "note"}
    assert kinds == {
        "geometry": "i",
        "waveform": "i",
        "blockage": "f",
        "age": "i",
        "score": "f",
        "ill": "b",
    }
    assert list(labels["note"]) == ["a", "b"] * 6
    assert labels["blockage"].isna().sum() == 6


def test_to_frame(small_cases):
    frame = small_cases.to_frame()
    assert list(frame.columns) == [
        *("geometry", "waveform", "blockage", "patient"),
        *("time", "z"),
        *("flow", "area", "pressure", "area_undeformed"),
    ]
    assert len(frame) == 12 * 20 * 21
    row = frame[(frame.geometry == 2) & (frame.waveform == 3)].iloc[7 * 21 + 5]
    assert row["time"] == small_cases.time[7]
    assert row["z"] == small_cases.z[5]
    case = 7
    for name in ("flow", "area", "pressure"):
        assert row[name] == getattr(small_cases, name)[case, 7, 5]
    assert row["area_undeformed"] == small_cases.area_undeformed[case, 5]
    assert row["patient"] == small_cases.labels["patient"][case]


# ---- what it refuses


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("flow", (3, 17, 20), np.nan, r"flow\[3, 17, 20\] is nan: all values must be finite; 1 va"),
        ("flow", (3, 17), np.inf, r"flow\[3, 17, 0\] is inf: .*; 21 values of flow are wrong"),
        ("pressure", (0, 0, 1), -np.inf, r"pressure\[0, 0, 1\] is -inf"),
        ("area", (11, 2, 5), -0.1, r"area\[11, 2, 5\] is -0\.1: areas must be positive"),
        ("area_undeformed", (2, 5), 0, r"area_undeformed\[2, 5\] is 0\.0: areas must be positive"),
        ("z", 4, 0.1, r"z\[4\] is 0\.1: z must be strictly increasing \(cm\); 1 value of z is"),
        ("time", 3, 0.16, r"time\[3\] is 0\.16: time must have uniform steps \(here 0\.05 s\)"),
        ("time", 3, np.nan, r"time\[3\] is nan"),
    ],
)
def test_refuses_wrong_values(small_cases, name, place, value, message):
    with pytest.raises(InputError, match=message):
        changed(small_cases, name, place, value)


@pytest.mark.parametrize("name", ["flow", "area", "pressure"])
@pytest.mark.parametrize(
    ("order", "found", "remedy"),
    [
        ((0, 2, 1), "(case, z, time)", (0, 2, 1)),
        ((1, 2, 0), "(time, z, case)", (2, 0, 1)),
        ((2, 0, 1), "(z, case, time)", (1, 2, 0)),
    ],
)
def test_names_a_wrong_axis_order(small_cases, name, order, found, remedy):
    right = getattr(small_cases, name)
    wrong = np.transpose(right, order)
    assert np.array_equal(np.transpose(wrong, remedy), right)
    with pytest.raises(InputError) as caught:
        Cases(**arguments(small_cases, **{name: wrong}))
    text = str(caught.value)
    assert text.startswith(f"{name} must have the shape (case, time, z) = (12, 20, 21), but ")
    assert text.endswith(f"; that looks like {found}: pass np.transpose({name}, {remedy})")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"flow": np.ones((12, 20, 20))}, r"flow must have .* = \(12, 20, 21\).* \(12, 20, 20\)$"),
        ({"flow": np.ones((20, 21))}, r"for a single case pass flow\[np\.newaxis\]"),
        ({"area_undeformed": np.ones(21)}, r"pass area_undeformed\[np\.newaxis\]"),
        (
            {"area_undeformed": np.ones((12, 20))},
            r"area_undeformed must have the shape \(case, z\)",
        ),
        ({"area_undeformed": np.ones((0, 21))}, "there is no case"),
        ({"area_undeformed": 1.0}, r"its shape is \(\)"),
        ({"time": np.ones((2, 10))}, r"time must have one axis, but its shape is \(2, 10\)"),
        ({"time": np.arange(3)}, "time has 3 time points; at least 4 are needed"),
        ({"z": np.arange(2)}, "z has 2 points; at least 3 are needed"),
        ({"time": -np.arange(20)}, "time must increase"),
        ({"flow": np.ones((12, 20, 21), complex)}, "flow must hold real numbers.*complex128"),
        ({"flow": np.ones((12, 20, 21), bool)}, "flow must hold real numbers.*bool"),
        ({"flow": np.full((12, 20, 21), "1")}, "flow must hold real numbers"),
        ({"flow": np.ones((12, 20, 21), object)}, "flow must hold real numbers.*object"),
        ({"flow": [[1, 2], [3]]}, "flow is not a regular array"),
        (
            {"flow": np.ma.masked_less(np.zeros((12, 20, 21)), 1)},
            "flow has masked values",
        ),
        ({"period": "1"}, "period must be a number of seconds; '1' is not"),
        ({"period": True}, "period must be a number of seconds"),
        ({"period": np.nan}, "period is nan s"),
        (
            {"period": 0.5},
            r"20 time points in steps of 0\.05 s make 1 s: time must cover",
        ),
        ({"period": 0.95}, "the last time point repeats the first, one period later; leave it out"),
        ({"period": 1.05}, "the last time point of the cycle is missing"),
    ],
)
def test_refuses_wrong_arguments(small_cases, changes, message):
    with pytest.raises(InputError, match=message):
        Cases(**arguments(small_cases, **changes))


def closed(array):
    return np.concatenate([array, array[:, :1]], axis=1)


def test_refuses_a_repeated_end_point_without_a_period(small_cases):
    given = arguments(small_cases, time=np.arange(21) / 20, period=None)
    given |= {name: closed(given[name]) for name in ("flow", "area", "pressure")}
    with pytest.raises(InputError, match=r"last time point repeats the first.*or pass period="):
        Cases(**given)
    steady = {name: np.repeat(given[name][:, :1], 21, axis=1) for name in ("flow", "area")}
    steady["pressure"] = np.repeat(given["pressure"][:, :1], 21, axis=1)
    assert Cases(**given | steady).period == pytest.approx(1.05)


def test_time_may_start_anywhere_and_be_stored_in_single_precision(small_cases):
    for time in (2.0 + small_cases.time, (3.0 + small_cases.time).astype(np.float32)):
        assert Cases(**arguments(small_cases, time=time)).period == 1.0


def labelled(cases, **columns):
    return Cases(**arguments(cases, labels=cases.labels.assign(**columns)))


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"geometry": range(12)}, "labels lacks the column 'waveform'"),
        ({"geometry": range(12), "waveform": [0]}, "cannot be made into a DataFrame"),
        ({"geometry": range(5), "waveform": range(5)}, "labels has 5 rows but there are 12 cases"),
        ({"geometry": [1] * 12, "waveform": [*range(11), 4]}, "waveform 4 is in rows 4 and 11"),
        (
            {"geometry": [1] * 12, "waveform": [0.5, *range(11)]},
            r"labels\['waveform'\]\[0\] is .*0\.5.*; waveform must be a whole number",
        ),
        (
            {"geometry": [1] * 12, "waveform": [*range(11), None]},
            r"labels\['waveform'\]\[11\] is .*nan",
        ),
        ({"geometry": list("abcdefghijkl"), "waveform": range(12)}, r"labels\['geometry'\]\[0\]"),
        (
            pd.DataFrame(
                [[i, i, i] for i in range(12)], columns=["geometry", "waveform", "geometry"]
            ),
            "labels has two columns named 'geometry'",
        ),
    ],
)
def test_refuses_wrong_labels(small_cases, labels, message):
    with pytest.raises(InputError, match=message):
        Cases(**arguments(small_cases, labels=labels))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"blockage": [0.4] * 11 + [40.0]},
            r"labels\['blockage'\]\[11\] is 40\.0: blockage is a f",
        ),
        ({"blockage": ["x"] * 12}, r"labels\['blockage'\] must hold numbers"),
        ({"patient 1": 0}, "column named 'patient 1'; use Python names"),
        ({"note": ["a"] * 11 + [3]}, r"labels\['note'\]\[11\] is 3; a column of labels must hold"),
        ({"note": ["a\0"] * 12}, r"labels\['note'\]\[0\] is 'a\\x00'"),
        ({"note": [["list"]] * 12}, r"labels\['note'\]\[0\] is \['list'\]"),
        ({"when": pd.Timestamp("2024-11-08")}, r"labels\['when'\]\[0\]"),
    ],
)
def test_refuses_wrong_label_columns(small_cases, columns, message):
    with pytest.raises(InputError, match=message):
        labelled(small_cases, **columns)


@pytest.mark.parametrize(
    ("name", "factor", "message"),
    [
        ("area_undeformed", 100, "area is 0.0105 times area_undeformed"),
        ("pressure", 1 / 1333.22, r"the largest pressure is .*1 mmHg = 1333\.22 dyn/cm²"),
        ("pressure", 1e3, "the largest pressure is"),
        ("flow", 60, "the median of flow / area is .*expected cm/s"),
        ("flow", 1e-6, "the median of flow / area is .*expected cm/s"),
    ],
)
def test_warns_of_other_units(small_cases, name, factor, message):
    with pytest.warns(UnitsWarning, match=message):
        Cases(**arguments(small_cases, **{name: factor * getattr(small_cases, name)}))


@pytest.mark.parametrize(("factor", "what"), [(100, "mm²"), (1e-4, "m²")])
def test_warns_of_areas_in_other_units(small_cases, factor, what):
    both = {name: factor * getattr(small_cases, name) for name in ("area", "area_undeformed")}
    with pytest.warns(UnitsWarning, match="check the units"):
        Cases(**arguments(small_cases, **both))


def test_usual_values_do_not_warn(small_cases):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Cases(**arguments(small_cases))
        Cases(**arguments(small_cases, flow=np.zeros(small_cases.flow.shape)))


# ---- choosing cases


@pytest.mark.parametrize(
    ("index", "positions"),
    [
        (5, [5]),
        (-1, [11]),
        (np.int64(2), [2]),
        ([7, 0, -2], [7, 0, 10]),
        (slice(None, None, -1), range(11, -1, -1)),
        (slice(2, 4), [2, 3]),
        (np.arange(12) % 5 == 0, [0, 5, 10]),
        ([True] + [False] * 11, [0]),
        ([(3, 0), (1, 2)], [8, 2]),
        ([[1, 1]], [1]),
        (np.array([[2, 3]]), [7]),
    ],
)
def test_select_by_position_mask_and_pairs(small_cases, index, positions):
    chosen = small_cases.select(index)
    assert pairs(chosen) == [pairs(small_cases)[i] for i in positions]
    assert isinstance(chosen.labels.index, pd.RangeIndex)
    for name in ("flow", "area", "pressure", "area_undeformed"):
        array = getattr(chosen, name)
        assert np.array_equal(array, getattr(small_cases, name)[list(positions)])
        assert array.flags.c_contiguous
        assert not array.flags.writeable
    assert Cases(**arguments(chosen)) == chosen


def test_select_by_labels(small_cases):
    assert pairs(small_cases.select(geometry=2)) == [(2, 0), (2, 1), (2, 2), (2, 3)]
    assert pairs(small_cases.select(geometry=[3, 1], waveform=2)) == [(1, 2), (3, 2)]
    assert pairs(small_cases.select(waveform=range(2), patient="patient 1")) == [(1, 0), (1, 1)]
    assert set(small_cases.select(blockage=0.1 + 0.4).labels["geometry"]) == {2}
    unknown = labelled(small_cases, blockage=[np.nan, *[0.5] * 11])
    assert pairs(unknown.select(blockage=np.nan)) == [(1, 0)]
    mask = small_cases.labels["waveform"] == 3
    assert small_cases.select(mask) == small_cases.select(waveform=3)


@pytest.mark.parametrize(
    ("args", "labels", "message"),
    [
        ((), {}, "neither was given"),
        ((0,), {"geometry": 1}, "both were given"),
        ((12,), {}, "there is no case 12: positions run from 0 to 11, or from -12 to -1"),
        (([0, -13],), {}, "there is no case -13"),
        ((slice(5, 5),), {}, "the selection is empty"),
        (([],), {}, "the selection is empty"),
        (([False] * 12,), {}, "the selection is empty"),
        (([True],), {}, "the mask has 1 value but there are 12 cases"),
        ((slice("a", None),), {}, "the slice .* is not usable"),
        (((1, 2),), {}, r"write \[\(1, 2\)\] for a \(geometry, waveform\) pair, or \[1, 2\] for p"),
        (([1.5],), {}, r"select cannot use \[1\.5\]"),
        (("paper",), {}, "select cannot use 'paper'"),
        ((True,), {}, "select cannot use True"),
        (([[1, 2], [3]],), {}, "select cannot use"),
        (([[1, 2, 3]],), {}, r"select, entry 0, is \[1, 2, 3\]; write \[geometry, waveform\]"),
        (([[1.5, 2]],), {}, "two whole numbers"),
        (([(1, 2), (9, 9)],), {}, r"not in this data set: \(geometry, waveform\) = \(9, 9\);"),
        (([(1, 2), (1, 2)],), {}, r"select names \(1, 2\) twice, the second time as entry 1"),
        (([3, -9],), {}, "case 3 is selected more than once"),
        ((), {"geometry": 11}, "no case has geometry = 11; the available values are: 1, 2, 3"),
        ((), {"geometry": [1, 7, 8]}, "no case has geometry = 7, 8"),
        ((), {"patient": "Anne"}, "no case has patient = Anne"),
        ((), {"colour": "red"}, "there is no label 'colour'; the labels are 'geometry', 'wavefo"),
        ((), {"geometry": 1, "patient": "patient 2"}, "the selection is empty"),
    ],
)
def test_select_refuses(small_cases, args, labels, message):
    with pytest.raises(InputError, match=message):
        small_cases.select(*args, **labels)


# ---- training and test


def test_paper_split_of_any_matrix(small_cases):
    shuffled = small_cases.select(np.random.default_rng(1).permutation(12))
    split = shuffled.split("paper")
    assert isinstance(split, Split)
    assert pairs(split.train) == [(g, w) for g in (1, 2) for w in (0, 1, 2)]
    assert pairs(split.test) == [(1, 3), (2, 3), *((3, w) for w in range(4))]
    assert split == small_cases.split()


@pytest.mark.parametrize("chosen", [{"geometry": 1}, {"waveform": 2}])
def test_paper_split_needs_two_of_each(small_cases, chosen):
    with pytest.raises(InputError, match="so no case is left for training; name the cases"):
        small_cases.select(**chosen).split()


@pytest.mark.parametrize("kind", ["mapping", "file"])
def test_split_by_name(small_cases, tmp_path, kind):
    mapping = {"train": [[2, 1], [1, 3]], "test": [[3, 0]]}
    path = tmp_path / "split.json"
    path.write_text(json.dumps(mapping))
    for how in [mapping] if kind == "mapping" else [path, str(path)]:
        split = small_cases.split(how)
        assert pairs(split.train) == [(2, 1), (1, 3)]
        assert pairs(split.test) == [(3, 0)]


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"train": [[1, 1]], "tets": []}, "unknown keys: tets; the keys are 'train' and 'test'"),
        ({"train": [[1, 1]]}, "has no 'test'"),
        ({"test": [[1, 1]]}, "has no 'train'"),
        ({"train": [[1, 1]], "test": []}, "'test' of .* must be a non-empty list"),
        ({"train": 3, "test": [[1, 1]]}, "'train' of .* must be a non-empty list"),
        ({"train": "all", "test": [[1, 1]]}, "'train' of .* must be a non-empty list"),
        ({"train": [[1, 1], [1]], "test": [[1, 2]]}, r"'train' of .*, entry 1, is \[1\]"),
        ({"train": [[1, 1.5]], "test": [[1, 2]]}, "two whole numbers"),
        ({"train": [[1, True]], "test": [[1, 2]]}, "two whole numbers"),
        ({"train": [[1, 1], [1, 1]], "test": [[1, 2]]}, r"names \(1, 1\) twice"),
        ({"train": [[1, 1], [1, 2]], "test": [[1, 2]]}, r"in both 'train' and 'test'.*\(1, 2\)"),
        ({"train": [[1, 1], [4, 1], [1, 7]], "test": [[1, 2]]}, r"data set: .*\(4, 1\), \(1, 7\);"),
    ],
)
def test_split_refuses(small_cases, tmp_path, mapping, message):
    with pytest.raises(InputError, match=message):
        small_cases.split(mapping)
    path = tmp_path / "split.json"
    path.write_text(json.dumps(mapping))
    with pytest.raises(InputError, match=message) as caught:
        small_cases.split(path)
    assert "split.json" in str(caught.value)


def test_split_refuses_files(small_cases, tmp_path):
    with pytest.raises(DataNotFoundError, match=r"no split file 'papre'; give 'paper', a mapping"):
        small_cases.split("papre")
    path = tmp_path / "split.json"
    for text in ('{"train": [[1, 1]', "\udcff", "[" * 100_000):
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(FileError, match="is not a readable JSON file"):
            small_cases.split(path)
    path.write_text("[1]")
    with pytest.raises(InputError, match=r'must hold \{"train"'):
        small_cases.split(path)


# ---- files


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip(small_cases, tmp_path, suffix):
    path = tmp_path / f"data{suffix}"
    path.write_text("something older")
    small_cases.save(path)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    again = Cases.load(str(path))
    assert again == small_cases
    pd.testing.assert_frame_equal(again.labels, small_cases.labels)


def test_h5_names_its_units(small_cases, tmp_path):
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
    """A flipped byte is refused, or it stood where nothing was stored."""
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
    with pytest.raises(FileError, match="has format version 7, newer than 1"):
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


# ---- properties

bounded = settings(max_examples=25, deadline=None)
finite = st.floats(-1e300, 1e300)


@st.composite
def data_sets(draw):
    n_cases, n_times, n_points = (
        draw(st.integers(low, high)) for low, high in [(1, 6), (4, 7), (3, 5)]
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    keys = draw(
        st.lists(
            st.tuples(st.integers(-3, 12), st.integers(0, 9)),
            min_size=n_cases,
            max_size=n_cases,
            unique=True,
        )
    )
    labels = {"geometry": [key[0] for key in keys], "waveform": [key[1] for key in keys]}
    columns = {
        "blockage": st.one_of(st.just(np.nan), st.floats(0, 0.99)),
        "note": st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")),
        "number": st.integers(-(2**63), 2**63 - 1),
        "score": st.floats(),
        "flag": st.booleans(),
    }
    for name in draw(st.sets(st.sampled_from(sorted(columns)))):
        labels[name] = draw(st.lists(columns[name], min_size=n_cases, max_size=n_cases))
    shape = (n_cases, n_times, n_points)
    flow = rng.normal(size=shape)
    flow[0, 0, 0] = draw(finite)
    step = draw(st.floats(1e-3, 10))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitsWarning)
        return Cases(
            flow,
            rng.uniform(0.1, 0.2, size=shape),
            rng.normal(size=shape),
            rng.uniform(0.1, 0.2, size=(n_cases, n_points)),
            draw(st.floats(-10, 10)) + step * np.arange(n_times),
            np.cumsum(rng.uniform(0.1, 1, size=n_points)),
            labels=labels,
        )


@pytest.mark.filterwarnings("ignore::pcnde_bridge.UnitsWarning")
@bounded
@given(cases=data_sets(), suffix=st.sampled_from(SUFFIXES))
def test_any_data_set_survives_a_file(tmp_path_factory, cases, suffix):
    path = tmp_path_factory.mktemp("any") / f"data{suffix}"
    cases.save(path)
    again = Cases.load(path)
    assert again == cases
    assert again.fingerprint() == cases.fingerprint()
    assert again.period == cases.period
    assert np.array_equal(again.flow, cases.flow)
    pd.testing.assert_frame_equal(again.labels, cases.labels)


@bounded
@given(cases=data_sets())
def test_the_paper_split_is_a_partition(cases):
    try:
        split = cases.split()
    except InputError:
        assert (
            cases.labels["geometry"].nunique() == 1
            or cases.labels["waveform"].nunique() == 1
            or (
                (cases.labels["geometry"] == cases.labels["geometry"].max())
                | (cases.labels["waveform"] == cases.labels["waveform"].max())
            ).all()
        )
        return
    assert sorted(pairs(split.train) + pairs(split.test)) == sorted(pairs(cases))
    assert pairs(split.train) == sorted(pairs(split.train))
    assert max(g for g, _ in pairs(split.train)) < cases.labels["geometry"].max()
    assert max(w for _, w in pairs(split.train)) < cases.labels["waveform"].max()
    named = cases.split({"train": pairs(split.train), "test": pairs(split.test)})
    assert named == split


@bounded
@given(data=st.data())
def test_selecting_keeps_the_order_asked_for(small_cases, data):
    wanted = data.draw(st.lists(st.integers(0, 11), min_size=1, unique=True))
    chosen = small_cases.select(wanted)
    assert pairs(chosen) == [pairs(small_cases)[i] for i in wanted]
    assert chosen == small_cases.select(pairs(chosen))
    back = [wanted.index(i) for i in sorted(wanted)]
    mask = np.isin(np.arange(12), wanted)
    assert chosen.select(back) == small_cases.select(mask)


@pytest.mark.parametrize("name", ["time", "z", "flow", "area_undeformed", "novelty"])
def test_labels_leave_the_names_of_a_prediction_alone(small_cases, name):
    with pytest.raises(InputError, match=f"column named '{name}', which is the name"):
        with_labels(small_cases, small_cases.labels.assign(**{name: 1.0}))


def test_a_split_that_is_neither_named_nor_a_file_is_refused(small_cases):
    with pytest.raises(InputError, match=r"how must be 'paper', a mapping or the path"):
        small_cases.split([1])


def test_whole_numbers_may_have_any_type(small_cases):
    labels = small_cases.labels.astype({"geometry": object})
    assert with_labels(small_cases, labels) == small_cases
    fields = (np.tile(getattr(small_cases, n), (25, 1, 1)) for n in ("flow", "area", "pressure"))
    undeformed = np.tile(small_cases.area_undeformed, (25, 1))
    many = Cases(*fields, undeformed, small_cases.time, small_cases.z)
    assert many.select(np.array([11, 3], np.uint8)) == many.select([11, 3])
    assert many.select(np.array([-1, 3], np.int8)) == many.select([299, 3])
    with pytest.raises(InputError, match="there is no case 18446744073709551615"):
        many.select(np.array([2**64 - 1], np.uint64))


def with_labels(cases, labels):
    axes = cases.area_undeformed, cases.time, cases.z
    return Cases(cases.flow, cases.area, cases.pressure, *axes, period=cases.period, labels=labels)
