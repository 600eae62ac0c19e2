"""Division of a data set into training and test cases, and into folds."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers import case_pairs

from pcnde_bridge.data.cases import Split
from pcnde_bridge.errors import DataNotFoundError, FileError, InputError


def positions(cases, part):
    everything = case_pairs(cases)
    return [everything.index(pair) for pair in case_pairs(part)]


def test_paper_split_of_any_matrix(small_cases):
    shuffled = small_cases.select(np.random.default_rng(1).permutation(12))
    split = shuffled.split("paper")
    assert isinstance(split, Split)
    assert case_pairs(split.train) == [(g, w) for g in (1, 2) for w in (0, 1, 2)]
    assert case_pairs(split.test) == [(1, 3), (2, 3), *((3, w) for w in range(4))]
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
        assert case_pairs(split.train) == [(2, 1), (1, 3)]
        assert case_pairs(split.test) == [(3, 0)]


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        (
            {"train": [[1, 1]], "tets": []},
            "unknown key 'tets'; give 'train' and 'test'",
        ),
        ({"train": [[1, 1]]}, "has no 'test'"),
        ({"test": [[1, 1]]}, "has no 'train'"),
        ({"train": [[1, 1]], "test": []}, "'test' of .* must be a non-empty list"),
        ({"train": 3, "test": [[1, 1]]}, "'train' of .* must be a non-empty list"),
        ({"train": "all", "test": [[1, 1]]}, "'train' of .* must be a non-empty list"),
        ({"train": [[1, 1], [1]], "test": [[1, 2]]}, r"'train' of .*, entry 1, is \[1\]"),
        ({"train": [[1, 1.5]], "test": [[1, 2]]}, "two whole numbers"),
        ({"train": [[1, True]], "test": [[1, 2]]}, "two whole numbers"),
        (
            {"train": [[1, 1], [1, 1]], "test": [[1, 2]]},
            "asks for case 1 of the data set more than once",
        ),
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
    with pytest.raises(DataNotFoundError, match=r"no split file 'papre'; give 'paper', a fraction"):
        small_cases.split("papre")
    path = tmp_path / "split.json"
    for text in ('{"train": [[1, 1]', "\udcff", "[" * 100_000):
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(FileError, match="is not a readable JSON file"):
            small_cases.split(path)
    path.write_text("[1]")
    with pytest.raises(InputError, match=r'must hold .*\{"train"'):
        small_cases.split(path)


def test_a_split_that_is_neither_named_nor_a_file_is_refused(small_cases):
    with pytest.raises(InputError, match=r"how must be 'paper', a fraction, label values, a"):
        small_cases.split([1])


@pytest.mark.parametrize(
    ("fraction", "count"), [(0.25, 3), (0.5, 6), (1e-9, 1), (0.999, 11), (np.float64(0.2), 2)]
)
def test_random_fraction(small_cases, fraction, count):
    train, test = small_cases.split(fraction, seed=1)
    assert len(test) == count
    assert sorted(positions(small_cases, train) + positions(small_cases, test)) == list(range(12))
    for part in (train, test):
        assert positions(small_cases, part) == sorted(positions(small_cases, part))
    assert small_cases.split(fraction, seed=1) == (train, test)


def test_random_splits_depend_on_the_seed(small_cases):
    chosen = {tuple(positions(small_cases, small_cases.split(0.5, seed=s).test)) for s in range(9)}
    assert len(chosen) > 5
    assert small_cases.split(0.5) == small_cases.split(0.5, seed=0)


def test_fraction_of_the_values_of_a_label(small_cases):
    for seed in range(5):
        train, test = small_cases.split(0.3, by="waveform", seed=seed)
        left_out = set(test.labels["waveform"])
        assert len(left_out) == 1
        assert len(test) == 3
        assert not left_out & set(train.labels["waveform"])


def test_split_by_label_values(small_cases):
    train, test = small_cases.split(geometry=[1, 3], waveform=2)
    assert case_pairs(test) == [(1, 2), (3, 2)]
    assert positions(small_cases, train) == [i for i in range(12) if i not in (2, 10)]
    assert small_cases.split(patient="patient 1").test == small_cases.select(patient="patient 1")


@pytest.mark.parametrize(
    ("count", "by", "sizes"), [(3, None, [4, 4, 4]), (12, None, [1] * 12), (2, "geometry", [8, 4])]
)
def test_folds(small_cases, count, by, sizes):
    folds = small_cases.folds(count, by=by, seed=3)
    assert [len(fold.test) for fold in folds] == sizes
    left_out = [positions(small_cases, fold.test) for fold in folds]
    assert sorted(np.concatenate(left_out)) == list(range(12))
    for fold, test in zip(folds, left_out, strict=True):
        assert isinstance(fold, Split)
        assert positions(small_cases, fold.train) == [i for i in range(12) if i not in test]
        if by:
            assert not set(fold.train.labels[by]) & set(fold.test.labels[by])
    assert small_cases.folds(count, by=by, seed=3) == folds


@pytest.mark.parametrize(
    ("how", "options", "message"),
    [
        ((0.0,), {}, "must be between 0 and 1, got 0"),
        ((1,), {}, "must be between 0 and 1, got 1"),
        ((float("nan"),), {}, "must be between 0 and 1, got nan"),
        ((True,), {}, "how must be 'paper', a fraction"),
        ((0.2,), {"seed": -1}, "seed must be a whole number ≥ 0, got -1"),
        ((0.2,), {"by": "color"}, "there is no label 'color'; the labels are 'geometry'"),
        ((), {"by": "geometry"}, "by='geometry' needs the fraction"),
        (("paper",), {"geometry": 1}, "how='paper' or label values of the test cases, but not"),
        ((), {"geometry": 7}, "no case has geometry = 7; the values are: 1, 2, 3"),
        ((), {"geometry": [1, 2, 3]}, "no case is left for training"),
    ],
)
def test_split_refuses_arguments(small_cases, how, options, message):
    with pytest.raises(InputError, match=message):
        small_cases.split(*how, **options)


@pytest.mark.parametrize("by", [["geometry"], {}, 3, "geometri"])
def test_labels_that_are_no_names_are_refused(small_cases, by):
    for divide in (lambda: small_cases.split(0.5, by=by), lambda: small_cases.folds(2, by=by)):
        with pytest.raises(InputError, match="there is no label"):
            divide()
    for values in ([[1], [2, 3]], np.array([[1], [2]]), {1: 2}, None):
        with pytest.raises(InputError, match="no case has geometry"):
            small_cases.split(geometry=values)


def test_too_few_groups_are_refused(small_cases):
    with pytest.raises(InputError, match="no case is left for testing"):
        small_cases[0].split(0.5)
    with pytest.raises(InputError, match="folds is 2; 1 geometry value allow"):
        small_cases.select(geometry=1).folds(2, by="geometry")
    with pytest.raises(InputError, match="folds is 4; 3 geometry values allow 2 to 3 folds"):
        small_cases.folds(4, by="geometry")
    with pytest.raises(InputError, match="folds is 1; 12 cases allow 2 to 12 folds"):
        small_cases.folds(1)
