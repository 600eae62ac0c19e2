"""The training loop: its plan, its state, and that no interruption changes the result."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pcnde_bridge import (
    PAPER,
    PCNDE,
    PRESETS,
    Cases,
    InputError,
)
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.parameters import STAGES, initial_parameters
from pcnde_bridge.engines.staged import solve_area, undeformed
from pcnde_bridge.errors import FileError
from pcnde_bridge.training.checkpoint import previous
from pcnde_bridge.training.history import Iteration, from_arrays, to_arrays, to_frame
from pcnde_bridge.training.procedure import Step
from pcnde_bridge.training.staged_training import check
from pcnde_bridge.training.trainer import Trainer, staged_training


def without_seconds(history):
    return [record._replace(seconds=0.0) for record in history]


def train(cases, config, engine, seed=0, **options):
    trainer = Trainer(staged_training(cases, config, engine), **options)
    return trainer.run(trainer.start(seed))


def start(cases, config, engine, seed=0, checkpoint=None):
    """Return the state of a new run, or of its checkpoint."""
    return Trainer(staged_training(cases, config, engine), checkpoint).start(seed)


@pytest.fixture(scope="module")
def reference(small_cases, toy_config):
    """An uninterrupted run of the toy engine."""
    from helpers import ToyEngine

    return train(small_cases, toy_config, ToyEngine())


def without_outcome(history):
    return [record._replace(outcome="") for record in history]


def interrupt_at(number, records=None):
    """Callback that raises at the given record, counted from 0."""
    seen = [] if records is None else records

    def on_iteration(record):
        seen.append(record)
        if len(seen) == number + 1:
            raise KeyboardInterrupt

    return on_iteration


# ---- steps ------------------------------------------------------------------


@pytest.fixture
def planned(small_cases, toy_engine):
    """Return the procedure of a configuration, and a first state with some batches."""

    def planned(config, n_batches):
        procedure = staged_training(small_cases, config, toy_engine)
        return procedure, replace(procedure.start(0), batches=(np.arange(2),) * n_batches)

    return planned


def test_steps_in_order(planned):
    procedure, state = planned(PAPER.replace(flow={"epochs": 5, "couple_every": 2}), 2)
    assert procedure.steps(state) == [
        Step("flow", 1, 1),
        Step("flow", 1, 2),
        Step("flow", 2, 1),
        Step("flow", 2, 2),
        Step("coupling", 2, 1),
        Step("flow", 3, 1),
        Step("flow", 3, 2),
        Step("flow", 4, 1),
        Step("flow", 4, 2),
        Step("coupling", 4, 1),
        Step("flow", 5, 1),
        Step("flow", 5, 2),
        Step("temporal_pressure", 1, 1),
        Step("spatial_pressure", 1, 1),
    ]


def test_the_papers_steps(planned):
    procedure, state = planned(PAPER, 7)
    units = procedure.steps(state)
    assert [u.epoch for u in units if u.task == "coupling"] == [25, 50, 75, 100]
    assert sum(u.task == "flow" for u in units) == 700
    assert units[-3:] == [
        Step("coupling", 100, 1),
        Step("temporal_pressure", 1, 1),
        Step("spatial_pressure", 1, 1),
    ]
    assert procedure.count_iterations(state) == 700 * 5 + 4 * 7 * (5 + 5) + 250 + 75


def test_iterations_are_counted_as_they_come(reference, toy_config, planned):
    procedure, state = planned(toy_config, 3)
    assert len(reference.history) == procedure.count_iterations(state)
    expected = []
    for unit in procedure.steps(state):
        if unit.task == "coupling":
            expected += [
                (stage, unit.epoch, batch, i)
                for stage in ("intermediate_area", "fourier_area")
                for batch in (1, 2, 3)
                for i in (1, 2, 3)
            ]
        else:
            expected += [
                (unit.task, unit.epoch, unit.batch, i)
                for i in range(1, getattr(toy_config, unit.task).iterations + 1)
            ]
    assert [record[:4] for record in reference.history] == expected
    assert np.isfinite([r.loss for r in reference.history]).all()
    last = [
        r
        for r, after in zip(reference.history, [*reference.history[1:], None], strict=True)
        if after is None or after.iteration == 1
    ]
    assert {r.outcome for r in last} == {"stopped: all iterations done"}
    assert sum(bool(r.outcome) for r in reference.history) == len(last)
    seconds = [r.seconds for r in reference.history]
    assert seconds == sorted(seconds)
    assert seconds[0] > 0
    assert reference.seconds == seconds[-1]


# ---- first state -----------------------------------------------------------


def test_batches_are_a_seeded_partition_of_the_cases(small_cases, toy_config, toy_engine):
    state = start(small_cases, toy_config, toy_engine, 3)
    assert [len(batch) for batch in state.batches] == [5, 5, 2]
    order = np.concatenate(state.batches)
    assert sorted(order) == list(range(12))
    assert list(order) != list(range(12))
    again = start(small_cases, toy_config, toy_engine, 3)
    assert np.array_equal(np.concatenate(again.batches), order)
    other = start(small_cases, toy_config, toy_engine, 4)
    assert not np.array_equal(np.concatenate(other.batches), order)
    assert state.parameters == initial_parameters(toy_config, 20, 21, 3)
    assert (state.finished, state.history, state.couplings, state.seconds) == (0, (), (), 0.0)


def test_one_batch_where_there_are_few_cases(small_cases, toy_config, toy_engine):
    state = start(small_cases.select([0, 1]), toy_config, toy_engine, 0)
    assert [sorted(batch) for batch in state.batches] == [[0, 1]]


# ---- check -----------------------------------------------------------------


def test_cases_without_flow_are_refused(small_cases):
    arrays = {name: getattr(small_cases, name) for name in ("area", "pressure", "area_undeformed")}
    still = Cases(
        np.zeros(small_cases.flow.shape),
        **arrays,
        time=small_cases.time,
        z=small_cases.z,
        period=1.0,
        labels=small_cases.labels,
    )
    for preset in ("paper", "fast"):
        with pytest.raises(InputError, match="The training cases have no flow"):
            check(still, PRESETS[preset])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"flow": {"epochs": 3, "couple_every": 4}}, r"flow\.epochs=3 .*flow\.couple_every=4"),
        ({"fourier_area": {"terms": 11}}, r"fourier_area\.terms=11 needs at least 22 .*have 20"),
        ({"physics": {"stenosis_position": 1.3}}, r"stenosis_position=1\.3 cm .*middle third"),
        ({"physics": {"stenosis_position": 2.7}}, r"stenosis_position=2\.7 cm .*0 to 4 cm"),
        ({"physics": {"stenosis_position": -2.0}}, r"stenosis_position=-2\.0 cm"),
    ],
)
def test_settings_that_do_not_fit_the_cases(
    small_cases, toy_config, toy_engine, tmp_path, change, message
):
    config = toy_config.replace(**change)
    with pytest.raises(InputError, match=message):
        check(small_cases, config)
    with pytest.raises(InputError, match=message):
        PCNDE.fit(small_cases, config, engine=toy_engine, checkpoint=tmp_path / "c")
    assert list(tmp_path.iterdir()) == []


def test_settings_at_the_limit_fit(small_cases, toy_config):
    check(small_cases, toy_config.replace(flow={"couple_every": 4}))
    check(small_cases, toy_config.replace(fourier_area={"terms": 10}))


# ---- what the stages are given -----------------------------------------------


def test_batches_and_the_smaller_last_one_reach_the_stages(small_cases, toy_config, toy_engine):
    state = train(small_cases, toy_config, toy_engine)
    fits = toy_engine.flow.fits
    assert len(fits) == 4 * 3
    for number, (_, inputs, target) in enumerate(fits):
        batch = state.batches[number % 3]
        assert np.array_equal(inputs[0], small_cases.inflow[batch])
        assert np.array_equal(target, small_cases.flow[batch])
    for stage in (toy_engine.intermediate_area, toy_engine.fourier_area):
        assert [len(target) for _, _, target in stage.fits] == [5, 5, 2] * 2
        assert np.array_equal(stage.fits[2][2], small_cases.area[state.batches[2]])
    for stage in (toy_engine.temporal_pressure, toy_engine.spatial_pressure):
        ((_, _, target),) = stage.fits
        assert np.allclose(target * 133_322.0, small_cases.pressure, rtol=1e-14)


def test_each_fit_starts_where_the_last_one_ended(small_cases, toy_config, toy_engine):
    state = train(small_cases, toy_config, toy_engine)
    first = initial_parameters(toy_config, 20, 21, 0)
    for name in STAGES:
        starts = [start for start, _, _ in getattr(toy_engine, name).fits]
        assert np.array_equal(starts[0], getattr(first, name))
        for before, after in pairwise(starts):
            assert not np.array_equal(before, after)
        assert not np.array_equal(starts[-1], getattr(state.parameters, name))


def test_restart_begins_every_batch_of_the_fourier_area_anew(small_cases, toy_config, toy_engine):
    config = toy_config.replace(fourier_area={"restart": True})
    train(small_cases, config, toy_engine)
    starts = [start for start, _, _ in toy_engine.fourier_area.fits]
    assert len(starts) == 6
    for start in starts:
        assert np.array_equal(start, [1.0] * 21 + [0.0] * 21)
    continued = [start for start, _, _ in toy_engine.intermediate_area.fits]
    assert not np.array_equal(continued[0], continued[1])


def test_the_area_is_coupled_into_the_flow(small_cases, toy_config, toy_engine):
    """Epochs 1 and 2 see S_u, 3 and 4 the area that the first coupling predicts."""
    state = train(small_cases, toy_config, toy_engine)
    assert len(state.couplings) == 2
    grid = small_cases.grid
    before = undeformed(small_cases.area_undeformed, 20)
    first = state.couplings[0]
    flow = toy_engine.flow.solve(first.flow, (small_cases.inflow, before), grid, toy_config)
    after = solve_area(toy_engine, first, flow, small_cases.area_undeformed, grid, toy_config)
    assert np.abs(after - before).max() > 1e-3
    for number, (_, inputs, _) in enumerate(toy_engine.flow.fits):
        batch = state.batches[number % 3]
        expected = before if number < 6 else after
        assert np.array_equal(inputs[1], expected[batch])


def test_anchor_of_the_fourier_area(small_cases, toy_config, toy_engine):
    found = {}
    for anchor in ("undeformed", "last_cycle", "last_time_point"):
        toy_engine.fourier_area.fits.clear()
        config = toy_config.replace(fourier_area={"anchor": anchor})
        state = train(small_cases, config, toy_engine)
        first, grid = state.couplings[0], Grid(small_cases.time, small_cases.z, 1.0)
        s_u = small_cases.area_undeformed
        flow = toy_engine.flow.solve(
            first.flow, (small_cases.inflow, undeformed(s_u, 20)), grid, config
        )
        whole = toy_engine.intermediate_area.solve(
            first.intermediate_area, (flow, s_u), grid, config
        )
        at = {"undeformed": 0, "last_cycle": 40, "last_time_point": 59}[anchor]
        found[anchor] = toy_engine.fourier_area.fits[0][1][1]
        assert np.array_equal(found[anchor], whole[state.batches[0], at])
    assert not np.allclose(found["last_cycle"], found["last_time_point"], rtol=1e-6)


# ---- interruption and continuation -------------------------------------------

MOMENTS = {
    "first iteration": lambda r: True,
    "flow, second batch": lambda r: r[:3] == ("flow", 1, 2),
    "flow, after a coupling": lambda r: r[:4] == ("flow", 3, 3, 2),
    "intermediate area": lambda r: r[:3] == ("intermediate_area", 2, 2),
    "fourier area": lambda r: r[:4] == ("fourier_area", 4, 3, 3),
    "temporal pressure": lambda r: r[:4] == ("temporal_pressure", 1, 1, 4),
    "spatial pressure": lambda r: r[:4] == ("spatial_pressure", 1, 1, 6),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_continued_run_repeats_the_interrupted_one(
    small_cases, toy_config, toy_engine, reference, tmp_path, moment
):
    number = next(i for i, r in enumerate(reference.history) if MOMENTS[moment](r))
    path = tmp_path / "checkpoint"
    with pytest.raises(KeyboardInterrupt):
        train(
            small_cases,
            toy_config,
            toy_engine,
            checkpoint=path,
            on_iteration=interrupt_at(number),
        )
    records = []
    trainer = Trainer(staged_training(small_cases, toy_config, toy_engine), path, records.append)
    state = trainer.start(0)
    kept = len(state.history)
    units = staged_training(small_cases, toy_config, toy_engine).steps(state)
    interrupted = reference.history[number]
    works = {"intermediate_area": "coupling", "fourier_area": "coupling"}
    unit = units[state.finished]
    assert unit.task == works.get(interrupted.stage, interrupted.stage)
    assert unit.epoch == interrupted.epoch
    assert unit.task != "flow" or unit.batch == interrupted.batch
    assert kept <= number
    final = trainer.run(state)
    assert final.parameters == reference.parameters
    assert final.couplings == reference.couplings
    assert without_seconds(final.history) == without_seconds(reference.history)
    expected = without_outcome(reference.history[kept:])  # known only when a fit has ended
    assert without_seconds(records) == without_seconds(expected)
    seconds = [r.seconds for r in final.history]
    assert seconds == sorted(seconds)


def test_interrupted_again_and_again(small_cases, toy_config, toy_engine, reference, tmp_path):
    path, runs = tmp_path / "checkpoint", 0
    while True:
        runs += 1
        assert runs < 30
        try:
            final = train(
                small_cases, toy_config, toy_engine, checkpoint=path, on_iteration=interrupt_at(20)
            )
        except KeyboardInterrupt:
            continue
        break
    assert runs > 3
    assert final.parameters == reference.parameters
    assert without_seconds(final.history) == without_seconds(reference.history)


def test_a_finished_run_has_nothing_left_to_do(
    small_cases, toy_config, toy_engine, reference, tmp_path
):
    path = tmp_path / "checkpoint"
    train(small_cases, toy_config, toy_engine, checkpoint=path)
    final = train(
        small_cases, toy_config, toy_engine, checkpoint=path, on_iteration=interrupt_at(0)
    )
    assert final.parameters == reference.parameters
    assert final.finished == 4 * 3 + 2 + 2


def test_the_checkpoint_follows_every_epoch(small_cases, toy_config, toy_engine, tmp_path):
    """Without Ctrl-C, after a crash say, at most an epoch is lost."""
    path, finished = tmp_path / "checkpoint", []

    def look(record):
        state = start(small_cases, toy_config, toy_engine, checkpoint=path)
        finished.append(state.finished)

    train(small_cases, toy_config, toy_engine, checkpoint=path, on_iteration=look)
    assert sorted(set(finished)) == [0, 3, 6, 7, 10, 13, 14, 15]


@pytest.mark.parametrize("number", [4, 20, 30, 58])
def test_the_jax_engine_continues_bit_for_bit(
    small_cases, small_split, small_config, small_model, tmp_path, number
):
    cases = small_cases.split(small_split).train
    path = tmp_path / "checkpoint"
    options = {"engine": "jax", "seed": 0, "checkpoint": path}
    with pytest.raises(KeyboardInterrupt):
        PCNDE.fit(cases, small_config, progress=interrupt_at(number), **options)
    records = []
    model = PCNDE.fit(cases, small_config, progress=records.append, **options)
    assert 0 < len(records) < len(small_model.history)
    assert model.parameters == small_model.parameters
    columns = ["stage", "epoch", "batch", "iteration", "loss", "outcome"]
    assert model.history[columns].equals(small_model.history[columns])


KILLED = """
import sys, time
sys.path.insert(0, {tests!r})
from helpers import ToyEngine
from pcnde_bridge import Cases, PCNDEConfig
from pcnde_bridge.training.trainer import Trainer, staged_training

