"""Indices of predictions: the same code as for data, and intervals over joint samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import t

from pcnde_bridge import InputError
from pcnde_bridge.model.prediction import Prediction


@pytest.fixture
def prediction(small_cases) -> Prediction:
    """A prediction that equals the data, with samples that share one factor along the vessel."""
    rng = np.random.default_rng(0)
    names = ("flow", "area", "pressure")
    shared = 1 + 0.05 * rng.standard_normal((8, 1, 1, 1))
    away = 1 + 0.001 * rng.standard_normal((8, *small_cases.flow.shape))
    samples = {name: getattr(small_cases, name) * shared * away for name in names}
    axes = small_cases.area_undeformed, small_cases.time, small_cases.z, small_cases.period
    values = (getattr(small_cases, name) for name in names)
    return Prediction(*values, *axes, small_cases.labels, samples=samples)


def test_prediction_and_data_are_computed_by_the_same_code(prediction, small_cases):
    for name in ("pressure_drop", "ffr", "pressure_ratio", "velocity", "reynolds"):
        assert np.array_equal(getattr(prediction, name)(), getattr(small_cases, name)())
    expected = small_cases.indices()
    assert prediction.indices()[list(expected.columns)].equals(expected)
    alone = dataclasses.replace(prediction, samples=None).indices()
    assert alone.equals(expected)


def test_interval_of_a_difference_is_that_of_the_differences(prediction):
    table = prediction.indices(1.0, 3.0, level=0.8)
    at = [int(np.abs(prediction.z - z).argmin()) for z in (1.0, 3.0)]
    p = prediction.samples["pressure"]
    differences = (p[..., at[0]] - p[..., at[1]]).mean(axis=-1) / 1333.22
    quantile = t.ppf(0.9, len(p) - 1)
    width = quantile * differences.std(axis=0, ddof=1)
    drop = table["mean_drop_mmHg"]
    np.testing.assert_allclose(table["mean_drop_mmHg_low"], drop - width, rtol=1e-12)
    np.testing.assert_allclose(table["mean_drop_mmHg_high"], drop + width, rtol=1e-12)
    # The shared factor cancels in FFR, but not in the pressure at either point.
    ffr = p[..., at[1]].mean(axis=-1) / p[..., at[0]].mean(axis=-1)
    spread = quantile * ffr.std(axis=0, ddof=1)
    found = (table["ffr_high"] - table["ffr_low"]) / 2
    np.testing.assert_allclose(found, spread, rtol=1e-6)
    assert (spread < 0.01).all()


def test_each_sample(prediction):
    samples = list(prediction.each_sample())
    assert len(samples) == 8
    assert np.array_equal(samples[3].pressure, prediction.samples["pressure"][3])
    assert samples[3].samples is None
    with pytest.raises(InputError, match="has no samples"):
        samples[3].each_sample()


def test_without_pressure(prediction):
    flow_only = dataclasses.replace(
        prediction,
        pressure=None,
        samples={name: prediction.samples[name] for name in ("flow", "area")},
    )
    with pytest.raises(InputError, match="no pressure stages"):
        flow_only.ffr()
    table = flow_only.indices()
    assert "ffr" not in table
    assert {"peak_reynolds", "peak_reynolds_low", "peak_reynolds_high"} <= set(table)


def test_blockage_is_computed_where_it_is_no_label(prediction):
    unlabeled = dataclasses.replace(prediction, labels=prediction.labels[["geometry"]])
    s_u = prediction.area_undeformed
    expected = 1 - s_u.min(axis=1) / s_u[:, 0]
    np.testing.assert_allclose(unlabeled.indices()["blockage"], expected)


@pytest.mark.parametrize("level", [0, 1, "0.9"])
def test_level(prediction, level):
    with pytest.raises(InputError, match="level must lie between 0 and 1"):
        prediction.indices(level=level)


def test_a_variable_without_samples_has_no_interval(prediction, sheared_cases):
    prediction = dataclasses.replace(prediction, wall_shear_stress=sheared_cases.wall_shear_stress)
    assert next(prediction.each_sample()).wall_shear_stress is None
    assert list(prediction.interval()) == ["flow", "area", "pressure"]
    table = prediction.indices()
    assert np.array_equal(table["peak_wss"], sheared_cases.indices()["peak_wss"])
    assert "peak_tawss_low" not in table
    scale = np.linspace(0.9, 1.1, 8)[:, None, None, None]
    stress = {"wall_shear_stress": sheared_cases.wall_shear_stress * scale}
    prediction = dataclasses.replace(prediction, samples={**prediction.samples, **stress})
    assert (prediction.indices()["peak_tawss_low"] < table["peak_tawss"]).all()
    assert prediction.to_cases() == sheared_cases
    found = prediction.to_xarray()
    assert found["wall_shear_stress"].attrs["units"] == "dyn/cm^2"
    assert found["wall_shear_stress_samples"].dims == ("sample", "case", "time", "z")


def test_intervals_of_few_samples_are_those_of_student(prediction):
    few = {name: values[:3] for name, values in prediction.samples.items()}
    found = dataclasses.replace(prediction, samples=few).interval(0.9)
    width = t.ppf(0.95, 2) * few["area"].std(axis=0, ddof=1)
    np.testing.assert_allclose(found["area"][1] - prediction.area, width, rtol=1e-9)
