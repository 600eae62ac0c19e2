"""Progress of long work, in terminals, notebooks and log files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from pcnde_bridge._utils import interrupts
from pcnde_bridge.training.history import Iteration, OnRecord

_LOG_EVERY = 10.0  # seconds between two lines where no bar can be drawn
_DRAW_EVERY = 0.1  # seconds between two pictures of the bar


class TrainingProgress:
    """Shows stage, loss, elapsed and remaining time of a training run.

    Where the output is a terminal or a notebook this is a bar, elsewhere a line
    now and then, so that log files stay short.

    Parameters
    ----------
    total, done : int
        Iterations of the whole run, and of them those done before.
    console : rich.console.Console, optional
        Where to write; by default the standard error stream, so that results
        on standard output stay clean.
    """

    def __init__(self, total: int, done: int = 0, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._draws = self._console.is_terminal or self._console.is_jupyter
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("loss {task.fields[loss]}"),
            TimeElapsedColumn(),
            TextColumn("<"),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._draws,
            # No thread that redraws: Python may collect garbage in any thread, and objects of
            # Julia must not be released in another than the one that runs Julia.
            auto_refresh=False,
        )
        self._task = self._bar.add_task("training", total=total, completed=done, loss="-")
        self._total, self._first, self._done = total, done, done
        self._began = self._last = time.monotonic()
        self._counted = 0.0  # when the first iteration of this run was done

    def __enter__(self) -> TrainingProgress:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self._bar.update(self._task, completed=self._total)
        self._bar.stop()

    def __call__(self, iteration: Iteration) -> None:
        """Count one iteration."""
        self._done += 1
        now = time.monotonic()
        if self._done == self._first + 1:
            self._counted = now
        stage = iteration.stage.replace("_", " ")
        where = f"{stage}, epoch {iteration.epoch}" if iteration.stage == "flow" else stage
        self._bar.update(
            self._task, completed=self._done, description=where, loss=f"{iteration.loss:.3e}"
        )
        if now - self._last < (_DRAW_EVERY if self._draws else _LOG_EVERY):
            return
        self._last = now
        if self._draws:
            self._bar.refresh()
        else:
            # Neither iterations of an earlier run nor compiling, which is before the first,
            # tell how long the others will take.
            counted = self._done - self._first - 1
            left = "unknown"
            if counted:
                pace = (now - self._counted) / counted
                left = f"{pace * (self._total - self._done):.0f} s"
            self._console.print(
                f"{where}: iteration {self._done} of {self._total}, loss {iteration.loss:.3e}, "
                f"elapsed {now - self._began:.0f} s, remaining {left}",
                highlight=False,
                soft_wrap=True,
            )


@contextmanager
def listening(progress: bool | OnRecord, total: int, done: int = 0) -> Iterator[OnRecord]:
    """Give what is called with every iteration: it looks for Ctrl-C, and tells whoever listens.

    Parameters
    ----------
    progress : bool or callable
        True shows a bar.
    total, done : int
        As of :class:`TrainingProgress`.
    """
    with ExitStack() as stack:
        look = stack.enter_context(interrupts.kept())
        hears: bool | OnRecord = progress
        if progress is True:
            hears = stack.enter_context(TrainingProgress(total, done))

        def on_record(iteration: Iteration) -> None:
            look()
            if callable(hears):
                hears(iteration)

        yield on_record
