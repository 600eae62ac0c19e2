"""``pcnde figures``: figures, files and error messages."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pandas as pd
import pytest

from pcnde_bridge import (
    PCNDE,
    Cases,
    FileError,
    InputError,
    SolveError,
)
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.model.metrics import pooled_errors
from pcnde_bridge.plots import figures as module
from pcnde_bridge.plots.figures import (
    COSTS,
    FIGURES,
    FigureData,
    choose,
    hardest_case,
    make_figures,
)

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")

ALWAYS = [name for name in FIGURES if name not in COSTS]


@pytest.fixture
def without_pictures(monkeypatch):
    """Write no pictures, which would take longest; other tests draw the figures.

    Yields the numbers by the name of the figure.
    """
    found = {}

    def write(stem, figure, numbers):
        found[stem.name] = numbers
        stem.with_suffix(".png").write_bytes(b"\x89PNG")
        return [stem.with_suffix(".png")]

    monkeypatch.setattr(module, "_write", write)
    return found


@pytest.fixture
def toy_model(small_cases, toy_config, toy_engine) -> PCNDE:
    train = small_cases.split("paper").train
    return PCNDE.fit(train, toy_config, engine=toy_engine, seed=3, progress=False)


class Shifted:
    """Another method, which returns 1.1 times the truth."""

    def fit(self, train):
        return self

    def predict(self, cases):
        return {
            "flow": cases.flow * 1.1,
            "area": cases.area * 1.1,
            "pressure": cases.pressure * 1.1,
        }


@pytest.fixture
def data(toy_model, small_cases) -> FigureData:
    return FigureData(toy_model, small_cases, *small_cases.split("paper"), other=Shifted())


NEW_FLOW_FITS = ("smoothness", "loss-landscapes")
"""Figures that fit the flow again, with equations that the toy engine lacks."""


def test_every_figure_is_made(data, tmp_path, without_pictures):
    seen = []
    names = [name for name in FIGURES if name not in NEW_FLOW_FITS]
    made = make_figures(data, tmp_path / "out", only=names, announce=seen.append)
    assert [line.partition(":")[0] for line in seen] == [
        f"[{i}/{len(names)}] {name}" for i, name in enumerate(names, 1)
    ]
    assert list(made) == names
    assert all(made.values())
    assert len(list((tmp_path / "out").iterdir())) == len(names)
    tables = without_pictures

    test = data.test
    expected = pooled_errors(data.model.predict(test).variables(), test)
    for variable, error in expected.items():
        assert tables["results"].loc[("PCNDE", "test"), variable] == pytest.approx(error)
    assert tables["results"].loc[("1D solver", "test"), "flow"] == pytest.approx(0.1)
    assert tables["box-plots"].loc[("area", "1D solver"), "median"] == pytest.approx(0.1)
    assert tables["error-matrix"].shape == (9, 4)
    assert list(tables["noise-inflow"].index) == ["flow", "area", "pressure"]
    assert len(tables["activations"]) == 5


def test_files_are_complete_and_reproducible(data, tmp_path):
    for folder in ("one", "two"):
        (made,) = make_figures(data, tmp_path / folder, only=["box-plots"]).values()
        assert [path.name for path in made] == [
            "box-plots.png",
            "box-plots.pdf",
            "box-plots.csv",
        ]
    for start, suffix in ((b"\x89PNG", "png"), (b"%PDF", "pdf"), (b"variable,method", "csv")):
        one, two = ((tmp_path / folder / f"box-plots.{suffix}") for folder in ("one", "two"))
        assert one.read_bytes().startswith(start)
        assert one.read_bytes() == two.read_bytes()
    read = pd.read_csv(tmp_path / "one" / "box-plots.csv", index_col=["variable", "method"])
    pd.testing.assert_frame_equal(read, FIGURES["box-plots"][0](data)[1])
    assert {p.name for p in (tmp_path / "one").iterdir()} == {f.name for f in made}


def test_a_failure_leaves_no_partial_file(data, tmp_path, monkeypatch):
    (tmp_path / "box-plots.png").write_text("old")

    def savefig(path, **options):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    def draw(data):
        return SimpleNamespace(savefig=savefig), None

    monkeypatch.setattr(module, "FIGURES", {"box-plots": (draw, "")})
    with pytest.raises(FileError, match="disk is full"):
        make_figures(data, tmp_path)
    assert (tmp_path / "box-plots.png").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_unsuitable_figures_are_left_out_or_rejected(data, tmp_path, without_pictures):
    data.model.config = PHYSICS.replace()
    data.__dict__["_predicted"] = Shifted().predict(data.cases)
    chosen = [name for name in ALWAYS if not name.startswith("noise")]
    with pytest.raises(InputError, match="fourier-effect: This study needs the paper's equations"):
        make_figures(data, tmp_path, only=chosen)
    said = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FIGURES", {name: FIGURES[name] for name in chosen})
        made = make_figures(data, tmp_path, announce=said.append)
    assert [name for name, files in made.items() if not files] == ["fourier-effect"]
    (reason,) = (line for line in said if "left out" in line)
    assert reason.startswith("fourier-effect is left out. ")
    assert "needs the paper's equations" in reason


def test_divergence_affects_one_figure_only(data, tmp_path, without_pictures, monkeypatch):
    def diverges(*arguments, **options):
        raise SolveError("case 3 diverges")

    monkeypatch.setattr("pcnde_bridge.studies.noise_study", diverges)
    said = []
    make_figures(data, tmp_path, announce=said.append)
    assert [line for line in said if "left out" in line] == [
        f"{name} is left out. case 3 diverges" for name in ("noise-inflow", "noise-area")
    ]
    with pytest.raises(SolveError, match="noise-area: case 3 diverges"):
        make_figures(data, tmp_path, only=["noise-area"])


def test_another_grid_is_rejected_first(data, small_cases, tmp_path):
    cut = Cases(
        small_cases.flow[:, :, 1:],
        small_cases.area[:, :, 1:],
        small_cases.pressure[:, :, 1:],
        small_cases.area_undeformed[:, 1:],
        small_cases.time,
        small_cases.z[1:],
        labels=small_cases.labels,
    )
    with pytest.raises(InputError, match="model was trained on 21"):
        make_figures(FigureData(data.model, cut, cut), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_unsuitable_other_method_is_omitted(data, caplog):
    class Unsuitable(Shifted):
        def predict(self, cases):
            raise InputError("the points are too far apart")

    data.other = Unsuitable()
    assert list(data.by_method(data.evaluated)) == ["PCNDE"]
    assert "too far apart" in caplog.text
    assert list(data.by_method(data.evaluated)) == ["PCNDE"]


def test_without_test_cases_the_training_cases_are_evaluated(toy_model, small_cases):
    data = FigureData(toy_model, small_cases, small_cases, other=None)
    assert data.evaluated is small_cases
    assert data.hardest.labels[["geometry", "waveform"]].to_numpy().tolist() == [[3, 3]]
    assert list(FIGURES["results"][0](data)[1].index) == [("PCNDE", "train")]


def test_predictions_match_their_cases(data, small_cases):
    shuffled = small_cases.select([7, 0, 11])
    alone = data.model.predict(shuffled).flow
    assert data.predicted(shuffled)["flow"].tolist() == alone.tolist()
    with pytest.raises(KeyError):
        data.by_method(data.train)


def test_smoothness_names_the_truth(data, monkeypatch):
    seen, study = {}, SimpleNamespace(to_frame=pd.DataFrame)
    monkeypatch.setattr(module.studies, "compare_formulations", lambda *_, **__: study)
    monkeypatch.setattr(module.plots, "smoothness", lambda _, **options: seen.update(options))
    data.truth_label = "1D solver"
    FIGURES["smoothness"][0](data)
    assert seen == {"truth_label": "1D solver"}


def test_hardest_case(small_cases):
    assert hardest_case(small_cases) == 11
    assert hardest_case(small_cases.select([11, 0, 5])) == 0


def test_choosing():
    assert choose() == ALWAYS
    assert choose(with_studies=True) == list(FIGURES)
    assert choose(["activations", "results"]) == ["results", "activations"]
    with pytest.raises(InputError, match=r"no figure 'result'; the figures are: data-set, history"):
        choose(["result"])


# ---- the command line ---------------------------------------------------------


@pytest.fixture
def files(tmp_path, toy_model, small_cases, toy_engine, monkeypatch):
    """Files of a model, a data set and a split."""
    toy_model.save(tmp_path / "model.npz")
    small_cases.save(tmp_path / "cases.npz")
    split = {"train": [[1, 0], [1, 1], [2, 0]], "test": [[3, 3], [3, 2]]}
    (tmp_path / "split.json").write_text(json.dumps(split))
    for part in ("pcnde", "predictor"):
        name = f"pcnde_bridge.model.{part}.select_engine"
        monkeypatch.setattr(name, lambda name, **_: toy_engine)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.mark.slow
def test_figures_with_new_flow_fits(small_model, small_cases, small_split, tmp_path):
    train, test = small_cases.split(small_split)
    made = make_figures(
        FigureData(small_model, small_cases, train, test, other=None), tmp_path, only=NEW_FLOW_FITS
    )
    for files in made.values():
        assert [path.suffix for path in files] == [".png", ".pdf", ".csv"]
        assert len(pd.read_csv(files[-1]))


def test_pcnde_figures(run_pcnde, files, without_pictures):
    out = files / "made"
    code, text, notes = run_pcnde(
        "figures", files / "model.npz", files / "cases.npz", "--out", out, "--split", "paper"
    )
    assert code == 0, notes
    assert sorted(path.stem for path in out.iterdir()) == sorted(ALWAYS)
    assert f"[1/{len(ALWAYS)}] data-set: waveforms" in notes
    assert f"[{len(ALWAYS)}/{len(ALWAYS)}] noise-area" in notes
    assert "Left out without --studies: activations (fits the pressure stages five times)" in text
    assert all(name in text for name in NEW_FLOW_FITS)
    assert str(out) in text


def test_pcnde_figures_only_and_with_a_split(run_pcnde, files):
    out = files / "made"
    options = ("--only", "pointwise-errors", "--only", "data-set", "--split", files / "split.json")
    code, text, notes = run_pcnde(
        "figures", files / "model.npz", files / "cases.npz", "--out", out, *options
    )
    assert code == 0, notes
    assert {path.name for path in out.iterdir()} == {
        "data-set.png",
        "data-set.pdf",
        "pointwise-errors.png",
        "pointwise-errors.pdf",
        "pointwise-errors.csv",
    }
    assert "pointwise-errors: pointwise-errors.png, pointwise-errors.pdf" in text
    assert "--studies" not in text


def test_pcnde_figures_with_workers(run_pcnde, files, without_pictures, monkeypatch):
    made = []

    def pool(workers):
        made.append(workers)
        return ThreadPoolExecutor(workers)

    monkeypatch.setattr("pcnde_bridge._utils.parallel.processes", pool)
    noise = ("figures", files / "model.npz", files / "cases.npz", "--only", "noise-inflow")
    assert run_pcnde(*noise, "--out", files / "one")[0] == 0
    assert made == []
    assert run_pcnde(*noise, "--out", files / "two", "--workers", "2")[0] == 0
    assert made == [2]
    for folder in ("one", "two"):
        assert [path.name for path in (files / folder).iterdir()] == ["noise-inflow.png"]


def test_pcnde_figures_reports_errors(run_pcnde, files):
    model, data = files / "model.npz", files / "cases.npz"
    (files / "file").write_text("mine")
    for arguments, words in (
        ((model, data, "--out", files / "x", "--only", "result"), "There is no figure 'result'"),
        ((model, data, "--out", files / "file"), "is a file; give a folder"),
        ((model, files / "none", "--out", files / "x"), "neither a file or folder"),
        ((files / "none.npz", data, "--out", files / "x"), "none.npz"),
        ((data, data, "--out", files / "x"), "cases.npz"),
        ((model, data, "--out", files / "x", "--split", files / "no.json"), "no split file"),
        ((model, data, "--out", files / "file" / "x"), "Cannot create the folder"),
    ):
        code, text, notes = run_pcnde("figures", *arguments)
        assert code == 2, (arguments, notes)
        assert notes.splitlines()[-1].startswith("Error: "), notes
        assert words in notes
        assert "Traceback" not in text + notes
        assert not (files / "x").exists()
    assert (files / "file").read_text() == "mine"
    assert run_pcnde("figures", model, data)[0] == 2
