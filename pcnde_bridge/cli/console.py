"""Console output: results on standard output; progress, warnings and errors on standard error.

Text is printed without markup and without line breaks, because file names may contain anything,
such as ``model[fast].npz``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pandas as pd
import typer
from rich.console import Console
from rich.table import Table

_PLAIN: dict[str, Any] = dict.fromkeys(("markup", "emoji", "highlight"), False)
_out, _notes = (Console(stderr=stderr, soft_wrap=True, **_PLAIN) for stderr in (False, True))

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

_SHORT_TITLES = {"pressure_drop": "drop", "one_minus_ffr": "1 − FFR"}
"""Titles of columns of errors that would be too long for a narrow terminal."""


def say(text: str, *, style: str | None = None, end: str = "\n") -> None:
    """Print a result."""
    _out.print(text, style=style, end=end)


def note(text: str, *, style: str | None = None, end: str = "\n") -> None:
    """Print progress, a warning or an error."""
    _notes.print(text, style=style, end=end)


def show(table: Table) -> None:
    """Print a table as wide as the terminal allows."""
    _out.print(table, soft_wrap=False)


def show_errors(errors: pd.DataFrame, padding: int | tuple[int, int] = (0, 1)) -> None:
    """Print relative errors: a line for each row, a column for each variable; texts as they are."""
    titles = errors.rename(columns=_SHORT_TITLES).columns
    table = Table("relative error", *titles, padding=padding)
    for name, *values in errors.itertuples():
        table.add_row(name, *(v if isinstance(v, str) else f"{v:.4f}" for v in values))
    show(table)


def note_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any, **__: Any
) -> None:
    """Print a warning of the package without the line of code that Python would show."""
    if category.__module__.partition(".")[0] == "pcnde_bridge":
        text = str(message)
    else:
        text = warnings.formatwarning(message, category, filename, lineno)
    note(f"Warning: {text}")


@contextmanager
def resumable(stored: str) -> Iterator[None]:
    """On Ctrl-C inside the block, report how to resume, and exit."""
    try:
        yield
    except KeyboardInterrupt:
        note(f"\nInterrupted. {stored}: run the same command again to continue.")
        raise typer.Exit(INTERRUPTED) from None