config = PCNDEConfig.from_json(open({config!r}).read())
procedure = staged_training(Cases.load({cases!r}), config, ToyEngine())
trainer = Trainer(procedure, {checkpoint!r}, lambda record: time.sleep(0.05))
trainer.run(trainer.start(0))
"""


def test_a_killed_run_continues_to_the_same_parameters(
    small_cases, toy_config, toy_engine, reference, tmp_path
):
    """SIGKILL at random moments, in a process that trains."""
    checkpoint = tmp_path / "checkpoint"
    small_cases.save(tmp_path / "cases.npz")
    (tmp_path / "config.json").write_text(toy_config.to_json())
    code = KILLED.format(
        tests=str(Path(__file__).parents[1]),
        config=str(tmp_path / "config.json"),
        cases=str(tmp_path / "cases.npz"),
        checkpoint=str(checkpoint),
    )
    rng = np.random.default_rng(7)
    finished = 0
    for _ in range(3):
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE)
        deadline = time.monotonic() + 60
        while not checkpoint.exists() or checkpoint.stat().st_mtime_ns == before:
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stderr.close()
        assert process.returncode == -signal.SIGKILL
        state = start(small_cases, toy_config, toy_engine, checkpoint=checkpoint)
        assert finished <= state.finished < 16
        finished = state.finished
    assert finished > 0
    final = train(small_cases, toy_config, toy_engine, checkpoint=checkpoint)
    assert final.parameters == reference.parameters
    assert without_seconds(final.history) == without_seconds(reference.history)


# ---- checkpoints that do not fit --------------------------------------------


@pytest.fixture
def checkpoint(small_cases, toy_config, toy_engine, tmp_path):
    path = tmp_path / "run.checkpoint"
    with pytest.raises(KeyboardInterrupt):
        train(small_cases, toy_config, toy_engine, checkpoint=path, on_iteration=interrupt_at(40))
    return path


def refuse(record):
    raise AssertionError("training began")


def test_a_checkpoint_of_another_run_is_refused(
    small_cases, toy_config, toy_engine, checkpoint, tmp_path
):
    whole = checkpoint.read_bytes()
    options = {"engine": toy_engine, "checkpoint": checkpoint, "progress": refuse}
    with pytest.raises(InputError, match=r"run\.checkpoint belongs to a run with seed 0, not 1"):
        PCNDE.fit(small_cases, toy_config, seed=1, **options)
    with pytest.raises(InputError, match=r"run\.checkpoint belongs to a run with another config"):
        PCNDE.fit(small_cases, toy_config.replace(flow={"iterations": 9}), **options)
    for other in (small_cases.select(list(range(11))), small_cases.select(list(range(12))[::-1])):
        with pytest.raises(InputError, match=r"run\.checkpoint belongs to a run on other cases"):
            PCNDE.fit(other, toy_config, **options)
    assert checkpoint.read_bytes() == whole


def test_going_on_with_another_engine_is_told(
    small_cases, toy_config, toy_engine, checkpoint, caplog
):
    start(small_cases, toy_config, toy_engine, checkpoint=checkpoint)
    assert caplog.text == ""
    toy_engine.name = "other"
    assert start(small_cases, toy_config, toy_engine, checkpoint=checkpoint).finished > 0
    assert "was written with the toy engine and continues with other" in caplog.text


def test_a_damaged_checkpoint_is_refused_and_kept(small_cases, toy_config, toy_engine, checkpoint):
    whole = checkpoint.read_bytes()
    flipped = bytearray(whole)
    flipped[whole.index(b"NUMPY")] ^= 1  # in an array: dates in the archive have no checksum
    previous(checkpoint).unlink()
    for content in (whole[: len(whole) // 2], b"", b"hello", bytes(flipped)):
        checkpoint.write_bytes(content)
        with pytest.raises(FileError, match=r"run\.checkpoint"):
            PCNDE.fit(
                small_cases, toy_config, engine=toy_engine, checkpoint=checkpoint, progress=refuse
            )
        assert checkpoint.read_bytes() == content


def test_a_model_is_no_checkpoint(small_cases, toy_config, toy_engine, tmp_path):
    path = tmp_path / "model"
    PCNDE.fit(small_cases, toy_config, engine=toy_engine, progress=False).save(path)
    with pytest.raises(FileError, match="not a pcnde_bridge checkpoint but a 'pcnde-model'"):
        PCNDE.fit(small_cases, toy_config, engine=toy_engine, checkpoint=path, progress=refuse)


def test_a_checkpoint_with_something_missing(
    small_cases, toy_config, toy_engine, checkpoint, monkeypatch
):
    from pcnde_bridge._utils.archive import read_archive
    from pcnde_bridge.training import checkpoint as checkpoints

    facts, arrays = read_archive(checkpoint, "pcnde-checkpoint", 1, "checkpoint")
    losses = [("facts", name) for name in ("seed", "finished", "config", "cases", "couplings")]
    losses += [("arrays", name) for name in ("batches", "history", "flow", "coupling_0_flow")]
    previous(checkpoint).unlink()
    for kind, name in losses:
        broken = {"facts": dict(facts), "arrays": dict(arrays)}
        del broken[kind][name]
        monkeypatch.setattr(
            checkpoints,
            "read_archive",
            lambda path, *rest, b=broken: (
                tuple(b.values()) if path == checkpoint else read_archive(path, *rest)
            ),
        )
        with pytest.raises(FileError, match="not a complete checkpoint"):
            start(small_cases, toy_config, toy_engine, checkpoint=checkpoint)


def test_a_checkpoint_that_cannot_be_written_is_found_before_training(
    small_cases, toy_config, toy_engine, tmp_path
):
    (tmp_path / "file").write_text("")
    bad = [tmp_path / "nowhere" / "c", tmp_path / "file" / "c", tmp_path]
    if Path("/proc/self").is_dir():
        bad.append(Path("/proc/self/c"))
    for path in bad:
        with pytest.raises(FileError):
            PCNDE.fit(small_cases, toy_config, engine=toy_engine, checkpoint=path, progress=refuse)
    assert os.listdir(tmp_path) == ["file"]  # noqa: PTH208


# ---- history -----------------------------------------------------------------


def test_history_as_numbers_and_as_a_frame(reference):
    arrays = to_arrays(reference.history)
    assert arrays["history"].shape == (len(reference.history), 6)
    assert from_arrays(arrays) == reference.history
    del arrays["history_outcomes"]  # as in older files
    assert without_outcome(from_arrays(arrays)) == without_outcome(reference.history)
    frame = to_frame(reference.history)
    assert list(frame.columns) == list(Iteration._fields)
    assert len(frame) == len(reference.history)
    assert Iteration(*frame.iloc[7]) == reference.history[7]


def test_an_empty_history():
    assert to_arrays([])["history"].shape == (0, 6)
    assert from_arrays(to_arrays([])) == ()
    assert list(to_frame([]).columns) == list(Iteration._fields)
