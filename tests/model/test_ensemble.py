"""Ensembles with fits that need no compiling, in Python and on the command line."""

from __future__ import annotations

import json
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pandas as pd
import pytest
from helpers import FailingEngine, ToyEngine, interrupt_at

from pcnde_bridge import (
    PCNDE,
    Ensemble,
    FileError,
    InputError,
    OutsideTrainingWarning,
    PCNDEWarning,
    TaskError,
    load_model,
)
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge._utils.parallel import processes, run
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.model.describe import describe
from pcnde_bridge.model.fit_task import (
    FitTask,
    fit_model,
    model_of,
)
from pcnde_bridge.model.metrics import coverage, pooled_errors
from pcnde_bridge.uncertainty.calibration import Calibration


def same(one, other):
    return (
        len(one.members) == len(other.members)
        and all(
            a.parameters == b.parameters for a, b in zip(one.members, other.members, strict=True)
        )
        and np.array_equal(one.calibration.profile, other.calibration.profile)
        and np.array_equal(one.calibration.scale, other.calibration.scale)
    )


# ---- ensembles -----------------------------------------------------------------------


def test_members_are_fits_with_the_next_seeds(small_cases, config, engine, ensemble):
    for k, member in enumerate(ensemble.members):
        alone = PCNDE.fit(small_cases, config, engine, seed=k, progress=False)
        assert member.parameters == alone.parameters
        assert member.provenance["seed"] == k
    assert ensemble.members[0].parameters != ensemble.members[1].parameters
    assert repr(ensemble).startswith("Ensemble(3 × PCNDE(")


def test_mean_and_deviation(small_cases, ensemble):
    prediction = ensemble.predict(small_cases)
    alone = [member.predict(small_cases) for member in ensemble.members]
    deviation = prediction.standard_deviation()
    for number, name in enumerate(VARIABLES):
        values = np.stack([p.variables()[name] for p in alone])
        np.testing.assert_allclose(prediction.variables()[name], values.mean(axis=0), rtol=1e-14)
        # σ = c √(s² + (a e)²), on the grid of the training.
        spread = values.std(axis=0, ddof=1)
        relative = small_cases.inflow.std(axis=1) / ensemble.calibration.amplitude
        shared = np.maximum(relative, 0.3)[:, None, None] * ensemble.calibration.profile[number]
        expected = ensemble.calibration.scale[number] * np.hypot(spread, shared)
        scale = np.abs(values).max()
        np.testing.assert_allclose(deviation[name], expected, rtol=1e-6, atol=1e-12 * scale)
        assert prediction.samples[name].shape == values.shape
    # The flow at the inlet is given.
    np.testing.assert_allclose(deviation["flow"][:, :, 0], 0, atol=1e-12)
    assert "pressure_standard_deviation" in prediction.to_frame()
    table = ensemble.evaluate(small_cases)
    errors = pooled_errors(prediction.variables(), small_cases)
    assert table.iloc[-1].to_dict() == pytest.approx(errors)


def test_wall_shear_stress_of_an_ensemble_is_the_mean(small_cases, ensemble, monkeypatch):
    """The engine's solution may have one; its spread is not calibrated."""

    def predict(self, *args):
        solution = predict_by_stages(self, *args)
        return solution._replace(wall_shear_stress=solution.flow**2)

    monkeypatch.setattr(ToyEngine, "predict", predict)
    alone = [member.predict(small_cases) for member in ensemble.members]
    assert np.array_equal(alone[0].wall_shear_stress, alone[0].flow ** 2)
    prediction = ensemble.predict(small_cases)
    expected = np.mean([one.wall_shear_stress for one in alone], axis=0)
    np.testing.assert_allclose(prediction.wall_shear_stress, expected, rtol=1e-14)
    assert list(prediction.samples) == list(prediction.interval()) == [*VARIABLES]
    assert {"peak_wss", "ffr_low"} <= {*prediction.indices()}


def test_where_members_agree_the_samples_still_have_the_deviation(small_cases, config, engine):
    member = PCNDE.fit(small_cases, config, engine, progress=False)
    calibration = Calibration(np.full((3, 4), 0.5), np.array([1.0, 2.0, 3.0]), np.zeros(1))
    prediction = Ensemble([member, member, member], calibration).predict(small_cases)
    for name, c in zip(VARIABLES, (1.0, 2.0, 3.0), strict=True):
        np.testing.assert_allclose(prediction.standard_deviation()[name], 0.5 * c, rtol=1e-6)
        np.testing.assert_allclose(
            prediction.samples[name].mean(axis=0), prediction.variables()[name], rtol=1e-9
        )


