"""What the command line says: results on standard output, notes on standard error.

Text is printed as it stands, since file names may hold anything: ``model[fast].npz`` is no
markup, and a long path is not broken into lines.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TextIO

import typer
from rich.console import Console
from rich.table import Table


def _plain(*, stderr: bool) -> Console:
    return Console(stderr=stderr, markup=False, emoji=False, highlight=False, soft_wrap=True)


_out, _notes = _plain(stderr=False), _plain(stderr=True)

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def say(text: str, *, style: str | None = None, end: str = "\n") -> None:
    """Print a result."""
    _out.print(text, style=style, end=end)


def note(text: str, *, style: str | None = None, end: str = "\n") -> None:
    """Print what is no result: progress, warnings, errors."""
    _notes.print(text, style=style, end=end)


def show(table: Table) -> None:
    """Print a table, as wide as the terminal allows."""
    _out.print(table, soft_wrap=False)


def show_errors(errors: Mapping[str, Mapping[str, float]]) -> None:
    """Print relative errors: a line for each name, a column for each variable."""
    variables = list(next(iter(errors.values())))
    table = Table("relative error", *variables)
    for name, row in errors.items():
        table.add_row(name, *(f"{row[variable]:.4f}" for variable in variables))
    show(table)


def note_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Say what the package warns of without the line of code that Python would show."""
    if category.__module__.partition(".")[0] == "pcnde_bridge":
        text = str(message)
    else:
        text = warnings.formatwarning(message, category, filename, lineno, line)
    note(f"Warning: {text}")


def interrupted(where: str) -> typer.Exit:
    """Say where an interrupted run can continue, and return the exit to raise."""
    note(f"\nInterrupted. {where}: run the same command again to continue.")
    return typer.Exit(INTERRUPTED)
