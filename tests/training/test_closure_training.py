"""Training of the preset ``physics``: fits and checkpoints."""

from __future__ import annotations

import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from helpers import (
    AREA,
    CORRECTED,
    LOSSES,
    PHYSICS_CONFIG,
    RADIUS,
    TIME,
    Z,
    fit_physics,
    same_numbers,
)

from pcnde_bridge import (
    PCNDE,
    Cases,
    InputError,
)
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge._utils.workers import Worker
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.data.splits import neighboring_folds
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines import select_engine
from pcnde_bridge.errors import FileError
from pcnde_bridge.model import pcnde
from pcnde_bridge.training import closure_parts
from pcnde_bridge.training.closure_fit import _LOSSES
from pcnde_bridge.training.closure_training import ClosureTraining
from pcnde_bridge.training.trainer import Trainer


def saved(model, folder):
    model.save(folder / "model.npz")
    return folder / "model.npz"


@pytest.fixture(scope="module")
def cases(physics_cases):
    return physics_cases


@pytest.fixture(scope="module")
def model(physics_model):
    return physics_model


@pytest.fixture(scope="module")
def prediction(physics_prediction):
    return physics_prediction


@pytest.fixture(scope="module")
def records(physics_records):
    return physics_records


# ---- fit -------------------------------------------------------------------


def test_what_the_closures_made_is_learnt(model, cases):
    errors = model.evaluate(cases).iloc[-1]
    # A few evaluations; a passive tube alone leaves 1e-2 of the flow.
    limits = pd.Series({"flow": 1e-3, "area": 5e-4, "pressure": 1e-3, "wall_shear_stress": 0.02})
    assert (errors[limits.index] < limits).all()
    chosen = {"wall": {"law": "membrane"}, "losses": {"spacing": RADIUS / 10}}
    assert model.config == PHYSICS_CONFIG.replace(**chosen)
    assert model.parameters.outlet == pytest.approx(CORRECTED.outlet, rel=1e-3)
    # Friction and inertia; the other losses can replace each other.
    assert model.parameters.losses[:2] == pytest.approx(CORRECTED.losses[:2], rel=0.05)
    assert model.has_pressure


def test_history_names_the_closures(model, records):
    history = model.history
    numbers = history.drop(columns="outcome").itertuples(index=False, name=None)
    assert list(numbers) == [tuple(r)[:-1] for r in records]
    assert list(dict.fromkeys(history["stage"])) == ["losses", "wall", "correction"]
    # The fit to all cases, then four that leave out a part of them.
    for stage in ("losses", "correction"):
        fits = history[history["stage"] == stage]
        assert list(dict.fromkeys(fits["epoch"])) == [1, 2, 3, 4, 5]
    for _, rows in history.groupby(["stage", "epoch"]):
        assert list(rows["iteration"]) == list(range(1, len(rows) + 1))
        assert len(rows) <= 15
        assert rows["loss"].is_monotonic_decreasing
        outcomes = [outcome for outcome in rows["outcome"] if outcome]
        assert outcomes == [rows["outcome"].iloc[-1]]
        assert (
            outcomes[0].startswith("converged: ") or outcomes[0] == "stopped: all evaluations done"
        )
    assert history["seconds"].is_monotonic_increasing


def test_provenance(model, cases):
    found = model.provenance
    assert (found["seed"], found["engine"], found["cases"]) == (0, "jax", 16)
    assert found["cases_fingerprint"] == cases.fingerprint()
    assert "jax" in found["versions"]
    assert found["seconds"] == model.history["seconds"].iloc[-1] > 0
    assert json.loads(json.dumps(found)) == found


def test_another_seed_has_another_network(model, cases):
    other = fit_physics(cases, seed=1)
    assert not np.array_equal(other.parameters.correction, model.parameters.correction)
    assert np.array_equal(other.parameters.wall, model.parameters.wall)


def test_given_numbers_are_kept(cases):
    given = PHYSICS_CONFIG.replace(
        outlet={"resistance": 1e5, "distal_pressure": 5e3},
        losses=dict(zip(_LOSSES, map(float, LOSSES), strict=True)),
        wall={"stiffness": 1e6, "poisson": 0.45, "shear": 0.2, "support": 1.0}
        | {"zero_pressure": 2e3},
        correction={"storage": 1.3, "folds": 0},
    )
    model = fit_physics(cases, given)
    for name in ("outlet", "losses", "wall"):
        assert np.array_equal(getattr(model.parameters, name), getattr(CORRECTED, name))
    assert model.parameters.correction[0] == 1.3
    errors = model.evaluate(cases).iloc[-1]
    # The wall shear stress is not given: its fit is penalized towards the start.
    fitted = errors.filter(like="wall_shear_stress")
    assert errors.drop(fitted.index).max() < 1e-3
    assert fitted.max() < 2e-3
    assert model.uncertainty is None
    with pytest.raises(InputError, match="no uncertainty to draw samples from"):
        model.predict(cases, samples=4)


