"""Arguments and options that several commands share."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pcnde_bridge._utils.files import check_writable
from pcnde_bridge.config import PRESETS, Config, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import EngineName
from pcnde_bridge.errors import FileError, InputError


def option(help: str, *names: str, **settings: Any) -> Any:
    """Return an option with its help text; without names it has that of its parameter."""
    return typer.Option(*names, help=help, **settings)


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
    option(
        "'paper', 'none' (all cases are training cases), or a JSON file "
        '{"train": [[G, W], ...], "test": [...]}.'
    ),
]
PresetOption = Annotated[str, option(f"Preset: {', '.join(PRESETS)}.")]
ConfigOption = Annotated[
    Path | None, option("JSON file of settings that differ from the preset.", "--config")
]
SeedOption = Annotated[
    int, option("Random seed for the initial weights and the batch order.", min=0)
]
EngineOption = Annotated[EngineName, option("Compute engine.")]
UnitsOption = Annotated[
    str | None,
    option("cgs, mm-g-s, si, or the units not in CGS: pressure=mmHg,z=mm."),
]
WorkersOption = Annotated[int, option("Number of parallel processes.", min=1)]
JsonOption = Annotated[Path | None, option("Also write the results to this JSON file.", "--json")]


def settings_of(preset: str, path: Path | None) -> Config:
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


def split_of(cases: Cases, split: str) -> dict[str, Cases]:
    """Return the sets of ``--split``: train, and test unless the split is ``none``."""
    return {"train": cases} if split == "none" else cases.split(split)._asdict()


def check_outputs(*paths: Path | None, size: int = 0, inputs: Sequence[Path] = ()) -> None:
    """Raise before any work if a file cannot be written or would replace another one."""
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


def name_pairs(text: str | None, option: str) -> dict[str, str] | None:
    """Parse name=value,name=value."""
    if text is None:
        return None
    parts = [part.partition("=") for part in text.split(",")]
    if not all(name and value for name, _, value in parts):
        raise InputError(f"{option} must look like flow=…,pressure=…, got {text!r}.")
    return {name: value for name, _, value in parts}


def units_of(text: str | None) -> str | dict[str, str] | None:
    """Return the units of ``--units``: a system of units, or units by quantity."""
    return name_pairs(text, "--units") if text and "=" in text else text
