"""Relative errors as section 3.3 of the paper defines them."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import Cases, InputError
from pcnde_bridge.model.metrics import (
    AREA_MARGIN,
    compared,
    error_table,
    pooled,
    pooled_errors,
    relative_error,
)

COLUMNS = ["flow", "area", "pressure", "pressure_drop", "one_minus_ffr"]


def by_hand(predicted, truth):
    return np.sqrt(((predicted - truth) ** 2).sum()) / np.sqrt((truth**2).sum())


@pytest.fixture(scope="module")
def predicted(small_cases):
    rng = np.random.default_rng(0)
    return {
        name: getattr(small_cases, name) * (1 + 0.1 * rng.normal(size=small_cases.flow.shape))
        for name in ("flow", "area", "pressure")
    }


def test_relative_error_of_known_numbers():
    assert relative_error(np.array([3.0, 0.0]), np.array([0.0, 4.0])) == 5 / 4
    assert relative_error(np.ones((2, 3)), np.ones((2, 3))) == 0.0
    assert relative_error(np.array([75, 0], np.int8), np.array([0, 100], np.int8)) == 1.25
    assert relative_error(np.zeros((2, 2, 2)), np.ones((2, 2, 2))) == 1.0


def test_it_does_not_depend_on_the_unit():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 3, 4))
    assert relative_error(1e5 * a, 1e5 * b) == pytest.approx(relative_error(a, b), rel=1e-12)


def test_the_area_is_compared_without_five_points_at_either_end(small_cases):
    assert AREA_MARGIN == 5
    truth = small_cases.area
    wrong_ends = truth.copy()
    wrong_ends[..., :5] = wrong_ends[..., -5:] = 99.0
    errors = pooled_errors({"flow": wrong_ends, "area": wrong_ends}, small_cases)
    assert errors["area"] == 0.0
    assert errors["flow"] > 1.0
    for inside in (5, -6):
        wrong = truth.copy()
        wrong[..., inside] *= 2
        assert pooled_errors({"area": wrong}, small_cases)["area"] > 0.01


def test_a_short_vessel_keeps_its_area():
    assert compared("area", np.ones((2, 10))).shape == (2, 10)
    assert compared("area", np.ones((2, 11))).shape == (2, 1)
    assert compared("pressure", np.ones((2, 21))).shape == (2, 21)


def test_table_by_hand(small_cases, predicted):
    table = error_table(predicted, small_cases)
    assert list(table.columns) == COLUMNS
    assert table.index.names == ["geometry", "waveform"]
    expected_keys = [(g, w) for g in (1, 2, 3) for w in range(4)]
    assert list(table.index) == [*expected_keys, ("pooled", "pooled")]
    for name, values in predicted.items():
        part = slice(5, -5) if name == "area" else slice(None)
        truth = getattr(small_cases, name)[..., part]
        for i in range(12):
            assert table[name].iloc[i] == pytest.approx(
                by_hand(values[i, ..., part], truth[i]), rel=1e-12
            )
        together = by_hand(values[..., part], truth)
        assert table[name].iloc[-1] == pytest.approx(together, rel=1e-12)
    assert table.iloc[-1].to_dict() == pooled_errors(predicted, small_cases)


def test_pooled_is_not_the_mean_of_the_cases(small_cases):
    values = small_cases.pressure.copy()
    values[0] *= 2
    table = error_table({"pressure": values}, small_cases)["pressure"]
    size = [np.linalg.norm(p) for p in small_cases.pressure]
    assert table.iloc[-1] == pytest.approx(size[0] / np.linalg.norm(size))
    assert table.iloc[-1] > 2 * table.iloc[:-1].mean()


def test_pooled_errors_of_a_table(small_cases, predicted):
    found = pooled(error_table(predicted, small_cases))
    assert found == pooled_errors(predicted, small_cases)
    assert list(found) == COLUMNS
    assert {type(value) for value in found.values()} == {float}


def test_errors(small_cases, predicted):
    with pytest.raises(InputError, match=r"must have the shape \(3,\), but its shape is \(2,\)"):
        relative_error(np.ones(2), np.ones(3))
    with pytest.raises(InputError, match="reference is zero"):
        relative_error(np.ones(2), np.zeros(2))
    for part in (small_cases.select([0, 1]), small_cases):
        wrong = {"flow": predicted["flow"][:5]}
        with pytest.raises(InputError, match="must have the shape"):
            error_table(wrong, part)
    with pytest.raises(InputError, match="must have the shape"):
        pooled_errors({"flow": predicted["flow"][:, :-1]}, small_cases)


def test_errors_of_the_drop_and_of_ffr_by_hand(small_cases):
    wrong = small_cases.pressure + 1e3 * (small_cases.z < 1.9)
    table = error_table({"pressure": wrong}, small_cases)
    drop, ffr = small_cases.pressure_drop(), small_cases.ffr()
    mean_drop = drop.mean(axis=1)
    predicted = 1 - (mean_drop + 1e3) / (mean_drop / (1 - ffr) + 1e3)
    for i in range(12):
        assert table["pressure_drop"].iloc[i] == pytest.approx(by_hand(drop[i] + 1e3, drop[i]))
        expected = abs(predicted[i] - ffr[i]) / (1 - ffr[i])
        assert table["one_minus_ffr"].iloc[i] == pytest.approx(expected)
    assert table["pressure_drop"].iloc[-1] == pytest.approx(by_hand(drop + 1e3, drop))
    assert table["one_minus_ffr"].iloc[-1] == pytest.approx(by_hand(1 - predicted, 1 - ffr))
    assert list(pooled_errors({"flow": small_cases.flow}, small_cases)) == ["flow"]


def test_without_a_drop_there_is_no_relative_error_of_it(small_cases):
    flat = Cases(
        small_cases.flow, small_cases.area, np.full_like(small_cases.pressure, 1e5),
        small_cases.area_undeformed, small_cases.time, small_cases.z, units="cgs,area=cm^2",
    )  # fmt: skip
    found = pooled_errors({"pressure": flat.pressure}, flat)
    assert found["pressure"] == 0.0
    assert np.isnan([found["pressure_drop"], found["one_minus_ffr"]]).all()


def test_errors_of_the_wall_shear_stress(sheared_cases, small_cases):
    truth = sheared_cases.wall_shear_stress
    predicted = {"wall_shear_stress": truth * np.linspace(0.9, 1.3, 20)[:, None]}
    errors = pooled_errors(predicted, sheared_cases)
    assert errors["wall_shear_stress"] == pytest.approx(
        by_hand(predicted["wall_shear_stress"], truth), rel=1e-12
    )
    averages = (np.abs(v).mean(axis=1) for v in (predicted["wall_shear_stress"], truth))
    assert errors["time_averaged_wall_shear_stress"] == pytest.approx(by_hand(*averages))
    assert list(error_table(predicted, sheared_cases)) == list(errors)
    # Where only one of them has it, it has no error.
    assert pooled_errors(predicted, small_cases) == {}
    assert list(pooled_errors(small_cases.variables(), sheared_cases)) == COLUMNS
