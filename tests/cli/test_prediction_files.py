"""Files that ``pcnde predict`` writes, and files that it rejects before computing."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import PCNDE
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.io import read_simvascular


@pytest.fixture
def inputs(small_cases, tmp_path):
    """Arguments of ``pcnde predict`` for two cases."""
    for name, axis, values in (
        ("inflow.csv", "time", small_cases.inflow[:2]),
        ("area.csv", "z", small_cases.area_undeformed[:2]),
    ):
        table = {axis: getattr(small_cases, axis), "a": values[0], "b": values[1]}
        pd.DataFrame(table).to_csv(tmp_path / name, index=False)
    stated = ["--units", "area=cm^2"]  # as the model below does not know its training data
    return ["--inflow", tmp_path / "inflow.csv", "--area", tmp_path / "area.csv", *stated]


@pytest.fixture
def model(small_cases, toy_config, toy_engine, monkeypatch):
    """Model that ``pcnde`` finds under any name, and that needs no compiling."""
    parameters = initial_parameters(toy_config, 20, 21, 0)
    grid = Grid(small_cases.time, small_cases.z, 1.0)
    made = PCNDE(toy_config, parameters, grid, toy_engine)
    monkeypatch.setattr(PCNDE, "load", lambda *_, **__: made)
    return made


def test_predict_writes_centerlines(small_cases, model, inputs, tmp_path, run_pcnde):
    code, printed, _ = run_pcnde("predict", "model.npz", *inputs, "--out", tmp_path / "p.vtp")
    assert code == 0
    assert "Vessels: healthy diameter 3.99 mm, blockage 40%.\nSaved 2 cases" in printed
    found = read_simvascular(sorted(tmp_path.glob("p_*.vtp")), units="cgs")
    expected = model.predict(small_cases.select(slice(2)))
    assert np.array_equal(found.flow, expected.flow)


@pytest.mark.parametrize("out", ["p.csv", "p.npz"])
def test_predict_writes_indices(small_cases, model, inputs, tmp_path, run_pcnde, out):
    table = tmp_path / "indices.csv"
    paths = "--out", tmp_path / out, "--indices", table
    code, printed, _ = run_pcnde("predict", "model.npz", *inputs, *paths)
    assert code == 0
    assert f"indices in {table}" in printed
    found = pd.read_csv(table)
    prediction = model.predict(small_cases.select(slice(2)))
    expected = prediction.indices()
    assert list(found["name"]) == ["a", "b"]
    for name in ("proximal", "distal", "mean_drop_mmHg", "ffr", "resistance"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-12)
    code, _, err = run_pcnde(
        "predict", "model.npz", *inputs, "--out", tmp_path / "q.csv", "--indices",
        tmp_path / "q.csv",
    )  # fmt: skip
    assert code == 2
    assert "is named twice" in err


def test_predict_rejects_unwritable_files_before_computing(
    model, inputs, tmp_path, run_pcnde, monkeypatch
):
    def compute(*_, **__):
        raise AssertionError("a prediction was computed")

    monkeypatch.setattr(PCNDE, "predict", compute)
    model.parameters = model.parameters.without_pressure()
    before = sorted(tmp_path.iterdir())
    for out, message in (
        ("p.npz", "no pressure stages"),
        ("p.h5", "no pressure stages"),
        ("nowhere/p.csv", "give a file in an existing folder"),
        ("p.txt", "must end in .csv"),
    ):
        code, printed, err = run_pcnde("predict", "model", *inputs, "--out", tmp_path / out)
        assert (code, printed) == (2, "")
        assert message in err
    code, _, err = run_pcnde(
        "predict", "model", *inputs, "--samples", 3, "--out", tmp_path / "p.vtp"
    )
    assert code == 2
    assert "written to a .csv only" in err
    assert sorted(tmp_path.iterdir()) == before
