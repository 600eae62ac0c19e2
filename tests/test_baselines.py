"""The baselines against hand calculation, and ``pcnde bench``."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

from pcnde_bridge import (
    PCNDE,
    Cases,
    InputError,
    OutsideTrainingWarning,
)
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.evaluation.baselines import (
    FEM_WALL,
    ResponseSurface,
    Solver1D,
    Unchanged,
    standard_baselines,
)
from pcnde_bridge.evaluation.benchmark import (
    Row,
    bench_baseline,
    bench_model,
    write_rows,
)
from pcnde_bridge.hemodynamics.outlet import Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.model.metrics import pooled_errors


def polynomial_cases(n_waveforms: int = 5, n_geometries: int = 4) -> Cases:
    """Outputs that are polynomials in the scale w of the waveform and the width g."""
    w, g = (a.ravel() for a in np.meshgrid(range(n_waveforms), range(n_geometries)))
    time, z = np.arange(8) / 8, np.linspace(0, 4, 21)
    w_, g_ = w[:, None, None], g[:, None, None]
    inflow = 1.2 + 0.1 * w[:, None] * np.cos(2 * np.pi * time)
    area_undeformed = 0.12 + 0.004 * g[:, None] * np.sin(np.pi * z / 4) ** 2
    along, over = z / 4, np.sin(2 * np.pi * time)[:, None]
    flow = inflow[:, :, None] + along * over * (0.01 * w_**2 + 0.02 * w_ * g_**2)
    area = area_undeformed[:, None, :] * (1.05 + 0.001 * w_ * over + 0.002 * g_**3)
    pressure = 1e5 * flow[:, :, -1:] + (4 - z) * (100 * w_**3 + 50 * g_)
    labels = {"geometry": g, "waveform": w}
    return Cases(flow, area, pressure, area_undeformed, time, z, labels=labels)


@pytest.fixture
def sets(small_cases, small_split):
    return small_cases.split(small_split)._asdict()


# ---- each of them ----------------------------------------------------------------


def test_nothing_happens(small_cases):
    train, test = small_cases.select(slice(0, 6)), small_cases.select(slice(6, 12))
    found = Unchanged().fit(train).predict(test)
    q, p = train.flow[:, :, -1], train.pressure[:, :, -1]
    resistance = (q * p).sum() / (q * q).sum()
    for case, instant, point in ((0, 3, 7), (5, 19, 20)):
        inflow = test.flow[case, instant, 0]
        assert found["flow"][case, instant, point] == inflow
        assert found["area"][case, instant, point] == test.area_undeformed[case, point]
        np.testing.assert_allclose(found["pressure"][case, instant, point], resistance * inflow)
    assert {name: values.shape for name, values in found.items()} == dict.fromkeys(
        VARIABLES, test.flow.shape
    )


def test_polynomial_finds_a_polynomial_outside_its_cases():
    cases = polynomial_cases()
    inside = cases.select((cases.labels["waveform"] < 4) & (cases.labels["geometry"] < 4))
    outside = cases.select(waveform=4)
    found = ResponseSurface(3, 3).fit(inside).predict(outside)
    for variable in VARIABLES:
        truth = getattr(outside, variable)
        np.testing.assert_allclose(found[variable], truth, rtol=1e-8)


def test_polynomial_of_degree_0_is_the_mean_and_of_degree_1_a_straight_line():
    cases = polynomial_cases()
    mean = ResponseSurface(0, 0).fit(cases).predict(cases)
    np.testing.assert_allclose(mean["pressure"][3], cases.pressure.mean(axis=0))
    # A straight line through two cases, at a third, by hand.
    row = cases.select(geometry=0)
    two, third = row.select([0, 1]), row.select([3])
    line = ResponseSurface(1, 1).fit(two).predict(third)
    by_hand = row.flow[0] + 3 * (row.flow[1] - row.flow[0])
    np.testing.assert_allclose(line["flow"][0], by_hand, rtol=1e-10)


def test_polynomial_components():
    cases = polynomial_cases()
    # Inflow and area have one component each; asking for more finds no more.
    for components in (None, 1, 3):
        surface = ResponseSurface(2, 2, components, components).fit(cases)
        assert surface._coefficients["flow"].shape == (9, 8, 21)
    # Two components of total degree 2: 1, x, y, x², xy, y².
    rng = np.random.default_rng(0)
    mixed = np.repeat(np.arange(20), 1)
    inflow = 1 + 0.1 * rng.standard_normal((20, 2)) @ rng.standard_normal((2, 8))
    flow = np.repeat(inflow[:, :, None], 5, axis=2)
    area_undeformed = np.full((20, 5), 0.12)
    area = np.repeat(area_undeformed[:, None], 8, axis=1)
    labels = {"geometry": mixed, "waveform": mixed}
    other = Cases(
        flow, area, 1e5 * flow, area_undeformed, np.arange(8) / 8, np.linspace(0, 4, 5),
        labels=labels,
    )  # fmt: skip
    surface = ResponseSurface(2, 3).fit(other)
    assert surface._coefficients["flow"].shape == (6, 8, 5)
    np.testing.assert_allclose(surface.predict(other)["flow"], flow, rtol=1e-8)


@pytest.mark.parametrize(
    ("select", "degrees", "message"),
    [
        ({"waveform": [0, 1, 2]}, (3, 3), "16 coefficients for each value, but there are 12"),
        ({"waveform": [0, 1, 2]}, (3, 1), "3 different waveforms, too few for 4 terms"),
        ({"geometry": [0, 1]}, (1, 2), "2 different geometries, too few for 3 terms"),
    ],
)
def test_polynomial_needs_enough_cases(select, degrees, message):
    with pytest.raises(InputError, match=message):
        ResponseSurface(*degrees).fit(polynomial_cases().select(**select))


def test_polynomial_needs_combinations():
    cases = polynomial_cases().select([(0, 0), (1, 0), (2, 0), (0, 1), (0, 2), (0, 3)])
    with pytest.raises(InputError, match="combine too few"):
        ResponseSurface(1, 2).fit(cases)


@pytest.mark.parametrize("arguments", [(-1, 1), (1, 1.5), (1, 1, -2), (True, 1)])
def test_polynomial_refuses(arguments):
    with pytest.raises(InputError, match="whole number"):
        ResponseSurface(*arguments)


def test_another_grid(small_cases, other_period):
    surface = ResponseSurface(1, 1).fit(small_cases)
    with pytest.raises(InputError, match="but the model was trained on 20"):
        surface.predict(polynomial_cases())
    with pytest.raises(InputError, match=r"is 0\.76 in the cases but 0\.95 in"):
        surface.predict(other_period)


@pytest.mark.parametrize("name", list(standard_baselines()))
def test_predicting_before_fitting(name, small_cases):
    with pytest.raises(InputError, match="has not been fitted"):
        standard_baselines()[name].predict(small_cases)


def test_solver_is_the_solver(sets):
    found = Solver1D(stenosis_length=1.0).fit(sets["train"]).predict(sets["test"])
    outlet = Windkessel(outlet_resistance(sets["train"]))
    tube = Tube1D(n_times=20, steps=500)
    solved = tube.solve_like(sets["test"], outlet, stenosis_length=1.0)
    for variable in VARIABLES:
        assert (found[variable] == getattr(solved, variable)).all()
    assert found["flow"][:, :, 0] == pytest.approx(sets["test"].inflow, rel=1e-9)


@pytest.mark.data
def test_the_papers_finite_element_column(published_cases):
    train, test = published_cases.split("paper")
    found = pooled_errors(Solver1D(FEM_WALL).fit(train).predict(test), test)
    paper = {"flow": 0.0204, "area": 0.0498, "pressure": 0.0365}
    assert found == pytest.approx(paper, rel=0.025)


@pytest.mark.data
def test_the_polynomial_on_the_papers_data(published_cases):
    sets = published_cases.split("paper")._asdict()
    surface = ResponseSurface().fit(sets["train"])
    found = {n: pooled_errors(surface.predict(c), c) for n, c in sets.items()}
    train = {"flow": 0.0020, "area": 0.0002, "pressure": 0.0033}
    assert found["train"] == pytest.approx(train, abs=1e-4)
    test = {"flow": 0.0044, "area": 0.0006, "pressure": 0.0070}
    assert found["test"] == pytest.approx(test, abs=1e-4)


# ---- bench -----------------------------------------------------------------------


class Perfect:
    """Knows the truth; says how often it was asked."""

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
    assert row.errors == {name: dict.fromkeys(VARIABLES, 0.0) for name in ("train", "test")}
    assert row.fit_seconds >= 0
    assert row.predict_ms_per_case >= 0
    assert row.reason is None


def test_bench_of_what_does_not_suit(sets):
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


def test_bench_does_not_warn_of_what_its_errors_show(small_cases, small_config, toy_engine):
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
    monkeypatch.setattr("pcnde_bridge.model.pcnde.select_engine", lambda name, **_: toy_engine)

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
    assert rows["nothing happens"]["errors"]["test"] == pooled_errors(unchanged, sets["test"])
    # Eleven cases are too few for sixteen terms; the rest goes on, and says so.
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
        (("cases.npz", "--json", "absent/bench.json"), "existing folder"),
    ],
)
def test_bench_refuses(run, folder, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    code, out, err = run("bench", *arguments)
    assert code == 2
    assert message in err
    assert out == ""
