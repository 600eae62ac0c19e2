"""Progress of long computations, in terminals, notebooks and log files."""

import time
from typing import Any, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)

LOG_EVERY = 10.0
"""Seconds between two lines of a log, where no bar can be drawn."""

_PACE_PERIOD = 3600.0  # seconds over which the pace is averaged, for the remaining time


class ProgressDisplay:
    """Bar in a terminal or notebook; occasional lines elsewhere, so that log files stay short.

    Parameters
    ----------
    description : str
        Text before the bar.
    total, done : int
        Steps of the whole run, and steps completed before it started.
    columns : iterable of rich.progress.ProgressColumn
        Columns of the bar after its count.
    console : rich.console.Console, optional
        Where to write; by default the standard error stream, so that results on the
        standard output stay clean.
    **fields
        Initial values of the columns' own fields.
    """

    def __init__(
        self,
        description: str,
        total: int,
        done: int = 0,
        columns: tuple[ProgressColumn, ...] = (),
        console: Console | None = None,
        **fields: Any,
    ) -> None:
        self._console = console or Console(stderr=True)
        self._draws = self._console.is_terminal or self._console.is_jupyter
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            *columns,
            console=self._console,
            get_time=time.monotonic,
            speed_estimate_period=_PACE_PERIOD,
            disable=not self._draws,
            # Without a thread that redraws: Python may collect garbage in any thread, and
            # objects of Julia must be released only in the thread that runs Julia.
            auto_refresh=False,
        )
        self._task = self._bar.add_task(description, total=total, completed=done, **fields)
        self._total, self._first, self._done = total, done, done
        self._began = self._last = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._bar.stop()

    def _is_due(self, now: float, draw_every: float = 0.0) -> bool:
        """Return whether output is due at the time ``now`` (s), and note it if so.

        The bar is due every ``draw_every`` seconds, a line of a log every ``LOG_EVERY``.
        """
        if now - self._last < (draw_every if self._draws else LOG_EVERY):
            return False
        self._last = now
        return True

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


class TaskProgress(ProgressDisplay):
    """Progress of many independent tasks, with elapsed and remaining time.

    Parameters
    ----------
    total, done : int
        Tasks of the whole run, and tasks completed before it started.
    console : rich.console.Console, optional
        Where to write; by default the standard error stream.
    """

    def __init__(self, total: int, done: int = 0, console: Console | None = None) -> None:
        super().__init__("tasks", total, done, (TimeElapsedColumn(),), console)

    def __call__(self, name: str, failure: str | None = None) -> None:
        """Count a task that has finished, or failed permanently."""
        self._done += 1
        now = time.monotonic()
        elapsed = now - self._began
        left = elapsed / (self._done - self._first) * (self._total - self._done)
        if self._draws:
            description = f"tasks, remaining {left:.0f} s"
            self._bar.update(self._task, completed=self._done, description=description)
            self._bar.refresh()
        if failure is not None or (not self._draws and self._is_due(now)):
            outcome = "done" if failure is None else f"failed: {failure}"
            self._print(
                f"{self._done} of {self._total} tasks: {name} {outcome}, elapsed {elapsed:.0f} s, "
                f"remaining {left:.0f} s"
            )
