"""The demo with few cases, and ``pcnde demo``."""

from __future__ import annotations

import json
import re
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import (
    PCNDE,
    Cases,
    FileError,
    InputError,
)
from pcnde_bridge.cli import demo as module
from pcnde_bridge.cli import main as cli
from pcnde_bridge.cli.demo import (
    CHECKPOINT,
    FILES,
    MARK,
    run_demo,
)
from pcnde_bridge.evaluation.baselines import Unchanged
from pcnde_bridge.hemodynamics import Tube1D, coronary, synthetic
from pcnde_bridge.hemodynamics.synthetic import base_waveform
from pcnde_bridge.model.metrics import pooled_errors
from pcnde_bridge.plots import loss_history


@pytest.fixture(autouse=True)
def unpainted(request, monkeypatch):
    """Draw no figures, which would take longest; one test draws them."""
    if request.node.name != "test_everything_is_there":
        blank = SimpleNamespace(savefig=lambda path, **_: path.write_bytes(b"\x89PNG"))
        for name in ("time_and_space", "loss_history"):
            monkeypatch.setattr(module, name, lambda *_, **__: blank)


@pytest.fixture(autouse=True)
def small_demo(monkeypatch, small_cases, toy_engine, toy_config):
    """Few cases, and nothing to compile."""
    monkeypatch.setattr(module, "synthetic", lambda *_, **__: small_cases)
    monkeypatch.setattr(module, "select_engine", lambda name: toy_engine)
    monkeypatch.setattr(module, "PHYSICS", toy_config)


@pytest.fixture
def demo(tmp_path):
    """Run the demo."""
    return lambda out=tmp_path / "demo", **changes: run_demo(out, **changes)


