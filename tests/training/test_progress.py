"""Progress of training, in a terminal and in a log file."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from pcnde_bridge._utils import progress as base
from pcnde_bridge.training import progress
from pcnde_bridge.training.history import Iteration
from pcnde_bridge.training.progress import TrainingProgress
from pcnde_bridge.training.trainer import training_session


class Clock:
    """A clock that the test moves."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    for module in (progress, base):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock.monotonic))
    return clock


def record(number, stage="flow", epoch=1):
    return Iteration(stage, epoch, 1, number, 0.5 / number, 0.1 * number)


def log():
    return Console(file=io.StringIO(), force_terminal=False, width=200)


def test_a_log_has_a_line_now_and_then(clock):
    console = log()
    with TrainingProgress(100, console=console) as bar:
        for number in range(1, 101):
            clock.now += 1.0
            bar(record(number))
    lines = console.file.getvalue().splitlines()
    assert len(lines) == 10
    assert lines[0] == (
        "flow, epoch 1: iteration 10 of 100, loss 5.000e-02, elapsed 10 s, remaining 90 s"
    )
    assert "iteration 90 of 100" in lines[8]
    assert lines[8].endswith("elapsed 90 s, remaining 10 s")


def test_every_iteration_with_another_interval(clock, monkeypatch):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    console = log()
    with TrainingProgress(4, console=console) as bar:
        for number in range(1, 5):
            clock.now += 2.0
            bar(record(number, "temporal_pressure"))
    lines = console.file.getvalue().splitlines()
    assert [line.split(", loss")[0] for line in lines] == [
        f"temporal pressure: iteration {n} of 4" for n in range(1, 5)
    ]
    assert [line.split("remaining ")[1] for line in lines] == ["unknown", "4 s", "2 s", "0 s"]


def test_a_continued_run_estimates_from_its_own_iterations(clock, monkeypatch):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    console = log()
    with TrainingProgress(100, done=90, console=console) as bar:
        clock.now += 50.0  # compiles
        bar(record(1))
        clock.now += 3.0
        bar(record(2))
    first, second = console.file.getvalue().splitlines()
    assert "iteration 91 of 100" in first
    assert first.endswith("elapsed 50 s, remaining unknown")
    assert "iteration 92 of 100" in second
    assert second.endswith("elapsed 53 s, remaining 24 s")


def test_slow_iterations_at_the_end_count_more(clock, monkeypatch):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    console = log()
    with TrainingProgress(6, slow=(2, 5.0), console=console) as bar:
        for number in range(1, 7):
            clock.now += 1.0 if number <= 4 else 5.0
            bar(record(number))
    lines = console.file.getvalue().splitlines()
    assert [line.split("remaining ")[1] for line in lines] == [
        "unknown",
        *(f"{seconds} s" for seconds in (12, 11, 10, 5, 0)),
    ]


def test_compilation_does_not_count_as_iterations(clock, monkeypatch):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    console = log()
    with TrainingProgress(6, console=console) as bar:
        for task, compilation in (("flow", 20.0), ("temporal_pressure", 30.0)):
            bar.on_step(task)
            clock.now += compilation
            for number in range(1, 4):
                bar(record(number, task))
                clock.now += 2.0
    lines = [line for line in console.file.getvalue().splitlines() if "remaining" in line]
    left = [line.split("remaining ")[1] for line in lines]
    assert left == ["unknown", "8 s", "6 s", "4 s", "2 s", "0 s"]


def test_converged_fits_are_counted(clock, monkeypatch):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    console = log()
    with TrainingProgress(4, console=console) as bar:
        for outcome in ("converged: gradient tolerance", "stopped: all iterations done", ""):
            clock.now += 2.0
            bar(record(1))
            bar.on_fit_end(outcome)
    lines = console.file.getvalue().splitlines()
    assert ["converged" in line for line in lines] == [False, True, True]
    assert "loss 5.000e-01, converged 1 of 2 fits, elapsed 6 s" in lines[2]
    console = Console(file=io.StringIO(), force_terminal=True, width=200, color_system=None)
    with TrainingProgress(4, console=console) as bar:
        bar.on_fit_end("converged: no change")
        bar._bar.refresh()
    assert "converged 1/1" in console.file.getvalue()


def test_compilation_is_announced_once_for_each_task(clock):
    console = log()
    with TrainingProgress(5, console=console) as bar:
        for task in ("flow", "flow", "temporal_pressure"):
            bar.on_step(task)
            bar(record(1))
    assert console.file.getvalue().splitlines() == [
        "flow: compiling",
        "temporal pressure: compiling",
    ]
    console = Console(file=io.StringIO(), force_terminal=True, width=200, color_system=None)
    with TrainingProgress(5, console=console) as bar:
        bar.on_step("flow")
        assert "flow: compiling" in console.file.getvalue()


def test_more_iterations_than_usual_raise_the_total(clock, monkeypatch):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    console = log()
    with TrainingProgress(2, console=console) as bar:
        for number in (1, 2, 3):
            bar(record(number))
    assert "iteration 3 of 3" in console.file.getvalue()


def test_a_short_run_leaves_the_log_empty(clock):
    console = log()
    with TrainingProgress(5, console=console) as bar:
        for number in range(1, 6):
            clock.now += 1.0
            bar(record(number))
    assert console.file.getvalue() == ""


def test_a_terminal_has_a_bar_that_counts():
    console = Console(file=io.StringIO(), force_terminal=True, width=200, color_system=None)
    with TrainingProgress(10, done=2, console=console) as bar:
        bar(record(3, epoch=7))
        bar(record(4, epoch=7))
        bar._bar.refresh()
        shown = console.file.getvalue()
    assert "4/10" in shown
    assert "flow, epoch 7" in shown
    assert "loss 1.250e-01" in shown
    assert "iteration 4" not in shown
    assert "10/10" not in shown
    assert "10/10" in console.file.getvalue()


def test_an_interrupted_bar_stays_where_it_was():
    console = Console(file=io.StringIO(), force_terminal=True, width=200, color_system=None)
    with pytest.raises(KeyboardInterrupt), TrainingProgress(10, console=console) as bar:
        bar(record(1))
        raise KeyboardInterrupt
    assert "1/10" in console.file.getvalue()
    assert "10/10" not in console.file.getvalue()


def test_a_session_shows_a_bar_or_calls_the_callers_function_or_does_nothing(monkeypatch, capsys):
    monkeypatch.setattr(base, "LOG_EVERY", 0.0)
    heard = []
    for listener, words in (
        (True, "flow: compiling\nflow, epoch 1: iteration 1 of 3"),
        (heard.append, ""),
        (False, ""),
    ):
        with training_session(listener, 3) as (on_iteration, on_fit_end, on_step):
            on_step("flow")
            on_iteration(record(1))
            on_fit_end("converged: gradient tolerance")
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith(words) if words else said.err == ""
    assert heard == [record(1)]
