"""Detailed errors: tables, pointwise errors and statistics by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import InputError
from pcnde_bridge.model.metrics import (
    AREA_MARGIN,
    error_table,
)
from pcnde_bridge.studies import (
    box_statistics,
    error_matrix,
    pointwise_errors,
)

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")


def test_error_matrix_equals_the_table(small_cases, predicted):
    table = error_table(predicted, small_cases)
    matrices = error_matrix(predicted, small_cases)
    assert list(matrices) == ["flow", "area", "pressure"]
    for name, matrix in matrices.items():
        assert matrix.shape == (3, 4)
        for geometry in matrix.index:
            for waveform in matrix.columns:
                assert matrix.loc[geometry, waveform] == table.loc[(geometry, waveform), name]


def test_error_matrix_has_gaps_where_cases_are_missing(small_cases, predicted):
    chosen = small_cases.select([0, 5])
    matrix = error_matrix({"flow": predicted["flow"][[0, 5]]}, chosen)["flow"]
    assert matrix.isna().to_numpy().tolist() == [[False, True], [True, False]]


def test_error_matrix_is_sorted_for_any_order_of_cases(small_cases, predicted):
    order = np.random.default_rng(2).permutation(len(small_cases))
    shuffled = error_matrix({"flow": predicted["flow"][order]}, small_cases.select(order))["flow"]
    pd.testing.assert_frame_equal(shuffled, error_matrix(predicted, small_cases)["flow"])


def test_pointwise_errors_by_hand(toy_model, hardest):
    prediction = toy_model.predict(hardest)
    errors = pointwise_errors(prediction.variables(), hardest)
    flow = np.abs(prediction.flow[0] - hardest.flow[0])
    np.testing.assert_array_equal(errors.distance["flow"], flow)
    area = np.abs(prediction.area[0] - hardest.area[0]) / hardest.area[0, 0]
    np.testing.assert_array_equal(errors.distance["area"], area)
    frame = errors.to_frame()
    assert frame.loc["flow", "mean"] == flow.mean()
    assert frame.loc["area", "largest"] == area.max()
    # 21 points: ten on either side of the middle.
    assert frame.loc["flow", "upstream"] == pytest.approx(flow[:, :10].mean())
    assert frame.loc["flow", "downstream"] == pytest.approx(flow[:, 11:].mean())


def test_pointwise_errors_are_of_one_case(small_cases, predicted):
    with pytest.raises(InputError, match="one case, got 12"):
        pointwise_errors(predicted, small_cases)


def test_shapes_must_equal_those_of_the_truth(small_cases, predicted, hardest):
    with pytest.raises(InputError, match=r"\(12, 20, 21\), but its shape is \(1, 20, 21\)"):
        box_statistics({"mine": {"flow": predicted["flow"][:1]}}, small_cases)
    with pytest.raises(InputError, match=r"\(1, 20, 21\), but its shape is \(1, 1, 21\)"):
        pointwise_errors({"flow": predicted["flow"][:1, :1]}, hardest)


def test_a_method_that_diverged_has_no_statistics(small_cases, predicted):
    nowhere = {"flow": np.full_like(small_cases.flow, np.nan)}
    frame = box_statistics({"diverged": nowhere, "PCNDE": predicted}, small_cases)
    assert frame.loc[("flow", "diverged")].isna().all()
    assert frame.loc[("flow", "PCNDE")].notna().all()


def test_box_statistics_equal_matplotlibs(small_cases, predicted):
    from matplotlib.cbook import boxplot_stats

    other = {"flow": small_cases.flow * 1.01, "area": small_cases.area * 0.98}
    frame = box_statistics({"PCNDE": predicted, "other": other}, small_cases)
    assert list(frame.index[:3]) == [(name, "PCNDE") for name in ("flow", "area", "pressure")]
    inner = slice(AREA_MARGIN, -AREA_MARGIN)
    truth = small_cases.area[:, :, inner]
    errors = (np.abs(predicted["area"][:, :, inner] - truth) / truth).ravel()
    box = boxplot_stats(errors)[0]
    row = frame.loc[("area", "PCNDE")]
    names = {"median": "med", "lower": "q1", "upper": "q3", "low": "whislo", "high": "whishi"}
    for mine, theirs in names.items():
        assert row[mine] == pytest.approx(box[theirs], rel=1e-12)
    assert row["largest"] == errors.max()
    assert row["outliers"] == pytest.approx(len(box["fliers"]) / errors.size)
    assert frame.loc[("flow", "other"), "median"] == pytest.approx(0.01)
    assert frame.loc[("area", "other"), "largest"] == pytest.approx(0.02)


def test_box_statistics_need_a_truth_without_zeros(small_cases):
    flow = small_cases.flow.copy()
    flow[3, 2, 1] = 0
    cases = type(small_cases)(
        flow,
        small_cases.area,
        small_cases.pressure,
        small_cases.area_undeformed,
        small_cases.time,
        small_cases.z,
        check=False,
    )
    with pytest.raises(InputError, match="flow is 0 somewhere"):
        box_statistics({"mine": {"flow": flow}}, cases)


def test_a_variable_that_the_cases_lack(sheared_cases, small_cases):
    predicted = {"flow": small_cases.flow, "wall_shear_stress": sheared_cases.wall_shear_stress}
    assert list(error_matrix(predicted, sheared_cases)) == list(predicted)
    assert list(error_matrix(predicted, small_cases)) == ["flow"]
    one = {name: values[:1] for name, values in predicted.items()}
    with pytest.raises(InputError, match="no wall_shear_stress: leave it out of the prediction"):
        pointwise_errors(one, small_cases.select(0))
