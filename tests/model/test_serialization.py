"""Model files: written and read back, damaged, foreign and newer ones."""

from __future__ import annotations

import h5py
import numpy as np
import pandas as pd
import pytest
from helpers import same_bits

from pcnde_bridge import PCNDE, Cases, InputError, load_model
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.errors import FileError


@pytest.fixture(scope="module")
def prediction(small_model, small_cases):
    return small_model.predict(small_cases)


@pytest.fixture(scope="module")
def model_file(small_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "small.pcnde"
    small_model.save(path)
    return path


def test_a_loaded_model_is_the_same(small_model, small_cases, prediction, model_file):
    loaded = PCNDE.load(model_file, engine="jax")
    assert loaded.parameters == small_model.parameters
    assert loaded.config == small_model.config
    assert loaded.provenance == small_model.provenance
    pd.testing.assert_frame_equal(loaded.history, small_model.history, check_exact=True)
    assert np.array_equal(loaded.grid.time, small_model.grid.time)
    assert np.array_equal(loaded.grid.z, small_model.grid.z)
    assert loaded.grid.period == small_model.grid.period
    assert same_bits(loaded.predict(small_cases), prediction)
    assert repr(loaded) == repr(small_model)


def test_saving_again_gives_the_same_content(small_model, model_file, tmp_path):
    PCNDE.load(model_file, engine="jax").save(tmp_path / "again")
    facts, arrays = read_archive(model_file, "pcnde-model", 1, "model")
    facts_again, arrays_again = read_archive(tmp_path / "again", "pcnde-model", 1, "model")
    assert facts == facts_again
    assert set(arrays) == set(arrays_again)
    assert all(np.array_equal(arrays[name], arrays_again[name]) for name in arrays)


def test_saving_where_it_cannot_be(small_model, tmp_path):
    for path in (tmp_path, tmp_path / "nowhere" / "m"):
        with pytest.raises(FileError, match="cannot write"):
            small_model.save(path)


@pytest.mark.parametrize("part", [0.0, 0.01, 0.3, 0.9, 0.999])
def test_a_truncated_model(model_file, tmp_path, part):
    whole = model_file.read_bytes()
    path = tmp_path / "cut.pcnde"
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(FileError, match=r"cut\.pcnde"):
        PCNDE.load(path)


def test_a_damaged_model_is_never_read(model_file, tmp_path):
    """Bytes flipped everywhere: an error of the package, or the same model."""
    whole, path = model_file.read_bytes(), tmp_path / "damaged.pcnde"
    parameters = PCNDE.load(model_file, engine="jax").parameters
    rng = np.random.default_rng(2)
    for position in rng.integers(0, len(whole), 150):
        damaged = bytearray(whole)
        damaged[position] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            assert PCNDE.load(path, engine="jax").parameters == parameters
        except FileError as error:
            assert "damaged.pcnde" in str(error)


def test_foreign_and_newer_models(model_file, small_cases, tmp_path):
    small_cases.save(tmp_path / "cases.npz")
    with pytest.raises(FileError, match="not a pcnde_bridge model"):
        PCNDE.load(tmp_path / "cases.npz")
    (tmp_path / "text").write_text("a model\n")
    with pytest.raises(FileError, match="not a pcnde_bridge model"):
        PCNDE.load(tmp_path / "text")
    with pytest.raises(FileError, match="There is no file"):
        PCNDE.load(tmp_path / "nowhere")
    facts, arrays = read_archive(model_file, "pcnde-model", 1, "model")
    facts = {"config": facts["config"], "provenance": facts["provenance"]}
    write_archive(tmp_path / "newer", "pcnde-model", 2, facts, arrays)
    with pytest.raises(FileError, match=r"newer pcnde_bridge .*Upgrade"):
        PCNDE.load(tmp_path / "newer")


def test_models_with_something_missing_or_wrong(model_file, tmp_path):
    facts, arrays = read_archive(model_file, "pcnde-model", 1, "model")
    facts = {"config": facts["config"], "provenance": facts["provenance"]}
    path = tmp_path / "model"
    broken = [({k: v for k, v in facts.items() if k != gone}, arrays) for gone in facts]
    needed = [name for name in arrays if name != "history_outcomes"]  # older files have none
    broken += [(facts, {k: v for k, v in arrays.items() if k != gone}) for gone in needed]
    broken += [(facts, {**arrays, name: arrays[name][:-1]}) for name in ("flow", "z", "time")]
    broken += [
        ({**facts, "config": {"flow": {"epochs": -1}}}, arrays),
        ({**facts, "config": {"later": 1}}, arrays),
        ({**facts, "config": None}, arrays),
        ({**facts, "provenance": 3}, arrays),
        (facts, {**arrays, "period": np.ones(2)}),
        (facts, {**arrays, "history": np.ones((2, 5))}),
        (facts, {**arrays, "history": np.full((2, 6), np.inf)}),
        (facts, {**arrays, "flow": np.array(["a"] * arrays["flow"].size)}),
    ]
    for some_facts, some_arrays in broken:
        write_archive(path, "pcnde-model", 1, some_facts, some_arrays)
        with pytest.raises(FileError, match="not a complete model"):
            PCNDE.load(path, engine="jax")


def test_parameters_that_do_not_fit_are_refused(small_model):
    grid = Grid(np.arange(19) / 19, small_model.grid.z, 1.0)
    with pytest.raises(InputError, match="flow parameters have"):
        PCNDE(small_model.config, small_model.parameters, grid, small_model.engine)


def test_a_loaded_models_grid_cannot_be_changed_by_its_predictions(
    small_model, small_cases, tmp_path
):
    small_model.save(tmp_path / "model.npz")
    prediction = PCNDE.load(tmp_path / "model.npz", "jax").predict(small_cases.select([0]))
    for axis in (prediction.time, prediction.z):
        with pytest.raises(ValueError, match="read-only"):
            axis *= 10
    mine = np.arange(3.0)
    grid = Grid(mine, mine, 3.0)
    mine[1] = 7
    assert grid.time[1] == grid.z[1] == 1


def test_a_data_set_and_a_model_in_place_of_each_other(small_cases, small_model, tmp_path):
    for name in ("cases.npz", "cases.h5"):
        small_cases.save(tmp_path / name)
    (tmp_path / "cases.csv").write_text("flow\n1\n")
    small_model.save(tmp_path / "model.npz")
    for load in (PCNDE.load, load_model):
        fit = r"Fit a model first: pcnde fit .* --preset physics --out model.npz"
        for name, what in (
            ("npz", f"but a data set.*{fit}"),
            ("h5", f"it is an HDF5.*{fit}"),
            ("csv", "no .npz file. Pass a model's file"),
        ):
            with pytest.raises(FileError, match=f"not a pcnde_bridge model.*{what}"):
                load(tmp_path / f"cases.{name}")
    with pytest.raises(InputError, match=r"needs a model: load_model\(path\).*got 'model.npz'"):
        PCNDE.predict("model.npz", small_cases)
    with h5py.File(tmp_path / "other.h5", "w"), pytest.raises(FileError, match="--from hdf5"):
        Cases.load(tmp_path / "other.h5")
    with pytest.raises(FileError, match="not a pcnde_bridge data set but a 'pcnde-model' file"):
        Cases.load(tmp_path / "model.npz")
