"""Benchmarks of models and baselines, and ``pcnde bench``."""

from __future__ import annotations

import json
import warnings

import pytest
from helpers import ToyEngine, interrupt_at

from pcnde_bridge import (
    PCNDE,
    OutsideTrainingWarning,
)
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.evaluation.baselines import (
    ResponseSurface,
    Unchanged,
    standard_baselines,
)
from pcnde_bridge.evaluation.benchmark import (
    Row,
    bench_baseline,
    bench_model,
    write_rows,
)
from pcnde_bridge.model.describe import describe
from pcnde_bridge.model.metrics import pooled_errors


@pytest.fixture
def sets(small_cases, small_split):
    return small_cases.split(small_split)._asdict()


class Perfect:
    """Method that returns the truth and counts its calls."""

    def __init__(self):
        self.asked = []

    def fit(self, train):
        self.asked.append(("fit", len(train)))
        return self

    def predict(self, cases):
        self.asked.append(("predict", len(cases)))
        return {name: getattr(cases, name) for name in VARIABLES}


def test_bench_of_a_baseline(sets):
    baseline = Perfect()
    row = bench_baseline("perfect", baseline, sets)
    assert baseline.asked[:3] == [("fit", 11), ("predict", 11), ("predict", 1)]
    columns = [*VARIABLES, "pressure_drop", "one_minus_ffr"]
    assert row.errors == {name: dict.fromkeys(columns, 0.0) for name in ("train", "test")}
    assert row.fit_seconds >= 0
    assert row.predict_ms_per_case >= 0
    assert row.reason is None


def test_bench_with_methods_that_are_not_applicable(sets):
    row = bench_baseline("polynomial", ResponseSurface(), sets)
    assert row.errors == {}
    assert row.fit_seconds is row.predict_ms_per_case is None
    assert "11 training cases" in row.reason


def test_bench_of_a_model(sets, small_config, toy_engine):
    model = PCNDE.fit(sets["train"], small_config, engine=toy_engine, progress=False)
    row = bench_model(model, sets)
    assert row.name == "PCNDE (toy)"
    for name, cases in sets.items():
        assert row.errors[name] == pooled_errors(model.predict(cases).variables(), cases)
    assert row.fit_seconds == model.provenance["seconds"]


def test_bench_does_not_warn_of_extrapolation(small_cases, small_config, toy_engine):
    weak, strong = small_cases.select(waveform=[0, 1]), small_cases.select(waveform=[3])
    model = PCNDE.fit(weak, small_config, engine=toy_engine, progress=False)
    with pytest.warns(OutsideTrainingWarning):
        model.predict(strong)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bench_model(model, {"test": strong})


def test_rows_as_json(tmp_path):
    rows = [Row("a", {"test": {"flow": 0.5}}, 1.0, 2.0), Row("b", reason="too few")]
    write_rows(tmp_path / "rows.json", rows, data="mine")
    content = json.loads((tmp_path / "rows.json").read_text())
    assert content["data"] == "mine"
    assert content["rows"] == [
        {
            "name": "a",
            "errors": {"test": {"flow": 0.5}},
            "fit_seconds": 1.0,
            "predict_ms_per_case": 2.0,
            "reason": None,
        },
        {
            "name": "b",
            "errors": {},
            "fit_seconds": None,
            "predict_ms_per_case": None,
            "reason": "too few",
        },
    ]


@pytest.fixture
def run(monkeypatch, toy_engine, run_pcnde):
    monkeypatch.setenv("COLUMNS", "200")
    for part in ("pcnde", "predictor"):
        name = f"pcnde_bridge.model.{part}.select_engine"
        monkeypatch.setattr(name, lambda name, **_: toy_engine)

    return run_pcnde


@pytest.fixture
def folder(tmp_path, small_cases, small_split, small_config):
    small_cases.save(tmp_path / "cases.npz")
    (tmp_path / "split.json").write_text(json.dumps(small_split))
    (tmp_path / "config.json").write_text(small_config.to_json())
    return tmp_path


def test_bench_side_by_side(run, folder, sets):
    options = ("--split", folder / "split.json", "--config", folder / "config.json")
    written = folder / "bench.json"
    code, out, _ = run("bench", folder / "cases.npz", *options, "--json", written)
    assert code == 0
    content = json.loads(written.read_text())
    assert content["cases"] == {"train": 11, "test": 1}
    assert content["split"] == str(folder / "split.json")
    rows = {row["name"]: row for row in content["rows"]}
    assert list(rows) == ["PCNDE (toy)", *standard_baselines()]
    for name, row in rows.items():
        assert name in out
        if row["reason"] is None:
            assert set(row["errors"]) == {"train", "test"}
            assert f"{row['errors']['test']['pressure']:.4f}" in out
            assert row["predict_ms_per_case"] > 0
    unchanged = Unchanged().fit(sets["train"]).predict(sets["test"])
    assert rows["no change"]["errors"]["test"] == pooled_errors(unchanged, sets["test"])
    # Eleven cases are too few for sixteen terms; the other methods are computed.
    assert "11 training cases" in out


def test_bench_of_a_saved_model(run, folder, sets, small_config, toy_engine, monkeypatch):
    model = PCNDE.fit(sets["train"], small_config, engine=toy_engine, progress=False)
    model.save(folder / "model.npz")
    monkeypatch.setattr("pcnde_bridge.evaluation.baselines.standard_baselines", dict)
    written = folder / "bench.json"
    options = ("--model", folder / "model.npz", "--split", "none", "--json", written)
    code, out, _ = run("bench", folder / "cases.npz", *options)
    assert code == 0
    content = json.loads(written.read_text())
    assert content["model"] == str(folder / "model.npz")
    assert content["rows"][0]["fit_seconds"] == model.provenance["seconds"]
    assert list(content["rows"][0]["errors"]) == ["train"]
    assert "train / test" not in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("absent",), "neither a file or folder"),
        (("cases.npz", "--model", "absent.npz"), "absent.npz"),
        (("cases.npz", "--preset", "slow"), "Unknown preset"),
        (("cases.npz", "--model", "m", "--preset", "fast"), "leave out --model, or --preset"),
        (("cases.npz", "--model", "m", "--config", "c.json"), "leave out --model, or --config"),
        (("cases.npz", "--model", "m", "--seed", "1"), "leave out --model, or --seed"),
        (("cases.npz", "--model", "m", "--checkpoint", "c"), "leave out --model, or --checkpoint"),
        (("cases.npz", "--json", "absent/bench.json"), "create it first"),
    ],
)
def test_bench_refuses(run, folder, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    code, out, err = run("bench", *arguments)
    assert code == 2
    assert message in err
    assert out == ""


@pytest.fixture(scope="module")
def engine():
    return ToyEngine()


@pytest.fixture(scope="module")
def config(toy_config):
    return toy_config.replace(flow={"epochs": 2, "couple_every": 1})


def test_bench_continues_its_training(commands, engine, tmp_path, monkeypatch):
    from pcnde_bridge.evaluation import baselines

    monkeypatch.setattr(baselines, "standard_baselines", dict)
    interrupt_at(engine, monkeypatch, 4)
    code, _, err = commands("bench")
    assert code == 130
    (state,) = tmp_path.glob("bench-*.checkpoint")
    assert state.name in err
    assert describe(state)["finished"] > 0
    code, printed, err = commands("bench", "--json", "rows.json")
    assert code == 0
    assert f"Continuing from {state.name}" in err
    assert "PCNDE (toy)" in printed
    assert list(tmp_path.glob("bench-*")) == []
