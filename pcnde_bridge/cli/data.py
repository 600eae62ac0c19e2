"""Commands about data and the machine: simulate, convert, download, doctor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from pcnde_bridge._version import __version__
from pcnde_bridge.cli.console import say
from pcnde_bridge.cli.options import UnitsOption, check_outputs, name_pairs, option, units_of
from pcnde_bridge.errors import InputError, PCNDEError

FileFormat = Literal["simvascular", "sv1d", "csv", "hdf5"]
DataSetOption = Annotated[Path, option("File for the data set: .npz or .h5.")]


def simulate(
    out: DataSetOption,
    geometries: Annotated[int, option("Number of blockages, from 40 to 85 %.", min=1)] = 10,
    waveforms: Annotated[int, option("Number of waveforms, of increasing amplitude.", min=1)] = 10,
    seed: Annotated[int, option("0: built-in waveform; others: variations of it.", min=0)] = 0,
) -> None:
    """Simulate stenosed vessels with the 1D solver."""
    from pcnde_bridge.hemodynamics.synthetic import synthetic

    _check_data_set(out)
    _save(synthetic(geometries, waveforms, seed), out)


def convert(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="simvascular: .vtp centerlines with averaged results. sv1d: input files of "
            "svOneDSolver (.in), results beside them. csv: tidy tables. hdf5: data sets by name.",
        ),
    ],
    source: Annotated[FileFormat, option("Program or format of the files.", "--from")],
    out: DataSetOption,
    labels: Annotated[
        Path | None, option("CSV with one row per file: file, geometry, waveform.")
    ] = None,
    period: Annotated[
        float | None, option("Cycle length, s; the last complete cycle is used.")
    ] = None,
    time_step: Annotated[
        float | None, option("Time step of the 3D simulation, s (simvascular).")
    ] = None,
    units: UnitsOption = None,
    flip: Annotated[
        Literal["flow", "z"] | None,
        option("Reverse the sign of the flow, or the direction of the vessel."),
    ] = None,
    time_points: Annotated[
        int | None, option("Resample the cycle to this number of steps.")
    ] = None,
    points: Annotated[int | None, option("Resample the vessel to this number of points.")] = None,
    branch: Annotated[int | None, option("BranchId of the vessel (simvascular).")] = None,
    rigid: Annotated[bool, option("The walls were rigid (simvascular).", "--rigid")] = False,
    segments: Annotated[str | None, option("Segments from the inlet: a,b,c (sv1d).")] = None,
    names: Annotated[
        str | None, option("Names of the data sets: flow=/Q,pressure=/P (hdf5).")
    ] = None,
) -> None:
    """Convert results of other programs into a data set.

    Ambiguous files are rejected with a suggested fix.
    """
    from pcnde_bridge import io

    _check_data_set(out, files)
    of_format: dict[str, dict[str, Any]] = {
        "simvascular": {"time_step": time_step, "branch": branch, "rigid": rigid or None},
        "sv1d": {"segments": None if segments is None else segments.split(",")},
        "csv": {},
        "hdf5": {"names": name_pairs(names, "--names")},
    }
    for name, values in of_format.items():
        given = [option for option, value in values.items() if value is not None]
        if name != source and given:
            wrong = given[0].replace("_", "-")
            raise InputError(f"--{wrong} is an option of --from {name}, not of {source}.")
    cases = getattr(io, f"read_{source}")(
        files,
        **{name: value for name, value in of_format[source].items() if value is not None},
        period=period,
        units=units_of(units),
        flip=flip,
        time_points=time_points,
        points=points,
        labels=None if labels is None else io.read_labels(labels, files),
    )
    _save(cases, out)


def download(
    folder: Annotated[
        Path | None, option("Folder of the files; by default the cache folder.", "--cache")
    ] = None,
) -> None:
    """Download the published data set (100 cases, about 50 MB)."""
    from pcnde_bridge.io.datasets import download_published

    say(f"The data set is in {download_published(folder)}.")


def doctor(
    load: Annotated[
        bool, option("Load Julia even if it must be compiled first (minutes).", "--load")
    ] = False,
) -> None:
    """Check engines and data on this machine and suggest fixes."""
    from pcnde_bridge.cli.doctor import examine

    findings = examine(load)
    say(f"pcnde_bridge {__version__}")
    for finding in findings:
        mark, style = ("✓", "green") if finding.good else ("–", "yellow")
        say(mark, style=style, end=" ")
        say(f"{finding.what}: {finding.found}")
        if finding.advice:
            say(f"  → {finding.advice}")
    if not any(finding.good for finding in findings if finding.is_engine):
        raise PCNDEError("No engine is usable: nothing can be computed on this machine.")


def _check_data_set(path: Path, inputs: Sequence[Path] = ()) -> None:
    if path.suffix.lower() not in (".npz", ".h5", ".hdf5"):
        raise InputError(f"Unknown format of {path}: the name must end in .npz or .h5.")
    check_outputs(path, inputs=inputs)


def _save(cases: Any, out: Path) -> None:
    cases.save(out)
    say(f"Saved {cases!r} in {out}.")
