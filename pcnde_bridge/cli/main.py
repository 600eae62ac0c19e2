"""The command line ``pcnde``.

Its commands are functions of :mod:`pcnde_bridge.cli.data`, :mod:`pcnde_bridge.cli.train` and
:mod:`pcnde_bridge.cli.predict`; here they get their names and their order.

Exit codes: 0 good, 2 bad use or input, 1 failure, 130 interrupted.
"""

from __future__ import annotations

import io
import logging
import os
import sys
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import typer
import typer.core

from pcnde_bridge._utils import interrupts
from pcnde_bridge._version import __version__
from pcnde_bridge.cli import (
    data as prepare,
)
from pcnde_bridge.cli import (
    predict as use,
)
from pcnde_bridge.cli import (
    train,
)
from pcnde_bridge.cli.console import (
    INTERRUPTED,
    note,
    note_warning,
    say,
)
from pcnde_bridge.errors import (
    FileError,
    InputError,
    PCNDEError,
)


class _Group(typer.core.TyperGroup):
    """Ends with 130 after Ctrl-C, at whatever moment it came."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            note("\nInterrupted.")
            raise typer.Exit(INTERRUPTED) from None


_COMMANDS: dict[str, Callable[..., None]] = {
    "fit": train.fit,
    "cross-validate": train.cross_validate,
    "info": use.info,
    "evaluate": use.evaluate,
    "predict": use.predict,
    "demo": train.demo,
    "simulate": prepare.simulate,
    "convert": prepare.convert,
    "bench": train.bench,
    "app": use.explore,
    "figures": use.figures,
    "download": prepare.download,
    "doctor": prepare.doctor,
}
"""In the order of ``pcnde --help``."""

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
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say more.")] = False,
) -> None:
    logging.basicConfig(format="%(message)s", level=logging.DEBUG if verbose else logging.WARNING)
    logging.getLogger("pcnde_bridge").setLevel(logging.DEBUG if verbose else logging.INFO)
    for noisy in ("jax", "matplotlib"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    if version:
        say(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line, turning errors into messages and exit codes, warnings into notes."""
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
        # The reader of a pipe has gone; keep the interpreter from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def run() -> None:
    """Run the command line in a process of its own."""
    try:
        main()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            # JAX, interrupted while it compiles, would crash when the interpreter ends.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        raise
