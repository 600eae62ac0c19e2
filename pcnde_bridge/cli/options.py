"""Arguments and options that several commands share."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from pcnde_bridge._utils.files import check_writable, reading
from pcnde_bridge.config import PRESETS, Config, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError


def option(default: Any, help: str, *names: str, **settings: Any) -> Any:
    """Return an option with its default (``...``: required) and its help text.

    Without names, it has the name of its parameter.
    """
    return typer.Option(default, *names, help=help, **settings)


DATA = typer.Argument(
    metavar="DATA",
    help="Folder in the authors' layout, a saved data set (.npz, .h5), or a name: published, "
    "synthetic.",
)
MODEL = typer.Argument(metavar="MODEL", help="File of a fitted model.")
SPLIT = option(
    "paper",
    "'paper', 'none' (all cases are training cases), or a JSON file "
    '{"train": [[G, W], ...], "test": [...]}.',
)
PRESET = option("paper", f"Preset: {', '.join(PRESETS)}.")
CONFIG = option(None, "JSON file of settings that differ from the preset.", "--config")
SEED = option(0, "Random seed for the initial weights and the batch order.", min=0)
ENGINE = option("auto", "Compute engine.")
UNITS = option(None, "cgs, mm-g-s, si, or the units not in CGS: pressure=mmHg,z=mm.")
WORKERS = option(1, "Number of parallel processes.", min=1)
JSON = option(None, "Also write the results to this JSON file.", "--json")


def settings_of(preset: str, path: Path | None) -> Config:
    """Return the settings of ``--preset`` with the changes of ``--config``."""
    settings = resolve_config(preset)
    if path is None:
        return settings
    with reading(path, "a JSON file of settings"):
        changes = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(changes, dict):
        raise InputError(f"{path} must hold a JSON object of settings.")
    return settings.replace(**changes)


def split_of(cases: Cases, split: str) -> dict[str, Cases]:
    """Return the sets of ``--split``: train, and test unless the split is ``none``."""
    return {"train": cases} if split == "none" else cases.split(split)._asdict()


def check_outputs(*paths: Path | None, size: int = 0, inputs: Sequence[Path] = ()) -> None:
    """Raise before any work if a file cannot be written or would replace another one."""
    known = {path.resolve() for path in inputs}
    for path in filter(None, paths):
        if path.resolve() in known:
            raise InputError(f"{path} is named twice: it would be overwritten.")
        known.add(path.resolve())
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
