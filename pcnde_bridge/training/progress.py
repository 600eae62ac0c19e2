"""Progress of a training run, in terminals, notebooks and log files."""

import time

from rich.console import Console
from rich.progress import TextColumn, TimeElapsedColumn

from pcnde_bridge._utils.progress import ProgressDisplay
from pcnde_bridge.training.history import Iteration

_DRAW_EVERY = 0.1  # seconds between two updates of the bar


class TrainingProgress(ProgressDisplay):
    """Stage, loss, converged fits, elapsed and remaining time of a training run.

    Parameters
    ----------
    total, done : int
        Iterations of the whole run, and iterations completed before it started.
    slow : tuple of int and float
        How many iterations at the end take longer, and how many times as long.
    console : rich.console.Console, optional
        Where to write; by default the standard error stream.
    """

    def __init__(
        self,
        total: int,
        done: int = 0,
        slow: tuple[int, float] = (0, 1.0),
        console: Console | None = None,
    ) -> None:
        loss, fits, left = (TextColumn(f"{{task.fields[{f}]}}") for f in ("loss", "fits", "left"))
        columns = (
            TextColumn("loss"),
            loss,
            fits,
            TimeElapsedColumn(),
            TextColumn("remaining"),
            left,
        )
        texts = {"loss": "-", "fits": "", "left": "unknown"}
        super().__init__("training", total, done, columns, console=console, **texts)
        self._slow = slow
        self._timed_from: tuple[float, float] | None = None  # time and work of the first iteration
        self._compiles_from: float | None = None
        self._fits, self._converged = 0, 0
        self._begun: set[str] = set()

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        if kind is None:
            self._bar.update(self._task, completed=self._total)
        super().__exit__(kind, *details)

    def on_step(self, task: str) -> None:
        """Show a task that begins: its functions are compiled before the first iteration."""
        if task in self._begun:
            return
        self._begun.add(task)
        self._compiles_from = time.monotonic()
        line = f"{task.replace('_', ' ')}: compiling"
        self._bar.update(self._task, description=line)
        if self._draws:
            self._bar.refresh()
        else:
            self._print(line)

    def on_fit_end(self, outcome: str) -> None:
        """Count a fit that has ended, with its outcome as the history has it."""
        self._fits += 1
        self._converged += outcome.startswith("converged")
        self._bar.update(self._task, fits=f"converged {self._converged}/{self._fits}")

    def __call__(self, iteration: Iteration) -> None:
        """Count one iteration."""
        self._done += 1
        self._total = max(self._total, self._done)
        now, left = time.monotonic(), self._remaining()
        stage, loss = iteration.stage.replace("_", " "), f"{iteration.loss:.3e}"
        where = f"{stage}, epoch {iteration.epoch}" if iteration.stage == "flow" else stage
        self._bar.update(self._task, completed=self._done, total=self._total)
        self._bar.update(self._task, description=where, loss=loss, left=left)
        if not self._is_due(now, _DRAW_EVERY):
            return
        if self._draws:
            self._bar.refresh()
            return
        fits = f"converged {self._converged} of {self._fits} fits, " if self._fits else ""
        self._print(
            f"{where}: iteration {self._done} of {self._total}, loss {loss}, {fits}"
            f"elapsed {now - self._began:.0f} s, remaining {left}"
        )

    def _remaining(self) -> str:
        """Return the remaining time.

        Iterations of an earlier run, and compilation before a task's first one, do not count.
        """
        now, work = time.monotonic(), self._work(self._done)
        began, before = self._timed_from or (now, work)
        if self._compiles_from is not None:
            began = min(now, began + now - self._compiles_from)
            self._compiles_from = None
        self._timed_from = began, before
        if work == before:
            return "unknown"
        return f"{(now - began) * (self._work(self._total) - work) / (work - before):.0f} s"

    def _work(self, iterations: int) -> float:
        """Return the time of the first iterations of the run, relative to that of the first."""
        count, duration = self._slow
        return iterations + (duration - 1) * max(0, iterations - (self._total - count))