@pytest.mark.julia
def test_both_engines_fit_the_same_model(model, cases, prediction, tmp_path):
    ours = fit_physics(cases, engine="julia")
    assert ours.engine.name == PCNDE.load(saved(ours, tmp_path), engine="auto").engine.name
    for name, vector in model.parameters:
        assert np.allclose(getattr(ours.parameters, name), vector, rtol=1e-6, atol=1e-9), name
    errors, expected_errors = (m.evaluate(cases).iloc[-1] for m in (ours, model))
    for name in VARIABLES:
        assert errors[name] == pytest.approx(expected_errors[name], rel=1e-4)
    mine = PCNDE.load(saved(model, tmp_path), engine="julia").predict(cases, samples=12, seed=3)
    for name in VARIABLES:
        expected = getattr(prediction, name)
        close = {"rtol": 0, "atol": 1e-11 * np.abs(expected).max()}
        assert np.allclose(getattr(mine, name), expected, **close), name
        assert np.allclose(mine.samples[name], prediction.samples[name], **close), name


def test_cases_that_do_not_vary_are_refused():
    steady = np.ones((2, 32, 41))
    stated = {"units": "cgs,area=cm^2"}  # without a pressure drop
    same = Cases(steady, 0.125 * steady, 1e5 * steady, AREA[:2], TIME, Z, **stated)
    with pytest.raises(InputError, match="do not vary"):
        fit_physics(same)
    size = np.array([1.0, 2.0])[:, None, None]
    flows, areas = size * steady, 0.125 * steady
    steady_flow = Cases(flows, areas, size * 1e5 * steady, AREA[:2], TIME, Z, **stated)
    wave = 1 + 0.1 * np.cos(2 * np.pi * TIME)[:, None]
    rigid = Cases(wave * steady, areas, wave * 1e5 * steady, AREA[:2], TIME, Z, **stated)
    for unchanging in (steady_flow, rigid):
        with pytest.raises(InputError, match="inflow is steady or their walls are rigid"):
            fit_physics(unchanging)


def test_ensemble_leaves_out_whole_geometries_and_whole_waveforms(cases):
    left_out = neighboring_folds(cases, 2)
    labels = cases.labels[["geometry", "waveform"]]
    taken = [set(labels.iloc[part].itertuples(index=False, name=None)) for part in left_out]
    # Geometries are in order of their narrowness, waveforms in that of their oscillation.
    assert taken == [{(g, w) for g in pair for w in range(4)} for pair in ((3, 4), (1, 2))] + [
        {(g, w) for g in range(1, 5) for w in pair} for pair in ((0, 1), (2, 3))
    ]
    few = cases.select(geometry=1)
    assert sorted(np.concatenate(neighboring_folds(few, 2))) == [0, 1, 2, 3]
    # With as few geometries and waveforms as folds, or fewer, each is left out once.
    corners = cases.select([(1, 0), (4, 0), (1, 3), (4, 3)])
    found = [list(part) for part in neighboring_folds(corners, 3)]
    assert found == [[1, 3], [0, 2], [0, 1], [2, 3]]
    assert neighboring_folds(corners, 4) == []


# ---- checkpoint ------------------------------------------------------------


def interrupt_at(stage, epoch):
    """Callback that raises at a fit's first record."""

    def on_iteration(record):
        if (record.stage, record.epoch, record.iteration) == (stage, epoch, 1):
            raise KeyboardInterrupt

    return on_iteration


@pytest.mark.parametrize(("stage", "epoch"), [("losses", 1), ("correction", 1), ("correction", 2)])
def test_interrupted_run_goes_on_to_the_same_bits(model, cases, tmp_path, stage, epoch):
    path = tmp_path / "checkpoint"
    with pytest.raises(KeyboardInterrupt):
        fit_physics(cases, checkpoint=path, progress=interrupt_at(stage, epoch))
    records = []
    resumed = fit_physics(cases, checkpoint=path, progress=records.append)
    assert same_numbers(resumed, model)
    # What was finished is not done again, what was interrupted is.
    assert (records[0].stage, records[0].epoch, records[0].iteration) == (stage, epoch, 1)


