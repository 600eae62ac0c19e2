"""Commands about data and the machine: simulate, convert, download, doctor."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import typer

from pcnde_bridge._version import __version__
from pcnde_bridge.cli import options
from pcnde_bridge.cli.console import say, show_numbers
from pcnde_bridge.cli.options import check_outputs, name_pairs, option
from pcnde_bridge.errors import InputError

FileFormat = Literal["simvascular", "sv1d", "csv", "hdf5"]
_OUT = option(..., "File for the data set: .npz or .h5.")


def simulate(
    out: Path = _OUT,
    geometries: int = option(10, "Number of blockages, from 40 to 85 %.", min=1),
    waveforms: int = option(10, "Number of waveforms, of increasing amplitude.", min=1),
    seed: int = option(0, "0: built-in waveform; others: variations of it.", min=0),
) -> None:
    """Simulate stenosed vessels with the 1D solver."""
    from pcnde_bridge.hemodynamics.synthetic import synthetic

    _check_data_set(out)
    _save(synthetic(geometries, waveforms, seed), out)


def convert(
    files: list[Path] = typer.Argument(
        metavar="FILE...",
        help="simvascular: .vtp or .pvd centerlines, averaged results. sv1d: input files of "
        "svOneDSolver (.in), results beside them. csv: tidy tables. hdf5: data sets by name.",
    ),
    source: FileFormat = option(..., "Program or format of the files.", "--from"),
    out: Path = _OUT,
    labels: Path | None = option(None, "CSV with one row per file: file, geometry, waveform."),
    period: float | None = option(None, "Cycle length, s; the last complete cycle is used."),
    time_step: float | None = option(None, "Time step of the 3D simulation, s (simvascular)."),
    units: str | None = options.UNITS,
    flip: Literal["flow", "z"] | None = option(
        None, "flow: reverse the sign of the flow; z: reverse the direction of the axis."
    ),
    time_points: int | None = option(None, "Resample the cycle to this number of steps."),
    points: int | None = option(None, "Resample the vessel to this number of points."),
    branch: int | None = option(None, "BranchId of the vessel (simvascular)."),
    rigid: bool = option(False, "The walls were rigid (simvascular).", "--rigid"),
    segments: str | None = option(None, "Segments from the inlet: a,b,c (sv1d)."),
    names: str | None = option(None, "Names of the data sets: flow=/Q,pressure=/P (hdf5)."),
) -> None:
    """Convert results of other programs into a data set.

    Ambiguous files are rejected with a suggested fix.
    """
    from pcnde_bridge import io
    from pcnde_bridge.data.units import stated_units

    _check_data_set(out, files)
    stated_units(units)  # an unknown unit is reported before the files are read
    of_format: dict[str, dict[str, Any]] = {
        "simvascular": {"time_step": time_step, "branch": branch, "rigid": rigid or None},
        "sv1d": {"segments": None if segments is None else segments.split(",")},
        "csv": {},
        "hdf5": {"names": name_pairs(names, "--names")},
    }
    given: dict[str, Any] = {}
    for name, values in of_format.items():
        stated = {key: value for key, value in values.items() if value is not None}
        if stated and name != source:
            wrong = next(iter(stated)).replace("_", "-")
            raise InputError(f"--{wrong} is an option of --from {name}, not of {source}.")
        given |= stated
    cases = getattr(io, f"read_{source}")(
        files,
        **given,
        period=period,
        units=units,
        flip=flip,
        time_points=time_points,
        points=points,
        labels=None if labels is None else io.read_labels(labels, files),
    )
    _save(cases, out)


def design(
    inflow: Path = option(..., "Table: time (s), then one column of Q (mL/s) per inflow."),
    area: Path = option(..., "Table: z (cm), then one column of S_u (cm²) per vessel."),
    out: Path = option(..., "Folder for the list and the input of the simulations."),
    count: int | None = option(None, "Number of simulations; by default 6, or all left.", min=1),
    done: Path | None = option(
        None, "Data set of finished simulations, with the labels of this command."
    ),
    units: str | None = options.UNITS,
    period: float | None = option(None, "Cycle length, s; a time point at its end is left out."),
) -> None:
    """Choose the simulations to run, from inflows and vessels.

    Candidates are all pairs of vessel and inflow. With --done, choose further simulations,
    train a model (preset physics) on the finished ones, if there are four or more, and estimate its
    errors for all pairs.
    """
    from pcnde_bridge._utils.validation import listed
    from pcnde_bridge.data.selection import case_keys, pair_positions
    from pcnde_bridge.data.stenosis import summary
    from pcnde_bridge.engines.types import ModelInputs
    from pcnde_bridge.evaluation import design as designs
    from pcnde_bridge.io.datasets import load_cases
    from pcnde_bridge.io.input_tables import read_candidates
    from pcnde_bridge.model.pcnde import PCNDE

    given = read_candidates(inflow, area, period, units)
    candidates, labels = designs.all_pairs(*given, units=units)
    say(summary(candidates.grid.z, candidates.area_undeformed))
    finished = None if done is None else load_cases(str(done))
    pairs = [] if finished is None else case_keys(finished.labels)
    if foreign := sorted({*pairs}.difference(case_keys(labels))):
        raise InputError(
            f"{done} has the cases (geometry, waveform) {listed(foreign, 4)}, but geometries are "
            f"the columns of {area}, 1 to {labels['geometry'].max()}, and waveforms those of "
            f"{inflow}, 1 to {labels['waveform'].max()}: label the simulations so."
        )
    positions = pair_positions(labels, pairs, str(done)).tolist() if pairs else []
    if finished is not None:
        inputs = ModelInputs(finished.inflow, finished.area_undeformed, finished.grid)
        if wrong := designs.confused(candidates, positions, inputs):
            case, other = wrong[0]
            raise InputError(
                f"Inflow and area of case (geometry, waveform) {pairs[case]} of {done} are "
                f"those of {tuple(labels.to_numpy()[other].tolist())}: correct the labels."
            )
    count = count or max(1, min(6, len(labels) - len(positions)))
    chosen = designs.choose(candidates, count, done=positions)
    designs.write_inputs(out, candidates, labels, chosen)
    for case, reason in zip(chosen["case"], chosen["reason"], strict=True):
        geometry, waveform = labels.to_numpy()[case]
        say(f"geometry {geometry}, waveform {waveform}: {reason}")
    say(f"Saved the list and the input of the simulations in {out}.")
    if finished is not None and len(finished) < 4:
        say("An estimate of the errors needs at least four finished simulations.")
    elif finished is not None:
        model = PCNDE.fit(finished, "physics")
        show_numbers(designs.expected_errors(model, candidates), "estimated error")


def download(
    folder: Path | None = option(None, "Folder of the files instead of the cache.", "--cache"),
) -> None:
    """Download the published data set (100 cases, about 50 MB).

    If a folder already has it, set the environment variable PCNDE_DATA to that folder instead.
    """
    from pcnde_bridge.io.datasets import download_published

    say(f"The data set is in {download_published(folder)}.")


def doctor(
    load: bool = option(False, "Load Julia even if it must be compiled first (minutes).", "--load"),
    write_project: Path | None = option(
        None, "Write a Julia project with tested versions to this folder, and check nothing."
    ),
) -> None:
    """Check engines and data on this machine and suggest fixes."""
    if write_project is not None:
        from pcnde_bridge.engines.julia import environment

        say(environment.write_project(write_project))
        return
    from pcnde_bridge.cli.doctor import examine

    say(f"pcnde_bridge {__version__}")
    for finding in examine(load):
        mark, style = ("✓", "green") if finding.good else ("–", "yellow")
        say(mark, style=style, end=" ")
        say(f"{finding.what}: {finding.found}")
        if finding.advice:
            say(f"  → {finding.advice}")


def _check_data_set(path: Path, inputs: Sequence[Path] = ()) -> None:
    if path.suffix.lower() not in (".npz", ".h5", ".hdf5"):
        raise InputError(f"Unknown format of {path}: the name must end in .npz or .h5.")
    check_outputs(path, inputs=inputs)


def _save(cases: Any, out: Path) -> None:
    from pcnde_bridge.data.stenosis import summary

    cases.save(out)
    say(summary(cases.z, cases.area_undeformed))
    say(f"Saved {cases!r} in {out}.")
