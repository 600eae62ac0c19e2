"""Progress of tasks, in a terminal and in a log file."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from pcnde_bridge._utils import progress
from pcnde_bridge._utils.parallel import run
from pcnde_bridge._utils.progress import TaskProgress


@pytest.mark.parametrize("terminal", [False, True])
def test_tasks_done_before_and_failed_ones_count(monkeypatch, terminal):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: clock.now))
    console = Console(file=io.StringIO(), force_terminal=terminal, width=200, color_system=None)
    monkeypatch.setattr(progress, "LOG_EVERY", 0.0)
    with TaskProgress(10, 6, console=console) as bar:
        clock.now += 5.0
        bar("seed 6")
        clock.now += 1.0
        bar("seed 7", "SolveError: it diverged")
    shown = console.file.getvalue()
    assert "8 of 10 tasks: seed 7 failed: SolveError: it diverged" in shown
    assert "elapsed 6 s, remaining 6 s" in shown
    assert ("7 of 10 tasks: seed 6 done, elapsed 5 s, remaining 15 s" in shown) != terminal
    assert ("7/10" in shown and "8/10" in shown) == terminal


def test_tasks_in_silence(capsys):
    assert run(abs, {"seed 0": -1}, progress=False).results == {"seed 0": 1}
    assert capsys.readouterr() == ("", "")
