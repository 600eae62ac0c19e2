"""The commands before any training: simulate, convert and download data, doctor."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from pcnde_bridge._version import __version__
from pcnde_bridge.cli.console import say
from pcnde_bridge.cli.options import check_outputs
from pcnde_bridge.errors import InputError, PCNDEError


class FileFormat(StrEnum):
    """Files that ``pcnde convert`` reads."""

    simvascular = "simvascular"
    sv1d = "sv1d"
    csv = "csv"
    hdf5 = "hdf5"


class Flip(StrEnum):
    """What ``pcnde convert --flip`` turns."""

    flow = "flow"
    z = "z"


DataSetOption = Annotated[Path, typer.Option("--out", help="File for the data set: .npz or .h5.")]


def simulate(
    out: DataSetOption,
    geometries: Annotated[
        int, typer.Option("--geometries", min=1, help="Blockages, evenly from 40 to 85 %.")
    ] = 10,
    waveforms: Annotated[
        int, typer.Option("--waveforms", min=1, help="Waveforms, ever stronger.")
    ] = 10,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="0: built-in waveform; else a variation of it.")
    ] = 0,
) -> None:
    """Simulate stenosed vessels by the 1D solver (synthetic)."""
    from pcnde_bridge.hemodynamics.synthetic import synthetic

    _check_data_set(out)
    cases = synthetic(geometries, waveforms, seed)
    cases.save(out)
    say(f"Saved {cases!r} in {out}.")


def convert(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="simvascular: .vtp centerlines with averaged results. sv1d: svOneDSolver's input "
            "files (.in), results beside them. csv: tidy tables. hdf5: data sets by name.",
        ),
    ],
    source: Annotated[FileFormat, typer.Option("--from", help="Who wrote the files.")],
    out: DataSetOption,
    labels: Annotated[
        Path | None,
        typer.Option("--labels", help="CSV: file, geometry, waveform, …; one row for each file."),
    ] = None,
    period: Annotated[
        float | None, typer.Option("--period", help="Of the cycle, s; takes the last whole one.")
    ] = None,
    time_step: Annotated[
        float | None, typer.Option("--time-step", help="Of the 3D simulation, s (simvascular).")
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(
            "--units",
            help="cgs, mm-g-s or si, or those that are not CGS: pressure=mmHg,z=mm.",
        ),
    ] = None,
    flip: Annotated[
        Flip | None, typer.Option("--flip", help="Turn the flow's sign, or the vessel's ends.")
    ] = None,
    time_points: Annotated[
        int | None,
        typer.Option("--time-points", help="Resample the cycle to this number of equal steps."),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            help="Resample the vessel to so many points, both ends among them.",
        ),
    ] = None,
    branch: Annotated[
        int | None, typer.Option("--branch", help="BranchId of the vessel (simvascular).")
    ] = None,
    rigid: Annotated[
        bool, typer.Option("--rigid", help="The walls were rigid (simvascular).")
    ] = False,
    segments: Annotated[
        str | None, typer.Option("--segments", help="Of the vessel, a,b,c from its inlet (sv1d).")
    ] = None,
    names: Annotated[
        str | None, typer.Option("--names", help="Of data sets: flow=/Q,pressure=/P (hdf5).")
    ] = None,
) -> None:
    """Make a data set of other programs' results.

    Doubtful ones are refused, with what to do.
    """
    from pcnde_bridge import io as formats

    _check_data_set(out, files)
    own: dict[str, dict[str, Any]] = {
        "simvascular": {"time_step": time_step, "branch": branch, "rigid": rigid or None},
        "sv1d": {"segments": None if segments is None else segments.split(",")},
        "csv": {},
        "hdf5": {"names": _pairs(names, "--names")},
    }
    for other, options in own.items():
        asked = [name for name, value in options.items() if value is not None]
        if other != source.value and asked:
            raise InputError(
                f"--{asked[0].replace('_', '-')} goes with --from {other}, not {source.value}."
            )
    chosen = {name: value for name, value in own[source.value].items() if value is not None}
    read = getattr(formats, f"read_{source.value}")
    cases = read(
        files,
        **chosen,
        period=period,
        units=_pairs(units, "--units") if units and "=" in units else units,
        flip=flip and flip.value,
        time_points=time_points,
        points=points,
        labels=None if labels is None else formats.read_labels(labels, files),
    )
    cases.save(out)
    say(f"Saved {cases!r} in {out}.")


def download(
    folder: Annotated[
        Path | None, typer.Option("--cache", help="Where to put the files; default the cache.")
    ] = None,
) -> None:
    """Download the published data set (100 cases, about 50 MB)."""
    from pcnde_bridge.io.datasets import download_published

    say(f"The data set is in {download_published(folder)}.")


def doctor() -> None:
    """Tell what is usable on this machine, and what else to do."""
    from pcnde_bridge.cli.doctor import examine

    findings = examine()
    say(f"pcnde_bridge {__version__}")
    for finding in findings:
        mark, style = ("✓", "green") if finding.good else ("–", "yellow")
        say(mark, style=style, end=" ")
        say(f"{finding.what}: {finding.found}")
        if finding.advice:
            say(f"  → {finding.advice}")
    if not any(finding.good for finding in findings if finding.is_engine):
        raise PCNDEError("No engine is usable: nothing can be computed on this machine.")


def _pairs(text: str | None, option: str) -> dict[str, str] | None:
    """Read name=value,name=value."""
    if text is None:
        return None
    parts = [part.partition("=") for part in text.split(",")]
    if not all(name and value for name, _, value in parts):
        raise InputError(f"{option} must look like flow=…,pressure=…, got {text!r}.")
    return {name: value for name, _, value in parts}


def _check_data_set(path: Path, inputs: Sequence[Path] = ()) -> None:
    if path.suffix.lower() not in (".npz", ".h5", ".hdf5"):
        raise InputError(f"Cannot tell the format of {path}: it must end in .npz or .h5.")
    check_outputs(path, inputs=inputs)