def test_everything_is_there(demo, tmp_path, small_cases):
    result = demo()
    folder = tmp_path / "demo"
    assert sorted(path.name for path in folder.iterdir()) == sorted((*FILES, MARK))
    assert Cases.load(folder / "cases.npz") == small_cases
    train, test = small_cases.split(waveform=3)
    again = small_cases.split(folder / "split.json")
    assert (again.train, again.test) == (train, test)

    assert result.errors["PCNDE"]["test"] == pooled_errors(
        result.model.predict(test).variables(), test
    )
    unchanged = Unchanged().fit(train).predict(train)
    assert result.errors["no change"]["train"] == pooled_errors(unchanged, train)

    errors = pd.read_csv(folder / "errors.csv")
    assert len(errors) == len(small_cases) + 2  # and one pooled row for each set
    pooled = errors[(errors["set"] == "test") & (errors["geometry"] == "pooled")]
    assert pooled["flow"].item() == pytest.approx(result.errors["PCNDE"]["test"]["flow"])
    assert len(pd.read_csv(folder / "history.csv")) == len(result.model.history)

    frame = pd.read_csv(folder / "prediction.csv.gz")
    assert len(frame) == test.flow.size
    predicted = result.model.predict(test)
    np.testing.assert_allclose(frame["pressure"], predicted.pressure.ravel(), rtol=1e-6)
    for name in ("prediction.png", "history.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    mark = json.loads((folder / MARK).read_text())
    assert mark["finished"] is True
    assert mark["errors"] == result.errors


def test_its_files_go_into_the_other_commands(demo, tmp_path, small_cases, toy_engine, monkeypatch):
    result = demo()
    folder = tmp_path / "demo"
    for part in ("pcnde", "predictor"):
        name = f"pcnde_bridge.model.{part}.select_engine"
        monkeypatch.setattr(name, lambda name, **_: toy_engine)
    arguments = ["--inflow", folder / "inflow.csv", "--area", folder / "area.csv"]
    out = tmp_path / "mine.npz"
    argv = ["pcnde", "predict", folder / "model.npz", *arguments, "--out", out]
    monkeypatch.setattr(sys, "argv", [str(a) for a in argv])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    narrowest = small_cases.select(geometry=3, waveform=3)
    np.testing.assert_allclose(
        Cases.load(out).flow, result.model.predict(narrowest).flow, rtol=1e-9
    )


def test_same_command_again_replaces_its_own_files(demo, tmp_path):
    first = demo()
    (tmp_path / "demo" / "errors.csv").write_text("spoilt")
    (tmp_path / "demo" / "notes.txt").write_text("mine")
    second = demo()
    assert second.errors == first.errors
    assert len(pd.read_csv(tmp_path / "demo" / "errors.csv")) > 2
    assert (tmp_path / "demo" / "notes.txt").read_text() == "mine"


def test_interrupted_then_continued(demo, tmp_path, monkeypatch):
    whole = demo(tmp_path / "whole")
    fit = PCNDE.fit

    def interrupted(cases, config, **options):
        seen = []

        def stop(iteration):
            seen.append(iteration)
            if len(seen) == 10:
                raise KeyboardInterrupt

        return fit(cases, config, **{**options, "progress": stop})

    monkeypatch.setattr(module.PCNDE, "fit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        demo()
    assert (tmp_path / "demo" / CHECKPOINT).exists()
    assert not (tmp_path / "demo" / "model.npz").exists()
    monkeypatch.setattr(module.PCNDE, "fit", fit)
    continued = demo()
    assert continued.errors == whole.errors
    assert not (tmp_path / "demo" / CHECKPOINT).exists()


def test_another_demo_is_not_overwritten(demo, tmp_path):
    demo()
    before = (tmp_path / "demo" / "model.npz").read_bytes()
    with pytest.raises(InputError, match=r"another demo \(another seed\)"):
        demo(seed=1)
    assert (tmp_path / "demo" / "model.npz").read_bytes() == before


def test_unusable_folders(demo, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file"):
        demo(tmp_path / "file")
    with pytest.raises(FileError, match="Cannot create the folder"):
        demo(tmp_path / "file" / "below")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "model.npz").write_text("mine")
    with pytest.raises(FileError, match=r"model\.npz, which no demo has written"):
        demo(tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["model.npz"]
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / MARK).write_text("not JSON")
    with pytest.raises(FileError, match="is not a demo's"):
        demo(tmp_path / "odd")


def test_loss_history(demo):
    figure = loss_history(demo().model.history)
    shown = [axis for axis in figure.axes if axis.axison]
    assert [axis.get_title() for axis in shown] == [
        "flow",
        "intermediate area",
        "Fourier area",
        "temporal pressure",
        "spatial pressure",
    ]
    assert shown[0].get_ylabel() == "loss (mL²/s²)"
    assert all(axis.get_xlabel() == "iteration" for axis in shown)


def test_no_history_no_figure():
    with pytest.raises(InputError, match="no history"):
        loss_history(pd.DataFrame({"stage": []}))


def test_the_story_has_the_result_of_the_narrowest_vessel(
    demo, monkeypatch, physics_cases, physics_model
):
    monkeypatch.setattr(module, "synthetic", lambda *_, **__: physics_cases)
    monkeypatch.setattr(module, "PHYSICS", physics_model.config)
    monkeypatch.setattr(module, "select_engine", lambda _: physics_model.engine)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        story = demo().story
    expected = physics_cases.select(geometry=4, waveform=3)
    blockage = expected.labels["blockage"][0]
    assert "trained on 12 simulated vessels" in story
    assert f"The narrowest is {blockage:.0%} blocked" in story
    assert f"simulated {expected.ffr()[0]:.3f}; below 0.80" in story
    assert re.search(r"FFR   \d\.\d{3} \(90 % interval \d\.\d{3} to \d\.\d{3}\)", story)


def test_the_demos_vessels_include_a_severe_stenosis():
    base = base_waveform(0, 4.0)
    assert base.mean == 4 * coronary().mean
    assert np.allclose(base.samples(50), 4 * coronary().samples(50))
    assert np.allclose(base_waveform(3, 4.0).samples(50), 4 * base_waveform(3).samples(50))
    cases = synthetic(
        *(2, 1),
        hyperemia=4.0,
        n_points=41,
        tube=Tube1D(n_times=20, steps=200, cycles=2),
        cache=False,
        progress=False,
    )
    mild, severe = cases.ffr()
    assert severe < 0.8 < mild
    rest = synthetic(
        *(2, 1),
        n_points=41,
        tube=Tube1D(n_times=20, steps=200, cycles=2),
        cache=False,
        progress=False,
    )
    ratio = cases.pressure[0, :, -1].mean() / rest.pressure[0, :, -1].mean()
    assert ratio == pytest.approx(1.0, rel=1e-3)


# ---- pcnde demo ------------------------------------------------------------------


@pytest.fixture
def run(monkeypatch, run_pcnde):
    monkeypatch.setenv("COLUMNS", "200")
    return run_pcnde


def test_command(run, tmp_path):
    folder = tmp_path / "demo"
    code, out, err = run("demo", "--out", folder)
    assert code == 0
    mark = json.loads((folder / MARK).read_text())
    for part in ("train", "test"):
        for method in ("PCNDE", "no change"):
            assert f"{part}, {method}" in out
            assert f"{mark['errors'][method][part]['flow']:.4f}" in out
    assert f"pcnde predict {folder / 'model.npz'}" in out
    assert "Traceback" not in err


def test_command_refuses(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run("demo", "--out", tmp_path / "file")
    assert code == 2
    assert "is a file" in err
    assert run("demo", "--out", tmp_path / "demo")[0] == 0
    code, _, err = run("demo", "--out", tmp_path / "demo", "--seed", 1)
    assert code == 2
    assert "another seed" in err


def test_command_interrupted(run, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(module.PCNDE, "fit", interrupt)
    code, _, err = run("demo", "--out", tmp_path / "demo")
    assert code == 130
    assert "run the same command again" in err
