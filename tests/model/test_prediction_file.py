"""Predictions of many cases in an HDF5 file."""

from __future__ import annotations

import errno
import os
import warnings

import h5py
import numpy as np
import pytest

from pcnde_bridge import load_cases
from pcnde_bridge.errors import FileError, InputError, PCNDEWarning, SolveError, TaskError
from pcnde_bridge.hemodynamics import Waveform, Windkessel
from pcnde_bridge.model import prediction_file as module
from pcnde_bridge.model.prediction_file import predict_to_file


@pytest.fixture
def inputs(physics_cases):
    return physics_cases.inflow[:10], physics_cases.area_undeformed[:10]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "many.h5"


def test_the_file_is_the_data_set_of_the_prediction(physics_model, inputs, path):
    failed = predict_to_file(physics_model, path, *inputs, batch=4, progress=False)
    assert failed.size == 0
    found, expected = load_cases(path), physics_model.predict(*inputs)
    assert found.variables().keys() == expected.variables().keys()
    for name, values in expected.variables().items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-12, err_msg=name)
    assert found.labels["geometry"].tolist() == [*range(1, 11)]
    indices = expected.indices()
    with h5py.File(path) as file:
        for name in ("ffr", "proximal", "peak_wss"):
            np.testing.assert_allclose(file["indices"][name], indices[name], rtol=1e-12)
        assert np.array_equal(file["indices/novelty"], expected.novelty)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_indices_alone_and_one_vessel_for_all(physics_model, inputs, path):
    inflow, (area, *_) = inputs
    labels = {"geometry": np.ones(10, int), "waveform": np.arange(10)}
    options = {"fields": False, "labels": labels, "batch": 4, "progress": False}
    predict_to_file(physics_model, path, inflow, area, **options)
    with h5py.File(path) as file:
        assert "flow" not in file
        assert file["labels/waveform"][:].tolist() == [*range(10)]
        expected = physics_model.predict(inflow, area).indices()["mean_drop_mmHg"]
        np.testing.assert_allclose(file["indices/mean_drop_mmHg"], expected, rtol=1e-12)


def test_an_interrupted_run_is_continued(physics_model, inputs, path, monkeypatch):
    predict, calls = module._predict, []

    def fails_once(batch):
        calls.append(batch.start)
        if batch.start == 6 and len(calls) < 4:
            raise InputError("no")
        return predict(batch)

    monkeypatch.setattr(module, "_predict", fails_once)
    with pytest.raises(TaskError, match=r"cases 6 to 9: no"):
        predict_to_file(physics_model, path, *inputs, batch=4, progress=False)
    assert calls == [0, 3, 6]
    assert not path.exists()
    with pytest.raises(InputError, match="result of other tasks"):
        predict_to_file(physics_model, path, *inputs, batch=4, fields=False, progress=False)
    assert len([*path.with_name("many.h5.unfinished").glob("*.h5")]) == 1
    predict_to_file(physics_model, path, *inputs, batch=4, progress=False)
    assert calls == [0, 3, 6, 6]
    expected = physics_model.predict(*inputs).flow
    np.testing.assert_allclose(load_cases(path).flow, expected, rtol=1e-12)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_a_run_without_results_can_be_replaced(physics_model, inputs, path, monkeypatch):
    def fails(_):
        raise InputError("no")

    with monkeypatch.context() as patched, pytest.raises(TaskError, match="no"):
        patched.setattr(module, "_predict", fails)
        predict_to_file(physics_model, path, *inputs, progress=False)
    predict_to_file(physics_model, path, *inputs, fields=False, progress=False)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="no posix_fallocate")
def test_the_space_of_the_file_is_reserved(physics_model, inputs, path, monkeypatch):
    """Without space, writing to the memory map would end the process."""

    def full(*_):
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(FileError, match="the disk is full"):
        predict_to_file(physics_model, path, *inputs, progress=False)