def test_members_have_one_grid(small_cases, other_period, config, engine, ensemble):
    members = [PCNDE.fit(c, config, engine, progress=False) for c in (small_cases, other_period)]
    with pytest.raises(InputError, match="trained on different grids"):
        Ensemble(members, ensemble.calibration)


def test_intervals_are_calibrated_on_cases_left_out(small_cases, config, engine, ensemble):
    """On left-out folds, 90 % intervals contain about 90 % of the values on average."""
    held = []
    for label in ("geometry", "waveform"):
        for value in np.unique(small_cases.labels[label])[[0, -1]]:
            chosen = (small_cases.labels[label] == value).to_numpy()
            rest = small_cases.select(~chosen)
            fits = [PCNDE.fit(rest, config, engine, seed=k, progress=False) for k in range(2)]
            few = Ensemble(fits, ensemble.calibration)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", OutsideTrainingWarning)
                intervals = few.predict(small_cases.select(chosen)).interval(0.9)
            held.append(coverage(intervals, small_cases.select(chosen)))
    shares = pd.DataFrame(held).mean()
    assert (shares > 0.75).all()
    assert (shares < 1.0).any()


def test_the_warning_of_extrapolation_points_to_the_callers_line(small_cases, ensemble):
    with pytest.warns(OutsideTrainingWarning) as caught:
        ensemble.predict(3 * small_cases.inflow, small_cases.area_undeformed)
    assert len(caught) == 1
    assert caught[0].filename == __file__


def test_executors_and_a_folder_change_no_bit(small_cases, config, engine, ensemble, tmp_path):
    fit = {"members": 3, "folds": 2, "progress": False}
    pool = processes(2)
    parallel = Ensemble.fit(
        small_cases, config, engine, executor=pool, folder=tmp_path / "fits", **fit
    )
    assert same(parallel, ensemble)
    kept = Ensemble.fit(small_cases, config, engine, folder=tmp_path / "fits", **fit)
    assert same(kept, ensemble)
    with pytest.raises(InputError, match="result of other tasks"):
        Ensemble.fit(small_cases, config, engine, seed=1, folder=tmp_path / "fits", **fit)


def test_the_jax_engine_gives_the_same_bits_in_another_process(
    small_cases, small_split, small_config, small_model
):
    """With as many threads of XLA; those of numpy do not matter."""
    task = FitTask(small_cases.split(small_split).train, small_config, "jax", 0)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        outcome = run(fit_model, {"a": task}, executor=pool, progress=False)
    there = model_of(outcome.check()["a"], "jax")
    assert there.parameters == small_model.parameters
    assert there.provenance["cases_labels"] == small_model.provenance["cases_labels"]


def test_failed_fits_are_left_out_and_told(small_cases, config):
    fit = {"members": 3, "folds": 2, "progress": False, "retries": 0}
    with pytest.warns(PCNDEWarning, match=r"1 of 11 tasks failed \(member 0: OSError: lost"):
        ensemble = Ensemble.fit(small_cases, config, FailingEngine({0}), **fit)
    assert len(ensemble.members) == 2
    assert list(ensemble.provenance["failures"]) == ["member 0"]
    with pytest.raises(TaskError, match="Too few fits remain for an ensemble"):
        Ensemble.fit(small_cases, config, FailingEngine(set(range(10000))), **fit)


def test_an_ensemble_predicts_batch_by_batch(small_cases, ensemble):
    inputs = 1.5 * small_cases.inflow, small_cases.area_undeformed
    with pytest.warns(OutsideTrainingWarning, match="12 of 12 cases") as warned:
        whole = ensemble.predict(*inputs)
        batches = ensemble.predict_batches(*inputs, batch=5)
    assert [w.filename for w in warned] == [__file__] * 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parts = list(batches)
    assert [len(part) for part in parts] == [5, 5, 2]
    found = pd.concat([part.to_frame() for part in parts], ignore_index=True)
    assert "flow_standard_deviation" in found
    pd.testing.assert_frame_equal(found, whole.to_frame(), rtol=1e-9)
    with pytest.raises(InputError, match="batch must be a whole number ≥ 1"):
        ensemble.predict_batches(*inputs, batch=0)


