"""Arguments and options that several commands share, and what is made of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pcnde_bridge._utils.files import check_writable
from pcnde_bridge.config import (
    PRESETS,
    ClosureConfig,
    PCNDEConfig,
    resolve_config,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import FileError, InputError


class EngineChoice(StrEnum):
    """Engines that ``--engine`` knows."""

    auto = "auto"
    julia = "julia"
    jax = "jax"


DataArgument = Annotated[
    str,
    typer.Argument(
        metavar="DATA",
        help="Folder in the authors' layout, a saved data set (.npz, .h5), or a name: "
        "published, synthetic.",
    ),
]
ModelArgument = Annotated[Path, typer.Argument(metavar="MODEL", help="File of a fitted model.")]
SplitOption = Annotated[
    str,
    typer.Option(
        "--split",
        help="'paper', 'none' (everything is training), or a JSON file "
        '{"train": [[G, W], ...], "test": [...]}.',
    ),
]
PresetOption = Annotated[
    str, typer.Option("--preset", help=f"Settings by name: {', '.join(PRESETS)}.")
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="JSON file of settings that differ.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Of weights and batches.")]
EngineOption = Annotated[EngineChoice, typer.Option("--engine", help="Who computes.")]
WorkersOption = Annotated[
    int, typer.Option("--workers", min=1, help="Processes that compute at the same time.")
]


def settings_of(preset: str, path: Path | None) -> PCNDEConfig | ClosureConfig:
    """Return the settings of ``--preset`` with the changes of ``--config``."""
    settings = resolve_config(preset)
    if path is None:
        return settings
    try:
        changes = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"Cannot read settings from {path}: {error}.") from error
    if not isinstance(changes, dict):
        raise InputError(f"{path} must hold a JSON object of settings.")
    return settings.replace(**changes)


def split_of(cases: Cases, how: str) -> dict[str, Cases]:
    """Return the sets that ``--split`` makes of the cases: train, and test unless it is none."""
    return {"train": cases} if how == "none" else cases.split(how)._asdict()


def check_outputs(*paths: Path | None, size: int = 0, inputs: Sequence[Path] = ()) -> None:
    """Refuse files that cannot be written, or would replace one another, before any work."""
    known = {path.resolve() for path in inputs}
    for path in paths:
        if path is None:
            continue
        if path.resolve() in known:
            raise InputError(f"{path} is named twice: it would be overwritten.")
        known.add(path.resolve())
        if path.is_dir() or not path.parent.is_dir():
            raise FileError(f"Cannot write {path}: give a file in an existing folder.")
        check_writable(path, size)
