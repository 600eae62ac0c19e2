"""Progress of a training run, in terminals, notebooks and log files."""

import time

from rich.console import Console
from rich.progress import TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pcnde_bridge._utils.progress import ProgressDisplay
from pcnde_bridge.training.history import Iteration

_DRAW_EVERY = 0.1  # seconds between two updates of the bar


class TrainingProgress(ProgressDisplay):
    """Stage, loss, converged fits, elapsed and remaining time of a training run.

    Parameters
    ----------
    total, done : int
        Iterations of the whole run, and iterations completed before it started.
    console : rich.console.Console, optional
        Where to write; by default the standard error stream.
    """

    def __init__(self, total: int, done: int = 0, console: Console | None = None) -> None:
        fields = TextColumn("loss {task.fields[loss]}"), TextColumn("{task.fields[fits]}")
        columns = (*fields, TimeElapsedColumn(), TextColumn("<"), TimeRemainingColumn())
        super().__init__("training", total, done, columns, console=console, loss="-", fits="")
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
        now = time.monotonic()
        stage, loss = iteration.stage.replace("_", " "), f"{iteration.loss:.3e}"
        where = f"{stage}, epoch {iteration.epoch}" if iteration.stage == "flow" else stage
        self._bar.update(self._task, completed=self._done, total=self._total)
        self._bar.update(self._task, description=where, loss=loss)
        if not self._is_due(now, _DRAW_EVERY):
            return
        if self._draws:
            self._bar.refresh()
            return
        # Iterations of an earlier run, and compilation before the first one, do not count.
        seconds = self._bar.tasks[0].time_remaining
        left = "unknown" if seconds is None else f"{seconds:.0f} s"
        fits = f"converged {self._converged} of {self._fits} fits, " if self._fits else ""
        self._print(
            f"{where}: iteration {self._done} of {self._total}, loss {loss}, {fits}"
            f"elapsed {now - self._began:.0f} s, remaining {left}"
        )
