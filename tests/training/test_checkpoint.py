"""The newest two checkpoints of a run, and what is looked at before training."""

from __future__ import annotations

import logging
import os
import re
import shutil
import subprocess
from collections import namedtuple
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pcnde_bridge import (
    PCNDE,
    FileError,
    InputError,
    PCNDEConfig,
)
from pcnde_bridge._utils import files
from pcnde_bridge._utils.archive import read_archive
from pcnde_bridge.training.checkpoint import (
    Checkpoint,
    previous,
    remove,
)
from pcnde_bridge.training.procedure import RunState, Step
from pcnde_bridge.training.trainer import Trainer, staged_training


@dataclass(frozen=True, kw_only=True)
class NumberState(RunState):
    number: int


class NumberProcedure(SimpleNamespace):
    """Procedure whose state is a number; it has cases, config and engine."""

    checkpoint_format, outlet = ("test", 1), None
    count_iterations = staticmethod(lambda _: 1)
    steps = staticmethod(lambda _: [Step("count")])
    to_archive = staticmethod(lambda s: ({"number": s.number}, {"a": np.full(100, s.number)}))

    @staticmethod
    def from_archive(facts, arrays):
        assert arrays["a"].tolist() == [facts["number"]] * 100
        return NumberState(seed=facts["seed"], number=facts["number"])


def read(checkpoint):
    return checkpoint.read(5).number


def write(checkpoint, n):
    checkpoint.write(NumberState(seed=5, number=n))


@pytest.fixture
def new(small_cases, toy_config, toy_engine):
    """Make a checkpoint of a run on the small cases, or of another."""

    def new(path, cases=small_cases, config=toy_config, engine=toy_engine):
        return Checkpoint(path, NumberProcedure(cases=cases, config=config, engine=engine))

    return new


@pytest.fixture
def checkpoint(new, tmp_path):
    checkpoint = new(tmp_path / "run")
    for n in (1, 2, 3):
        write(checkpoint, n)
    return checkpoint


def test_the_newest_two_are_kept(checkpoint, tmp_path):
    assert {p.name for p in tmp_path.iterdir()} == {"run", "run.previous"}
    assert read(checkpoint) == 3
    kept = read_archive(previous(checkpoint.path), "test", 1, "checkpoint")
    assert kept[0]["number"] == 2


@pytest.mark.parametrize("damage", ["half", "empty", "bit", "foreign"])
def test_a_damaged_newest_falls_back_and_says_so(checkpoint, tmp_path, caplog, damage):
    whole = bytearray(checkpoint.path.read_bytes())
    whole[whole.index(b"NUMPY")] ^= 1  # in an array: dates in the archive have no checksum
    content = {"half": whole[: len(whole) // 2], "empty": b"", "bit": whole, "foreign": b"hello"}
    checkpoint.path.write_bytes(bytes(content[damage]))
    with caplog.at_level(logging.WARNING, "pcnde_bridge"):
        assert read(checkpoint) == 2
    (message,) = caplog.messages
    assert str(checkpoint.path) in message
    assert f"Continuing from the checkpoint before it, {previous(checkpoint.path)}" in message
    # The good one is not overwritten with the damaged one.
    write(checkpoint, 4)
    assert read(checkpoint) == 4
    kept = read_archive(previous(checkpoint.path), "test", 1, "checkpoint")
    assert kept[0]["number"] == 2


def test_both_damaged_is_an_error_about_the_newest(checkpoint):
    for path in (checkpoint.path, previous(checkpoint.path)):
        path.write_bytes(b"")
    with pytest.raises(FileError, match=r"run is not a pcnde_bridge checkpoint"):
        read(checkpoint)


def test_a_run_thrown_away_does_not_come_back(checkpoint, tmp_path):
    checkpoint.path.unlink()
    assert checkpoint.read(5) is None
    write(checkpoint, 9)
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    remove(checkpoint.path)
    remove(checkpoint.path)
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_removed(checkpoint, tmp_path):
    (tmp_path / ".run.0123abcd").write_text("half")
    (tmp_path / ".run.previous.0123abcd.previous").write_text("half")
    (tmp_path / ".run.0123abcx").write_text("someone else's")
    checkpoint.check(NumberState(seed=5, number=1))
    left = {p.name for p in tmp_path.iterdir()}
    assert left == {"run", "run.previous", ".run.0123abcx"}


def test_the_run_is_told_and_another_is_refused(checkpoint, new, small_cases, toy_config, caplog):
    path = checkpoint.path
    facts, _ = read_archive(path, "test", 1, "checkpoint")
    assert (facts["seed"], facts["cases"]) == (5, small_cases.fingerprint())
    assert PCNDEConfig.from_dict(facts["config"]) == toy_config
    assert facts["provenance"]["engine"] == "toy"
    whole = path.read_bytes()
    other_config, fewer = toy_config.replace(batch_size=4), small_cases.select(slice(0, 11))
    for other, seed, message in (
        (new(path, cases=fewer), 5, "on other cases. Give the same cases"),
        (new(path, config=other_config), 5, "with another configuration. Give the same one"),
        (new(path), 6, "with seed 5, not 6. Give that seed"),
    ):
        expected = f"{path} belongs to a run {message}, or another checkpoint file."
        with pytest.raises(InputError, match=re.escape(expected)):
            other.read(seed)
    assert path.read_bytes() == whole
    assert caplog.text == ""
    assert read(new(path, engine=SimpleNamespace(name="other"))) == 3
    assert "was written with the toy engine and continues with other" in caplog.text


# ---- in training -----------------------------------------------------------------


def stop_after(count):
    def on_iteration(record):
        nonlocal count
        count -= 1
        if count == 0:
            raise KeyboardInterrupt

    return on_iteration


def test_training_goes_on_from_the_one_before_to_the_same_bits(
    small_cases, toy_config, toy_engine, tmp_path, caplog
):
    whole = PCNDE.fit(small_cases, toy_config, toy_engine, progress=False)
    path = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=stop_after(25))
    path.write_bytes(path.read_bytes()[:1000])
    procedure = staged_training(small_cases, toy_config, toy_engine)
    finished = Trainer(procedure, path).start(0).finished
    assert finished > 0
    model = PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=False)
    assert "Continuing from the checkpoint before it" in caplog.text
    assert model.parameters == whole.parameters