def test_save_and_load(small_cases, ensemble, engine, tmp_path):
    path = tmp_path / "ensemble.npz"
    ensemble.save(path)
    for loaded in (Ensemble.load(path, engine), load_model(path, engine)):
        assert same(loaded, ensemble)
        mine, theirs = ensemble.predict(small_cases), loaded.predict(small_cases)
        assert all(np.array_equal(mine.samples[n], theirs.samples[n]) for n in VARIABLES)
    assert loaded.provenance == json.loads(json.dumps(ensemble.provenance))
    ensemble.members[0].save(tmp_path / "model.npz")
    assert isinstance(load_model(tmp_path / "model.npz", engine), PCNDE)
    for load, other, message in (
        (PCNDE.load, path, "model but a 'pcnde-ensemble' file. Give a file of one model"),
        (Ensemble.load, tmp_path / "model.npz", "ensemble but a 'pcnde-model' file. Give a file"),
    ):
        with pytest.raises(FileError, match=f"{message}.*load_model reads either"):
            load(other, engine)
    with pytest.raises(FileError, match="There is no file"):
        load_model(tmp_path / "nowhere", engine)


def test_damaged_ensembles_are_file_errors(ensemble, engine, tmp_path):
    path = tmp_path / "ensemble.npz"
    ensemble.save(path)
    facts, arrays = read_archive(path, "pcnde-ensemble", 1, "ensemble")
    broken = [
        (facts, {k: v for k, v in arrays.items() if k != "scale"}),
        (facts, {**arrays, "scale": np.ones(2)}),
        (facts, {**arrays, "amplitude": np.array([-1.0])}),
        (facts, {**arrays, "profile": np.full((3, 4), np.nan)}),
        (facts, {k: v for k, v in arrays.items() if k != "member_1_flow"}),
        ({**facts, "members": facts["members"][:1]}, arrays),
        ({k: v for k, v in facts.items() if k != "members"}, arrays),
    ]
    for content in broken:
        write_archive(path, "pcnde-ensemble", 1, *content)
        with pytest.raises(FileError, match=r"ensemble\.npz.* is not a complete"):
            Ensemble.load(path, engine)


def test_arguments_of_an_ensemble(small_cases, config, engine):
    for change, message in (
        ({"members": 1}, "members must be a whole number ≥ 2"),
        ({"folds": True}, "folds must be a whole number ≥ 2"),
        ({"seed": -1}, "seed must be a whole number ≥ 0"),
        ({"folds": 99}, "too few for 99 folds"),
    ):
        with pytest.raises(InputError, match=message):
            Ensemble.fit(small_cases, config, engine, **change)
    with pytest.raises(InputError, match="must be Cases, got list"):
        Ensemble.fit([1], config, engine)


def test_an_ensemble_on_the_command_line(
    commands, small_cases, config, engine, run_pcnde, tmp_path, monkeypatch
):
    interrupt_at(engine, monkeypatch, 20)
    fit = ("fit", "--out", "e.npz", "--members", "2", "--workers", "2")
    code, _, err = commands(*fit)
    assert code == 130
    assert "The finished fits are in e.npz.fits: run the same command again" in err
    finished = len(list((tmp_path / "e.npz.fits").iterdir()))
    assert 0 < finished < 2 + 3 * 2
    before = len(engine.flow.fits)
    code, printed, err = commands(*fit)
    assert code == 0
    assert "Continuing with the finished fits in e.npz.fits" in err
    assert "Saved e.npz" in printed
    taken = len(engine.flow.fits) - before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cases.npz", "config.json", "e.npz"]
    before = len(engine.flow.fits)
    whole = Ensemble.fit(small_cases, config, engine, members=2, progress=False)
    total = len(engine.flow.fits) - before
    assert total - 20 <= taken < total  # finished fits are not repeated
    assert same(Ensemble.load("e.npz", engine), whole)
    assert "pcnde fit cases.npz" in describe("e.npz")["provenance"]["command"]

    assert run_pcnde("evaluate", "e.npz", "cases.npz", "--split", "none")[0] == 0
    for name, axis, values in (
        ("time", small_cases.time, small_cases.inflow[0]),
        ("z", small_cases.z, small_cases.area_undeformed[0]),
    ):
        pd.DataFrame({name: axis, "a": values}).to_csv(f"{name}.csv", index=False)
    predict = ("predict", "e.npz", "--inflow", "time.csv", "--area", "z.csv", "--out", "p.csv")
    code, printed, err = run_pcnde(*predict, "--samples", 64)
    assert (code, printed) == (2, "")
    assert "e.npz is an ensemble" in err
    assert "intervals need no samples: leave out --samples" in err
    assert not (tmp_path / "p.csv").exists()
    assert run_pcnde(*predict)[0] == 0
    frame = pd.read_csv("p.csv")
    expected = whole.predict(small_cases.select([0])).to_frame()
    np.testing.assert_allclose(
        frame["pressure_standard_deviation"], expected["pressure_standard_deviation"]
    )


def test_checkpoint_of_an_ensemble_is_refused(commands):
    code, _, err = commands("fit", "--out", "m.npz", "--members", "2", "--checkpoint", "c")
    assert code == 2
    assert "leave --checkpoint out" in err
