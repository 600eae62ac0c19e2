"""Arguments and options that several commands share."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from pcnde_bridge._utils.files import check_writable, locked, make_folder, read_json
from pcnde_bridge.cli.console import note
from pcnde_bridge.config import PRESETS, Config, resolve_config
from pcnde_bridge.errors import InputError

if TYPE_CHECKING:
    from pcnde_bridge.data.cases import Cases, Split
    from pcnde_bridge.hemodynamics.outlet import Outlet

locks = contextlib.ExitStack()
"""Locks of the files that a command writes; released when it ends."""


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
    None,
    "Test cases: 'paper'; 'none'; a fraction of the cases, at random (0.2); values of a label "
    '(geometry=9,10); or a JSON file {"train": [[G, W], ...], "test": [...]}. By default, '
    "'paper' for published and synthetic, else 'none'.",
)
PRESET = option("paper", f"Preset: {', '.join(PRESETS)}.")
CONFIG = option(None, "JSON file of settings that differ from the preset.", "--config")
SEED = option(0, "Random seed for the initial weights and the batch order.", min=0)
ENGINE = option("auto", "Compute engine.")
UNITS = option(
    None,
    "cgs, mm-g-s, si, or the units not in CGS: pressure=mmHg,z=mm. Radii or diameters in place "
    "of areas: radius=mm, diameter=cm. cgs,area=cm^2: CGS units, and areas are areas.",
)
OUTLET = option(
    None,
    'JSON file of an outlet (preset physics), such as {"kind": "Windkessel", "resistance": 1e4}.',
    "--outlet",
)
WORKERS = option(1, "Number of parallel processes.", min=1)
JSON = option(None, "Also write the results to this JSON file.", "--json")


def table_file(path: Path | None) -> Path | None:
    """Return the name of a table to write, after checking its ending."""
    if path is not None and not path.name.lower().endswith((".csv", ".csv.gz")):
        raise InputError(f"{path} will be a table: its name must end in .csv or .csv.gz.")
    return path


CSV = option(None, "Also write the table to this CSV file.", "--csv", callback=table_file)


def settings_of(preset: str, path: Path | None) -> Config:
    """Return the settings of ``--preset`` with the changes of ``--config``."""
    settings = resolve_config(preset)
    return settings if path is None else settings.replace(**read_json(path, "settings"))


def outlet_of(path: Path | None) -> Outlet | None:
    """Return the outlet of ``--outlet``."""
    from pcnde_bridge.hemodynamics.outlet import outlet_from

    return None if path is None else outlet_from(read_json(path, "an outlet"))


def split_name(data: str, split: str | None) -> str:
    """Return ``--split``: by default, only data sets with a split of their own are divided."""
    from pcnde_bridge.io.datasets import DATASETS

    return split if split is not None else "paper" if data in DATASETS else "none"


def split_of(cases: Cases, data: str, split: str | None, whole: str = "train") -> dict[str, Cases]:
    """Return the sets of ``--split``: train and test, or ``whole`` without a split."""
    from pcnde_bridge._utils.validation import counted

    if (split := split_name(data, split)) == "none":
        use = "training cases" if whole == "train" else "evaluated"
        note(f"All {counted(len(cases), 'case')} are {use}: --split holds out test cases.")
        return {whole: cases}
    sets = _divided(cases, split)._asdict()
    train = counted(len(sets["train"]), "training case")
    note(f"The split {split} has {train} and {counted(len(sets['test']), 'test case')}.")
    return sets


def _divided(cases: Cases, split: str) -> Split:
    """Divide the cases by a fraction, by ``label=value,…``, or as :meth:`Cases.split` does."""
    from pandas.api.types import is_numeric_dtype

    from pcnde_bridge.data.selection import label_values

    name, equals, text = split.partition("=")
    if not split:
        raise InputError("--split is empty: leave it out, or give 'none'.")
    if equals and not Path(split).exists():
        convert = _number if is_numeric_dtype(label_values(cases.labels, name)) else str
        wanted: dict[str, Any] = {name: [convert(value) for value in text.split(",")]}
        return cases.split(**wanted)
    return cases.split(_number(split))


def _number(text: str) -> float | str:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def check_outputs(*paths: Path | None, size: int = 0, inputs: Sequence[Path] = ()) -> None:
    """Lock the files that a command writes.

    It raises before any work if a file cannot be written or would replace another one.
    """
    known = {os.path.realpath(path) for path in inputs}
    for path in filter(None, paths):
        if (real := os.path.realpath(path)) in known:
            raise InputError(f"{path} is named twice: it would be overwritten.")
        known.add(real)
        locks.enter_context(locked(path))
        check_writable(path, size)


def lock_folder(folder: Path) -> None:
    """Create the folder that a command writes, and lock it."""
    make_folder(folder)
    locks.enter_context(locked(folder))


def name_pairs(text: str | None, option: str) -> dict[str, str] | None:
    """Parse name=value,name=value."""
    if text is None:
        return None
    parts = [part.partition("=") for part in text.split(",")]
    if not all(name and value for name, _, value in parts):
        raise InputError(f"{option} must look like flow=…,pressure=…, got {text!r}.")
    return {name: value for name, _, value in parts}
