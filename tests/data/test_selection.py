"""Selections of cases."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers import case_arguments, case_pairs, with_labels
from hypothesis import given, settings
from hypothesis import strategies as st

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError


def labelled(cases, **columns):
    return Cases(**case_arguments(cases, labels=cases.labels.assign(**columns)))


bounded = settings(max_examples=25, deadline=None)


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
    assert case_pairs(chosen) == [case_pairs(small_cases)[i] for i in positions]
    assert isinstance(chosen.labels.index, pd.RangeIndex)
    for name in ("flow", "area", "pressure", "area_undeformed"):
        array = getattr(chosen, name)
        assert np.array_equal(array, getattr(small_cases, name)[list(positions)])
        assert array.flags.c_contiguous
        assert not array.flags.writeable
    assert Cases(**case_arguments(chosen)) == chosen


def test_index_and_iterate(small_cases):
    for index in (0, -1, slice(2, 9, 3), [7, 0], np.arange(12) % 5 == 0, [(3, 0)]):
        assert small_cases[index] == small_cases.select(index)
    assert [case_pairs(case) for case in small_cases] == [
        [pair] for pair in case_pairs(small_cases)
    ]
    for index, message in ((12, "index 12 is out of bounds"), (slice(5, 5), "is empty")):
        with pytest.raises(InputError, match=message):
            small_cases[index]


def test_select_by_labels(small_cases):
    assert case_pairs(small_cases.select(geometry=2)) == [(2, 0), (2, 1), (2, 2), (2, 3)]
    assert case_pairs(small_cases.select(geometry=[3, 1], waveform=2)) == [(1, 2), (3, 2)]
    assert case_pairs(small_cases.select(waveform=range(2), patient="patient 1")) == [
        (1, 0),
        (1, 1),
    ]
    assert set(small_cases.select(blockage=0.1 + 0.4).labels["geometry"]) == {2}
    unknown = labelled(small_cases, blockage=[np.nan, *[0.5] * 11])
    assert case_pairs(unknown.select(blockage=np.nan)) == [(1, 0)]
    mask = small_cases.labels["waveform"] == 3
    assert small_cases.select(mask) == small_cases.select(waveform=3)


@pytest.mark.parametrize(
    ("args", "labels", "message"),
    [
        ((), {}, "neither was given"),
        ((0,), {"geometry": 1}, "both were given"),
        ((12,), {}, "select cannot use 12 in 12 cases: index 12 is out of bounds"),
        (([0, -13],), {}, "index -13 is out of bounds"),
        ((slice(5, 5),), {}, "the selection is empty"),
        (([],), {}, "the selection is empty"),
        (([False] * 12,), {}, "the selection is empty"),
        (([True],), {}, r"select cannot use \[True\] in 12 cases: boolean index did not match"),
        ((slice("a", None),), {}, "select cannot use slice.*: slice indices must be"),
        (((1, 2),), {}, r"write \[\(1, 2\)\] for a \(geometry, waveform\) pair, or \[1, 2\] for p"),
        (([1.5],), {}, r"select cannot use \[1\.5\]"),
        (("paper",), {}, "select cannot use 'paper'"),
        ((True,), {}, "select cannot use True"),
        (([[1, 2], [3]],), {}, "select cannot use"),
        (([[1, 2, 3]],), {}, r"select, entry 0, is \[1, 2, 3\]; write \[geometry, waveform\]"),
        (([[1.5, 2]],), {}, "two whole numbers"),
        (([(1, 2), (9, 9)],), {}, r"not in this data set: \(geometry, waveform\) = \(9, 9\);"),
        (([(1, 2), (1, 2)],), {}, "select asks for case 2 of the data set more than once"),
        (([3, -9],), {}, "select asks for case 3 of the data set more than once"),
        ((), {"geometry": 11}, "no case has geometry = 11; the values are: 1, 2, 3"),
        ((), {"geometry": [1, 7, 8]}, "no case has geometry = 7, 8"),
        ((), {"patient": "Anne"}, "no case has patient = Anne"),
        ((), {"colour": "red"}, "there is no label 'colour'; the labels are 'geometry', 'wavefo"),
        ((), {"geometry": 1, "patient": "patient 2"}, "the selection is empty"),
    ],
)
def test_select_refuses(small_cases, args, labels, message):
    with pytest.raises(InputError, match=message):
        small_cases.select(*args, **labels)


@bounded
@given(data=st.data())
def test_selection_has_the_requested_order(small_cases, data):
    wanted = data.draw(st.lists(st.integers(0, 11), min_size=1, unique=True))
    chosen = small_cases.select(wanted)
    assert case_pairs(chosen) == [case_pairs(small_cases)[i] for i in wanted]
    assert chosen == small_cases.select(case_pairs(chosen))
    back = [wanted.index(i) for i in sorted(wanted)]
    mask = np.isin(np.arange(12), wanted)
    assert chosen.select(back) == small_cases.select(mask)


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