def refuse(record):
    raise AssertionError("training began")


def test_a_disk_without_room_is_found_before_training(
    small_cases, toy_config, toy_engine, tmp_path, monkeypatch
):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(files.shutil, "disk_usage", lambda path: usage(10**9, 10**9, 1000))
    with pytest.raises(FileError, match=r"about \d+\.\d MB are needed, and 0\.0 MB are free"):
        PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=tmp_path / "run", progress=refuse)
    assert list(tmp_path.iterdir()) == []


def test_a_checkpoint_that_can_no_longer_be_written_is_found_on_resuming(
    small_cases, toy_config, toy_engine, tmp_path, monkeypatch
):
    path = tmp_path / "run"
    PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=False)

    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "touch", denied)
    with pytest.raises(FileError, match="no permission to write"):
        PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=refuse)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of two megabytes; skips where none can be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    if subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=2m", "tmpfs", folder], check=False, capture_output=True
    ).returncode:
        pytest.skip("no small file system can be mounted here")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_a_disk_that_is_full(small_cases, toy_config, toy_engine, small_disk):
    path = small_disk / "run"
    with pytest.raises(KeyboardInterrupt):
        PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=stop_after(25))
    full = small_disk / "others"
    with pytest.raises(OSError, match="No space left"), full.open("wb") as handle:
        for _ in range(100):
            handle.write(bytes(1 << 16))
    with pytest.raises(FileError, match="MB are needed"):
        PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=refuse)
    # Full in the middle of a run: what was written stays whole.
    procedure = staged_training(small_cases, toy_config, toy_engine)
    checkpoint, state = Checkpoint(path, procedure), procedure.start(0)
    state = replace(state, parameters=state.parameters.replace(flow=np.zeros(1 << 17)))
    before = path.read_bytes()
    with pytest.raises(FileError, match="the disk is full"):
        checkpoint.write(state)
    assert path.read_bytes() == before
    full.unlink()
    model = PCNDE.fit(small_cases, toy_config, toy_engine, checkpoint=path, progress=False)
    assert (
        model.parameters
        == PCNDE.fit(small_cases, toy_config, toy_engine, progress=False).parameters
    )


def test_a_disk_that_can_only_be_read(small_cases, toy_config, toy_engine, small_disk):
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(FileError, match="no permission to write"):
        PCNDE.fit(
            small_cases, toy_config, toy_engine, checkpoint=small_disk / "run", progress=refuse
        )
