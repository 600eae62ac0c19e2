"""Console output: results on standard output; progress, warnings and errors on standard error.

Text is printed without markup and without line breaks, because file names may contain anything,
such as ``model[fast].npz``.
"""

from __future__ import annotations

import logging
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    import pandas as pd

_PLAIN: dict[str, Any] = dict.fromkeys(("markup", "emoji", "highlight"), False)
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class _Console(Console):
    """Console without control characters, with which text of a file could change the terminal."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(_CONTROL.sub("", text), **options)


_out, _notes = (_Console(stderr=stderr, soft_wrap=True, **_PLAIN) for stderr in (False, True))

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

_SHORT_TITLES = {
    "wall_shear_stress": "WSS",
    "pressure_drop": "drop",
    "one_minus_ffr": "1 − FFR",
    "time_averaged_wall_shear_stress": "TAWSS",
}
"""Titles of columns of errors that would be too long for a narrow terminal."""


def say(text: str, *, style: str | None = None, end: str = "\n") -> None:
    """Print a result."""
    _out.print(text, style=style, end=end)


def note(text: str, *, style: str | None = None, end: str = "\n") -> None:
    """Print progress, a warning or an error."""
    _notes.print(text, style=style, end=end)


class Notes(logging.Handler):
    """Handler that prints messages of loggers as notes."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a message."""
        note(self.format(record))


def show(table: Table) -> None:
    """Print a table as wide as the terminal allows."""
    _out.print(table, soft_wrap=False)


def show_numbers(
    numbers: pd.DataFrame, title: str = "relative error", digits: int = 4, padding: int = 1
) -> None:
    """Print a line for each row, a column for each variable; a dash for no number."""
    titles = numbers.rename(columns=_SHORT_TITLES).columns
    table = Table(title, *titles, padding=(0, padding, 0, 0))
    for name, *values in numbers.itertuples():
        table.add_row(name, *("–" if math.isnan(v) else f"{v:.{digits}f}" for v in values))
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
