"""Progress of many independent tasks, in terminals, notebooks and log files."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

_LOG_EVERY = 10.0  # seconds between two lines where no bar can be drawn


class TaskProgress:
    """Shows how many of some tasks are done, with elapsed and remaining time.

    Parameters
    ----------
    total, done : int
        Tasks of the whole run, and of them those done before.
    show : bool
        False shows nothing.
    console : rich.console.Console, optional
        Where to write; the standard error stream by default.
    """

    def __init__(
        self, total: int, done: int = 0, show: bool = True, console: Console | None = None
    ) -> None:
        self._console = console or Console(stderr=True)
        self._draws = self._console.is_terminal or self._console.is_jupyter
        self._show = show
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=self._console,
            disable=not (self._draws and show),
            auto_refresh=False,  # no thread that redraws: see pcnde_bridge.training.progress
        )
        self._task = self._bar.add_task("tasks", total=total, completed=done)
        self._total, self._first, self._done = total, done, done
        self._began = self._last = time.monotonic()

    def __enter__(self) -> TaskProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, name: str, failure: str | None = None) -> None:
        """Count a task that is finished, or failed for good."""
        self._done += 1
        if not self._show:
            return
        now = time.monotonic()
        elapsed = now - self._began
        left = elapsed / (self._done - self._first) * (self._total - self._done)
        remaining = f"remaining {left:.0f} s"
        if self._draws:
            self._bar.update(self._task, completed=self._done, description=f"tasks, {remaining}")
            self._bar.refresh()
        due = now - self._last >= _LOG_EVERY and not self._draws
        if failure is not None or due:
            self._last = now
            what = "done" if failure is None else f"failed: {failure}"
            self._console.print(
                f"{self._done} of {self._total} tasks: {name} {what}, elapsed {elapsed:.0f} s, "
                f"{remaining}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )
