"""Entry point of the command line ``pcnde``: names and order of the commands, exit codes.

Exit codes: 0 success, 2 invalid use or input, 1 other failure, 130 interrupted.
"""

from __future__ import annotations

import io
import logging
import os
import sys
import warnings
from collections.abc import Callable
from typing import Any

import typer
import typer.core

from pcnde_bridge._utils import interrupts
from pcnde_bridge._version import __version__
from pcnde_bridge.cli import data, predict, train
from pcnde_bridge.cli.console import INTERRUPTED, note, note_warning, say
from pcnde_bridge.cli.options import option
from pcnde_bridge.errors import FileError, InputError, PCNDEError


class _Group(typer.core.TyperGroup):
    """Group of commands that exits with 130 after Ctrl-C."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            note("\nInterrupted.")
            raise typer.Exit(INTERRUPTED) from None


_COMMANDS: dict[str, Callable[..., None]] = {
    "fit": train.fit,
    "cross-validate": train.cross_validate,
    "info": predict.info,
    "evaluate": predict.evaluate,
    "predict": predict.predict,
    "demo": train.demo,
    "simulate": data.simulate,
    "design": data.design,
    "convert": data.convert,
    "bench": train.bench,
    "app": predict.explore,
    "figures": predict.figures,
    "download": data.download,
    "doctor": data.doctor,
}
"""Commands in the order of ``pcnde --help``."""

app = typer.Typer(
    cls=_Group,
    help="One-dimensional blood-flow models that learn from 3D simulation (PCNDE).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _name, _command in _COMMANDS.items():
    app.command(_name)(_command)


@app.callback(invoke_without_command=True)
def _global_options(
    version: bool = option(False, "Print the version.", "--version"),
    verbose: bool = option(False, "Verbose output.", "--verbose", "-v"),
) -> None:
    logging.basicConfig(format="%(message)s", level=logging.DEBUG if verbose else logging.WARNING)
    logging.getLogger("pcnde_bridge").setLevel(logging.DEBUG if verbose else logging.INFO)
    for noisy in ("jax", "matplotlib"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    if version:
        say(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; errors become messages and exit codes, warnings become notes."""
    warnings.showwarning = note_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with interrupts.watched():
            app()
    except PCNDEError as error:
        note("Error:", style="bold red", end=" ")
        note(str(error))
        sys.exit(2 if isinstance(error, InputError | FileError) else 1)
    except BrokenPipeError:
        # The reader of the pipe is gone; without this the interpreter complains at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def run() -> None:
    """Run the command line in its own process."""
    try:
        main()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            # JAX crashes at the interpreter's exit if it was interrupted while compiling.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        raise
