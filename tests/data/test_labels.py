"""Labels of the cases of a data set."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from helpers import case_arguments, with_labels

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError


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
    labels = Cases(**case_arguments(small_cases, labels=given)).labels
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


def labelled(cases, **columns):
    return Cases(**case_arguments(cases, labels=cases.labels.assign(**columns)))


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"geometry": range(12)}, "labels lacks the column 'waveform'"),
        ({"geometry": range(12), "waveform": [0]}, "cannot be converted to a DataFrame"),
        ({"geometry": range(5), "waveform": range(5)}, "labels has 5 rows but there are 12 cases"),
        ({"geometry": [1] * 12, "waveform": [*range(11), 4]}, "waveform 4 twice, in rows 4 and 11"),
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
        Cases(**case_arguments(small_cases, labels=labels))


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


@pytest.mark.parametrize("name", ["time", "z", "flow", "area_undeformed", "novelty"])
def test_labels_leave_the_names_of_a_prediction_alone(small_cases, name):
    with pytest.raises(InputError, match=f"column named '{name}', which is the name"):
        with_labels(small_cases, small_cases.labels.assign(**{name: 1.0}))


def test_labels_named_like_results_are_not_overwritten(small_cases, physics_prediction):
    named = with_labels(small_cases, small_cases.labels.assign(ffr=0.9))
    with pytest.raises(InputError, match="label 'ffr' has the name of a column"):
        named.indices()
    labels = physics_prediction.labels.assign(ffr_low=0.5, flow_standard_deviation=1.0)
    predicted = dataclasses.replace(physics_prediction, labels=labels)
    with pytest.raises(InputError, match="label 'ffr_low'"):
        predicted.indices()
    with pytest.raises(InputError, match="label 'flow_standard_deviation'"):
        predicted.to_frame()
