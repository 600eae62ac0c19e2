"""Entry point of the command line ``pcnde``: names and order of the commands, exit codes.

Exit codes: 0 success, 2 invalid use or input, 1 other failure, 130 interrupted.
"""

import contextlib
import errno
import gc
import io
import logging
import os
import platform
import shlex
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

import typer
import typer.core

from pcnde_bridge._utils import interrupts
from pcnde_bridge._version import __version__
from pcnde_bridge.cli import data, predict, train
from pcnde_bridge.cli.console import INTERRUPTED, Notes, note, note_warning, say
from pcnde_bridge.cli.options import locks, option
from pcnde_bridge.errors import FileError, InputError, PCNDEError

_OUTPUT_FAILS = {errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EIO}


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
    level = logging.DEBUG if verbose else logging.WARNING
    logging.basicConfig(format="%(message)s", level=level, handlers=[Notes()])
    logging.getLogger("pcnde_bridge").setLevel(logging.DEBUG if verbose else logging.INFO)
    for noisy in ("jax", "matplotlib"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    if version:
        say(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; errors become messages and exit codes, warnings become notes."""
    warnings.showwarning = note_warning
    os.environ["MPLBACKEND"] = "agg"  # figures are files here, also in the terminal of a notebook
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with interrupts.watched(), locks:
            _check_working_folder()
            app()
    except PCNDEError as error:
        _fail(str(error), 2 if isinstance(error, InputError | FileError) else 1)
    except Exception as error:
        # Errors of files have messages of their own; what remains is the standard output.
        if not isinstance(error, OSError) or error.errno not in _OUTPUT_FAILS:
            _fail(_unexpected(error), 1)
        # Without this the interpreter complains at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno != errno.EPIPE:  # the reader of a pipe may end when it has seen enough
            _fail(f"the output cannot be written: {error.strerror}.", 1)
        sys.exit(1)


def _check_working_folder() -> None:
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise FileError("The working folder was removed: change to another one.") from error


def _fail(message: str, code: int) -> NoReturn:
    note("Error:", style="bold red", end=" ")
    note(message)
    sys.exit(code)


def _unexpected(error: Exception) -> str:
    """Write a report about an error that no message was written for; return a line about it."""
    packages = ("numpy", "pandas", "scipy", "jax", "h5py", "juliacall")
    versions = []
    for name in packages:
        with contextlib.suppress(PackageNotFoundError):
            versions.append(f"{name} {version(name)}")
    facts = [f"pcnde_bridge {__version__}", f"Python {sys.version}", platform.platform(), *versions]
    text = "\n".join([shlex.join(sys.argv), *facts, *traceback.format_exception(error)])
    [what, *_] = traceback.format_exception_only(error)[-1].splitlines()
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="pcnde-report-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
    except OSError as no_file:
        return f"unexpected {what} (no report could be written: {no_file})"
    return f"unexpected {what}. Please send the report {file.name} to the developers."


def run() -> None:
    """Run the command line in its own process."""
    # JAX creates millions of permanent objects: the search for garbage takes a tenth of the time.
    gc.set_threshold(50_000, 20, 100)
    # JAX cannot store functions with diffrax's checks of its arguments, which are callbacks.
    os.environ.setdefault("EQX_ON_ERROR", "off")
    try:
        main()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            # JAX crashes at the interpreter's exit if it was interrupted while compiling.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        raise