def test_a_file_for_another_outlet_is_not_continued(physics_model, inputs, path, monkeypatch):
    """Outlets whose representations are the same."""

    predict = module._predict

    def fails(batch):
        if batch.start > 0:
            raise InputError("no")
        return predict(batch)

    outlets = [Windkessel(9e4, distal_pressure=Waveform(1e4, (p,), (0.0,))) for p in (5e3, 6e3)]
    assert repr(outlets[0]) == repr(outlets[1])
    options = {"batch": 4, "progress": False}
    with monkeypatch.context() as patched, pytest.raises(TaskError, match="no"):
        patched.setattr(module, "_predict", fails)
        predict_to_file(physics_model, path, *inputs, outlet=outlets[0], **options)
    with pytest.raises(InputError, match="result of other tasks"):
        predict_to_file(physics_model, path, *inputs, outlet=outlets[1], **options)
    predict_to_file(physics_model, path, *inputs, outlet=outlets[0], **options)
    expected = physics_model.predict(*inputs, outlet=outlets[0]).pressure
    np.testing.assert_allclose(load_cases(path).pressure, expected, rtol=1e-12)


def test_cases_that_fail_are_nan_and_named(physics_model, inputs, path, monkeypatch):
    whole = type(physics_model)._solve

    def some_fail(model, given):
        if (bad := np.flatnonzero(given.inflow[:, 0] == inputs[0][7, 0])).size:
            raise SolveError("no", bad)
        return whole(model, given)

    monkeypatch.setattr(type(physics_model), "_solve", some_fail)
    same = np.flatnonzero(inputs[0][:, 0] == inputs[0][7, 0])
    with pytest.warns(PCNDEWarning, match=f"{len(same)} of 10 cases could not be predicted"):
        failed = predict_to_file(physics_model, path, *inputs, progress=False)
    assert np.array_equal(failed, same)
    with h5py.File(path) as file:
        assert np.array_equal(np.flatnonzero(np.isnan(file["pressure"][:, 3, 2])), same)


def test_cases_outside_the_training_data_are_counted(physics_model, inputs, path):
    inflow = inputs[0] * np.where(np.arange(10) < 3, 3.0, 1.0)[:, None]
    with pytest.warns(PCNDEWarning, match="3 of 10 cases lie outside the training data"):
        predict_to_file(physics_model, path, inflow, inputs[1], fields=False, progress=False)


def test_unusable_arguments(physics_model, inputs, path):
    with pytest.raises(FileError, match=r"must end in \.h5 or \.hdf5"):
        predict_to_file(physics_model, path.with_suffix(".csv"), *inputs)
    with pytest.raises(InputError, match="inflow has 10 cases and area_undeformed 3"):
        predict_to_file(physics_model, path, inputs[0], inputs[1][:3])
    with pytest.raises(InputError, match=r"inflow must have the shape .* got \(1, 10, "):
        predict_to_file(physics_model, path, inputs[0][None], inputs[1])
    with pytest.raises(InputError, match=r"inflow must have the shape .* got \(0, "):
        predict_to_file(physics_model, path, inputs[0][:0], inputs[1][:0])
    with pytest.raises(InputError, match=r"area_undeformed\[0, 0\] is .* positive"):
        predict_to_file(physics_model, path, inputs[0], -inputs[1])
    with pytest.raises(InputError, match="no option 'samples' here"):
        predict_to_file(physics_model, path, *inputs, samples=8)
    with pytest.raises(InputError, match="model must be a fitted model, got str"):
        predict_to_file("model.npz", path, *inputs)
    path.mkdir()
    with pytest.raises(FileError, match="it is a folder"):
        predict_to_file(physics_model, path, *inputs)
    path.rmdir()
    with warnings.catch_warnings(), pytest.raises(InputError, match="inflow"):
        predict_to_file(physics_model, path, inputs[0] * np.nan, inputs[1])
