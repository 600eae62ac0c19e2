"""The data set: contents, copies, equality, and properties of any data set."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re
import warnings

import numpy as np
import pandas as pd
import pytest
from helpers import case_arguments, case_pairs
from hypothesis import given, settings
from hypothesis import strategies as st

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.errors import InputError

SUFFIXES = (".npz", ".h5", ".hdf5")


def changed(cases, name, place, value):
    array = np.array(getattr(cases, name))
    array[place] = value
    return Cases(**case_arguments(cases, **{name: array}), check=False)


def test_holds_read_only_copies(small_cases):
    given = case_arguments(small_cases)
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
    same = Cases(**case_arguments(small_cases))
    assert same == small_cases
    assert hash(same) == hash(small_cases)
    assert same.fingerprint() == small_cases.fingerprint()
    assert re.fullmatch("[0-9a-f]{64}", same.fingerprint())
    assert small_cases != changed(small_cases, "flow", (3, 4, 5), 1.0)
    assert small_cases != Cases(**case_arguments(small_cases, labels=None))
    assert small_cases != "something else"
    for twin in (copy.copy(same), copy.deepcopy(same), pickle.loads(pickle.dumps(same))):  # noqa: S301
        assert twin == small_cases
        assert not twin.flow.flags.writeable


FINGERPRINT = "0a3702f9973f473c4911ec9e30ecca9b93073bd9be8e4957d399b81540935744"


def test_a_subset_has_a_fingerprint_of_its_own(small_cases):
    whole = small_cases.fingerprint()
    assert small_cases[:2].fingerprint() == small_cases[[1, 0]][[1, 0]].fingerprint() != whole
    assert copy.copy(small_cases).fingerprint() == whole


def test_fingerprint_is_the_same_on_every_machine_and_version():
    """A changed fingerprint would invalidate the checksums in all model files."""
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
            check=False,
        )
    assert made.fingerprint() == FINGERPRINT


def test_defaults(small_cases):
    made = Cases(**case_arguments(small_cases, period=None, labels=None))
    assert made.period == pytest.approx(1.0, rel=1e-12)
    assert list(made.labels.columns) == ["geometry", "waveform", "blockage"]
    assert list(made.labels["geometry"]) == list(range(1, 13))
    assert set(made.labels["waveform"]) == {0}
    undeformed = small_cases.area_undeformed
    assert np.array_equal(made.labels["blockage"], 1 - undeformed.min(axis=1) / undeformed[:, 0])
    assert made.labels["blockage"][0] == pytest.approx(0.4, abs=1e-6)


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
            check=False,
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
    assert sorted(case_pairs(split.train) + case_pairs(split.test)) == sorted(case_pairs(cases))
    assert case_pairs(split.train) == sorted(case_pairs(split.train))
    assert max(g for g, _ in case_pairs(split.train)) < cases.labels["geometry"].max()
    assert max(w for _, w in case_pairs(split.train)) < cases.labels["waveform"].max()
    named = cases.split({"train": case_pairs(split.train), "test": case_pairs(split.test)})
    assert named == split


def test_wall_shear_stress_goes_with_its_cases(sheared_cases, small_cases):
    stress = sheared_cases.wall_shear_stress
    assert small_cases.wall_shear_stress is None
    assert sheared_cases != small_cases
    assert repr(sheared_cases).endswith("z from 0 to 4 cm; with wall shear stress)")
    part = sheared_cases.select([7, 2])
    assert np.array_equal(part.wall_shear_stress, stress[[7, 2]])
    twin = pickle.loads(pickle.dumps(part))  # noqa: S301
    assert twin == part
    assert not twin.wall_shear_stress.flags.writeable
    train, test = sheared_cases.split("paper")
    assert len(train.wall_shear_stress) == len(train) == 12 - len(test.wall_shear_stress)
    frame = sheared_cases.to_frame()
    assert np.array_equal(frame["wall_shear_stress"], stress.ravel())
    assert list(frame.columns[-3:]) == ["pressure", "wall_shear_stress", "area_undeformed"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda stress: stress[:, 1:], r"wall_shear_stress must have .*is \(12, 19, 21\)"),
        (lambda stress: np.where(stress == stress.max(), np.nan, stress), "wall_shear_stress.*nan"),
        (lambda stress: stress / 10, "All numbers are usual with wall_shear_stress in Pa"),
        (lambda stress: 0 * stress, "the wall shear stress over Poiseuille's is 0, usual are"),
    ],
)
def test_unusable_wall_shear_stress(sheared_cases, change, message):
    changed = change(sheared_cases.wall_shear_stress)
    with pytest.raises(InputError, match=message):
        Cases(**case_arguments(sheared_cases, wall_shear_stress=changed))
