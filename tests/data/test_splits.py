"""Validation cases and folds of the training cases."""

from __future__ import annotations

import numpy as np

from pcnde_bridge.data.splits import training_and_validation


def test_the_validation_part_is_whole_waveforms_and_geometries(small_cases):
    fitted, held = training_and_validation(small_cases, 0.3, 0)
    assert sorted([*fitted, *held]) == list(range(12))
    assert 4 <= len(held) <= 6
    labels = small_cases.labels
    for case in held:
        alike = [labels[name] == labels[name][case] for name in ("geometry", "waveform")]
        assert any(set(np.flatnonzero(same)) <= set(held) for same in alike)
    again = training_and_validation(small_cases, 0.3, 0)
    assert np.array_equal(again[1], held)
    others = {tuple(training_and_validation(small_cases, 0.3, seed)[1]) for seed in range(10)}
    assert len(others) > 3


def test_without_groups_single_cases_are_held_out(small_cases):
    one_each = small_cases.select(range(9))
    object.__setattr__(one_each, "_labels", one_each.labels.assign(geometry=range(9), waveform=0))
    fitted, held = training_and_validation(one_each, 0.25, 0)
    assert (len(fitted), len(held)) == (7, 2)


def test_few_cases_spare_none(small_cases):
    (only,) = training_and_validation(small_cases.select(range(7)), 0.3, 0)
    assert np.array_equal(only, range(7))
    (only,) = training_and_validation(small_cases, 0.0, 0)
    assert np.array_equal(only, range(12))
