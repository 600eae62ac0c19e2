"""Reader of the authors' published weights."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from pcnde_bridge import (
    PAPER,
    PCNDE,
    PUBLISHED_CODE,
    InputError,
)
from pcnde_bridge.engines.parameters import STAGES
from pcnde_bridge.errors import DataNotFoundError, FileError

FILES = {
    "ptrained_BFGS_Q.jld2": 2724,
    "ptrained_BFGS_S.jld2": 202,
    "pFourier_trained.jld2": 202,
}


@pytest.fixture
def weights(tmp_path):
    folder = tmp_path / "trained_weights"
    folder.mkdir()
    for seed, (name, size) in enumerate(FILES.items()):
        with h5py.File(folder / name, "w") as file:
            file["p"] = np.random.default_rng(seed).normal(size=size).astype(np.float32)
    return folder


def test_published_weights_are_read(weights, toy_engine, tmp_path):
    for folder in (weights, str(weights), tmp_path):
        model = PCNDE.from_published_weights(folder, engine=toy_engine)
        for seed, stage in enumerate(STAGES[:3]):
            vector = getattr(model.parameters, stage)
            expected = np.random.default_rng(seed).normal(size=vector.size)
            assert np.array_equal(vector, expected.astype(np.float32).astype(np.float64))
        assert not model.has_pressure
        assert (model.grid.time.size, model.grid.z.size) == (100, 101)
        assert (model.grid.time[-1], model.grid.z[-1]) == pytest.approx((0.99, 4.0))
        assert model.grid.period == 1.0
        assert model.config == PUBLISHED_CODE.replace(flow={"rtol": 1e-6, "atol": 1e-9})
        assert model.provenance == {"source": "published weights"}
        assert model.history.empty
    model.save(tmp_path / "m")
    assert PCNDE.load(tmp_path / "m", engine=toy_engine).parameters == model.parameters


def test_published_weights_with_other_settings(weights, toy_engine):
    model = PCNDE.from_published_weights(weights, PAPER, engine=toy_engine)
    assert model.config == PAPER
    with pytest.raises(InputError, match="flow parameters have 2724 numbers"):
        PCNDE.from_published_weights(
            weights, PAPER.replace(flow={"hidden": (3,)}), engine=toy_engine
        )


@pytest.mark.parametrize("name", FILES)
def test_published_weights_that_are_missing_or_damaged(weights, toy_engine, name):
    path = weights / name
    whole = path.read_bytes()

    def load():
        return PCNDE.from_published_weights(weights, engine=toy_engine)

    path.unlink()
    with pytest.raises(DataNotFoundError, match=rf"no file .*trained_weights.*{name}"):
        load()
    for content in (b"", b"hello", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(FileError, match=name):
            load()
    for dataset, value in (
        ("q", np.zeros(FILES[name])),
        ("p", np.zeros(FILES[name] - 1)),
        ("p", np.zeros((FILES[name], 1))),
        ("p", np.full(FILES[name], np.nan)),
        ("p/q", np.zeros(FILES[name])),
    ):
        with h5py.File(path, "w") as file:
            file[dataset] = value
        with pytest.raises(FileError, match=name):
            load()