def test_same_seed_same_bits_and_a_finished_checkpoint_gives_them_at_once(model, cases, tmp_path):
    path, records = tmp_path / "checkpoint", []
    first = fit_physics(cases, seed=np.int64(0), checkpoint=path)
    again = fit_physics(cases, checkpoint=path, progress=records.append)
    assert same_numbers(first, again)
    assert same_numbers(first, model)
    assert records == []


def test_going_on_with_another_engine_is_told(cases, started, caplog):
    Trainer(ClosureTraining(cases, PHYSICS_CONFIG, select_engine("jax")), started).start(0)
    assert caplog.text == ""
    trainer = Trainer(ClosureTraining(cases, PHYSICS_CONFIG, OtherEngine()), started)
    assert trainer.start(0).vectors.keys() == {"outlet", "losses"}
    assert "was written with the jax engine and continues with other" in caplog.text


class OtherEngine:
    name, closures = "other", None


@pytest.fixture(scope="module")
def started(cases, tmp_path_factory):
    path = tmp_path_factory.mktemp("started") / "checkpoint"
    with pytest.raises(KeyboardInterrupt):
        fit_physics(cases, checkpoint=path, progress=interrupt_at("wall", 1))
    return path


def test_checkpoint_of_another_run_is_refused_and_untouched(cases, started):
    whole = started.read_bytes()
    deeper = PHYSICS_CONFIG.replace(correction={"hidden": (5,)})
    for arguments, message in (
        ({"cases": cases.select(slice(0, 15))}, "on other cases"),
        ({"cases": cases, "config": deeper}, "with another configuration"),
        ({"cases": cases, "seed": 1}, "with seed 0, not 1"),
    ):
        with pytest.raises(InputError, match=message):
            fit_physics(checkpoint=started, **arguments)
    assert started.read_bytes() == whole


def test_damaged_checkpoint_is_a_file_error(cases, started, tmp_path):
    whole, path = started.read_bytes(), tmp_path / "checkpoint"
    for part in (0.0, 0.5, 0.99):
        path.write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(FileError, match="checkpoint"):
            fit_physics(cases, checkpoint=path)


@pytest.mark.parametrize("change", ["missing", "short", "unknown", "history"])
def test_checkpoint_that_is_not_whole_is_a_file_error(cases, started, tmp_path, change):
    kind, path = "pcnde-closures-checkpoint", tmp_path / "checkpoint"
    facts, arrays = read_archive(started, kind, 1, "checkpoint")
    facts = {k: v for k, v in facts.items() if not k.startswith("format")}
    if change == "missing":
        del arrays["losses"]
    elif change == "short":
        arrays["losses"] = arrays["losses"][:-1]
    elif change == "unknown":
        facts["vectors"] = [*facts["vectors"], "wall"]
    else:
        arrays["history"] = np.ones((2, 5))
    write_archive(path, kind, 1, facts, arrays)
    with pytest.raises(FileError, match="not a complete checkpoint"):
        fit_physics(cases, checkpoint=path)


# ---- the published cases -------------------------------------------------------


@pytest.mark.data
def test_published_cases_are_met_within_the_limits(published_cases):
    train, test = published_cases.split("paper")
    model = fit_physics(train, PHYSICS.replace(correction={"folds": 0}))
    errors = model.evaluate(test).iloc[-1]
    assert errors["flow"] <= 0.0055
    assert errors["area"] <= 0.0025
    assert errors["pressure"] <= 0.0065
    assert errors["wall_shear_stress"] <= 0.08
    assert errors["time_averaged_wall_shear_stress"] <= 0.06


def test_workers_give_the_same(physics_cases, physics_model, monkeypatch):
    pools = [ThreadPoolExecutor(1) for _ in range(2)]

    def worker(number):
        def submit(function, *arguments):
            return pools[number].submit(function, *pickle.loads(pickle.dumps(arguments)))  # noqa: S301

        return Worker(submit, str(number))

    monkeypatch.setattr(closure_parts, "LARGEST_PART", 6)
    monkeypatch.setattr(pcnde, "started_workers", lambda count: nullcontext([*map(worker, count)]))
    fitted = fit_physics(physics_cases, executor=range(2))
    for name, vector in fitted.parameters:
        expected = getattr(physics_model.parameters, name)
        np.testing.assert_allclose(vector, expected, rtol=1e-10, atol=1e-12, err_msg=name)
    with pytest.raises(InputError, match="only with the preset 'physics' and the engine 'jax'"):
        PCNDE.fit(physics_cases, "fast", "jax", executor=2)
