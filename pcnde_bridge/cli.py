"""The command line ``pcnde``.

Exit codes: 0 good, 2 bad use or input, 1 failure, 130 interrupted.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer
import typer.core
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pcnde_bridge import checkpoints, interrupts
from pcnde_bridge._version import __version__
from pcnde_bridge.config import PRESETS, ClosureConfig, PCNDEConfig, resolve_config
from pcnde_bridge.errors import FileError, InputError, PCNDEError, TaskError
from pcnde_bridge.files import atomic_write, check_writable

if TYPE_CHECKING:
    import pandas as pd

    from pcnde_bridge.bench import Row
    from pcnde_bridge.cases import Cases
    from pcnde_bridge.ensemble import Ensemble
    from pcnde_bridge.model import PCNDE


_INTERRUPTED = 130
"""Exit code after Ctrl-C."""


class _Group(typer.core.TyperGroup):
    """Ends with 130 after Ctrl-C, at whatever moment it came."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            _say_note("\nInterrupted.")
            raise typer.Exit(_INTERRUPTED) from None


app = typer.Typer(
    cls=_Group,
    help="One-dimensional blood-flow models that learn from 3D simulation (PCNDE).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_out = Console()
_notes = Console(stderr=True)


class EngineChoice(str, Enum):
    """Engines that ``--engine`` knows."""

    auto = "auto"
    julia = "julia"
    jax = "jax"


class FileFormat(str, Enum):
    """Files that ``pcnde convert`` reads."""

    simvascular = "simvascular"
    sv1d = "sv1d"
    csv = "csv"
    hdf5 = "hdf5"


class Flip(str, Enum):
    """What ``pcnde convert --flip`` turns."""

    flow = "flow"
    z = "z"


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
_MODEL_SIZE = 1 << 22  # bytes; the largest of the presets' models has one megabyte


@app.command()
def fit(
    data: DataArgument,
    out: Annotated[Path, typer.Option("--out", help="File for the fitted model.")],
    split: SplitOption = "paper",
    preset: PresetOption = "paper",
    config: ConfigOption = None,
    engine: EngineOption = EngineChoice.auto,
    seed: SeedOption = 0,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            "--checkpoint",
            help="File that keeps the state of training; default OUT.checkpoint, "
            "removed when the model is saved.",
        ),
    ] = None,
    members: Annotated[
        int,
        typer.Option(
            "--members", min=1, help="More than one: an ensemble, with uncertainty (many fits)."
        ),
    ] = 1,
    workers: WorkersOption = 1,
) -> None:
    """Train a model; an interrupted run continues when started again."""
    from pcnde_bridge.datasets import load_cases

    settings = _settings(preset, config)
    _check_writable(out, size=members * _MODEL_SIZE, inputs=[Path(data)])
    sets = _split(load_cases(data), split)
    model: PCNDE | Ensemble
    if members > 1:
        if checkpoint is not None:
            raise InputError("An ensemble keeps its fits in OUT.fits: leave --checkpoint out.")
        model = _fit_ensemble(sets["train"], settings, engine, seed, members, workers, out)
    else:
        if workers > 1:
            raise InputError("A single fit has one process: give --members, or no --workers.")
        state = checkpoint or out.with_name(out.name + ".checkpoint")
        model = _fit_model(sets["train"], settings, engine, seed, state)
        model.save(out)
        if checkpoint is None:
            checkpoints.remove(state)
    _print_errors(_errors(model, sets))
    _out.print(f"Saved {out}.", highlight=False, soft_wrap=True)


@app.command("cross-validate")
def cross_validate_(
    data: DataArgument,
    split: SplitOption = "paper",
    preset: PresetOption = "paper",
    config: ConfigOption = None,
    engine: EngineOption = EngineChoice.auto,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", help="Keeps every finished fit, so that the run can continue."),
    ] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Also write the table.")] = None,
) -> None:
    """Print errors on each waveform and geometry left out of the training cases."""
    from pcnde_bridge.cross_validation import cross_validate
    from pcnde_bridge.datasets import load_cases
    from pcnde_bridge.tasks import processes

    settings = _settings(preset, config)
    _check_writable(csv, inputs=[Path(data)])
    train = _split(load_cases(data), split)["train"]
    try:
        table = cross_validate(
            train, settings, engine.value, seed, executor=processes(workers), folder=folder
        )
    except KeyboardInterrupt:
        if folder is None:
            raise
        raise _interrupted(f"The finished fits are in {folder}") from None
    if csv is not None:
        with atomic_write(csv) as temporary:
            table.to_csv(temporary)
    names = [" ".join(map(str, key)) for key in table.index.to_list()]
    if variables := [name for name in ("flow", "area", "pressure") if name in table]:
        errors = dict(zip(names, table[variables].to_dict("records"), strict=True))
        for label, mean in table[variables].groupby("label").mean().to_dict("index").items():
            errors[f"mean, {label}"] = mean
        _print_errors({name: {v: float(row[v]) for v in variables} for name, row in errors.items()})
    for name, why in zip(names, table["failure"], strict=True):
        if isinstance(why, str):
            _say(f"{name}: {why}")
    if table["failure"].notna().all():
        raise TaskError("All fits failed.")


@app.command()
def info(
    model: Annotated[
        Path, typer.Argument(metavar="FILE", help="A model, an ensemble or a checkpoint.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, with all settings.")] = False,
) -> None:
    """Print what a file holds, and what is needed to run its fit again."""
    from pcnde_bridge.info import describe, lines

    found = describe(model)
    if as_json:
        sys.stdout.write(json.dumps(found, indent=1) + "\n")
        return
    table = Table(show_header=False)
    for name, text in lines(found):
        table.add_row(name, Text(text))
    _out.print(table)


@app.command()
def evaluate(
    model: ModelArgument,
    data: DataArgument,
    split: SplitOption = "paper",
    engine: EngineOption = EngineChoice.auto,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Also write the errors to this file.")
    ] = None,
    per_case: Annotated[
        Path | None, typer.Option("--csv", help="Also write the errors of every case.")
    ] = None,
) -> None:
    """Print relative errors of a model on a data set."""
    import pandas as pd

    from pcnde_bridge.datasets import load_cases
    from pcnde_bridge.ensemble import load_model

    _check_writable(json_file, per_case, inputs=[model, Path(data)])
    fitted = load_model(model, engine=engine.value)
    sets = _split(load_cases(data), split)
    tables = {name: fitted.evaluate(cases) for name, cases in sets.items()}
    pooled = {name: _pooled(table) for name, table in tables.items()}
    if json_file is not None:
        with atomic_write(json_file) as temporary:
            temporary.write_text(json.dumps(pooled, indent=1) + "\n", encoding="utf-8")
    if per_case is not None:
        with atomic_write(per_case) as temporary:
            pd.concat(tables, names=["set"]).to_csv(temporary)
    _print_errors(pooled)


@app.command()
def predict(
    model: ModelArgument,
    inflow: Annotated[
        Path,
        typer.Option("--inflow", help="CSV: time (s), then one column of Q (mL/s) for each case."),
    ],
    area: Annotated[
        Path,
        typer.Option("--area", help="CSV: z (cm), then one column of S_u (cm²) for each case."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="Result: .csv (tidy), .npz or .h5 (a data set), .vtp (centrelines, one for "
            "each case) or .pvd (animation for ParaView).",
        ),
    ],
    engine: EngineOption = EngineChoice.auto,
    samples: Annotated[
        int,
        typer.Option(
            "--samples",
            min=0,
            help="Draws for the standard deviations in a .csv (preset physics; 64 are enough). "
            "An ensemble always gives them.",
        ),
    ] = 0,
) -> None:
    """Predict flow, area and pressure for new inflows and vessels.

    A model of the preset physics takes any equally spaced instants of a cycle and any
    points; another those of its training.
    """
    from pcnde_bridge.ensemble import load_model
    from pcnde_bridge.model import PCNDE
    from pcnde_bridge.prediction import check_target, save_csv
    from pcnde_bridge.tables import read_columns, read_cycle, read_table

    suffix = check_target(out, has_pressure=True)
    _check_writable(out, inputs=[model, inflow, area])
    if samples and suffix != ".csv":
        raise InputError("Standard deviations (--samples) are written to a .csv only.")
    fitted = load_model(model, engine=engine.value)
    check_target(out, fitted.has_pressure)
    where: dict[str, Any] = {}
    if fitted.any_grid:
        where["period"], q = read_cycle(inflow, float(fitted.grid.time[0]), fitted.grid.period)
        where["z"], s_u = read_table(area, "z")
    else:
        q = read_columns(inflow, "time", fitted.grid.time, "s")
        s_u = read_columns(area, "z", fitted.grid.z, "cm")
    files = [out]
    if isinstance(fitted, PCNDE) and not samples and suffix == ".csv":
        count = save_csv(fitted.predict_batches(q, s_u, **where), out)
    else:
        # The members of an ensemble are its samples.
        draws = {"samples": samples} if isinstance(fitted, PCNDE) else {}
        prediction = fitted.predict(q, s_u, **where, **draws)
        files = prediction.save(out)
        count = len(prediction)
    cases = "case" if count == 1 else "cases"
    place = out if out in files else f"{files[0]} to {files[-1].name}"
    _out.print(f"Saved {count} {cases} in {place}.", highlight=False, soft_wrap=True)


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for everything that is written.")] = (
        Path("demo")
    ),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of waveforms and training.")] = 0,
    engine: EngineOption = EngineChoice.auto,
) -> None:
    """Simulate, train, evaluate and predict, in three minutes: what the package does."""
    from pcnde_bridge.demo import run_demo

    try:
        result = run_demo(out, seed, engine.value)
    except KeyboardInterrupt:
        raise _interrupted(f"The state of training is in {out}") from None
    _print_errors(
        {
            f"{name}, {method}": row
            for name in ("train", "test")
            for method, row in ((m, sets[name]) for m, sets in result.errors.items())
        }
    )
    _out.print(
        f"""Took {result.seconds:.0f} s. In {out}:
  model.npz           the model
  cases.npz           the 100 simulated cases, and split.json, which were for training
  errors.csv          errors of every case; history.csv, the loss of every iteration
  prediction.csv.gz   flow, area and pressure of the test cases
  prediction.png      the hardest test case; history.png, the loss
Next, with your own waveform and vessel in these two files:
  pcnde predict {out / "model.npz"} --inflow {out / "inflow.csv"} --area {out / "area.csv"} --out mine.csv
the model beside simpler methods:
  pcnde bench {out / "cases.npz"} --model {out / "model.npz"}
and the paper's 3D simulations, trained as in the paper:
  pcnde fit published --out model.npz""",  # noqa: E501
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


@app.command()
def simulate(
    out: Annotated[Path, typer.Option("--out", help="File for the data set: .npz or .h5.")],
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
    """Simulate stenosed vessels with the 1D solver: the synthetic data set."""
    from pcnde_bridge.synthetic import synthetic

    _check_data_set(out)
    cases = synthetic(geometries, waveforms, seed)
    cases.save(out)
    _out.print(f"Saved {cases!r} in {out}.", highlight=False, markup=False, soft_wrap=True)


@app.command()
def convert(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="simvascular: .vtp centrelines with averaged results. sv1d: svOneDSolver's input "
            "files (.in), results beside them. csv: tidy tables. hdf5: data sets by name.",
        ),
    ],
    source: Annotated[FileFormat, typer.Option("--from", help="Who wrote the files.")],
    out: Annotated[Path, typer.Option("--out", help="File for the data set: .npz or .h5.")],
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
    instants: Annotated[
        int | None, typer.Option("--instants", help="Resample the cycle to so many equal steps.")
    ] = None,
    points: Annotated[
        int | None, typer.Option("--points", help="Resample the vessel to so many equal steps.")
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
    """Make a data set of other programs' results; doubtful ones are refused, with advice."""
    from pcnde_bridge import formats

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
        instants=instants,
        points=points,
        labels=None if labels is None else formats.read_labels(labels, files),
    )
    cases.save(out)
    _say(f"Saved {cases!r} in {out}.")


@app.command()
def bench(
    data: DataArgument,
    split: SplitOption = "paper",
    model: Annotated[
        Path | None, typer.Option("--model", help="Fitted model; without it one is trained.")
    ] = None,
    preset: PresetOption = "paper",
    config: ConfigOption = None,
    engine: EngineOption = EngineChoice.auto,
    seed: SeedOption = 0,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Also write the results to this file.")
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            "--checkpoint",
            help="File that keeps the state of training; default bench-….checkpoint in this "
            "folder, removed after the training.",
        ),
    ] = None,
) -> None:
    """Print errors and times of a model and of the baselines, side by side."""
    from pcnde_bridge.baselines import standard_baselines
    from pcnde_bridge.bench import bench_baseline, bench_model, write_rows
    from pcnde_bridge.datasets import load_cases
    from pcnde_bridge.model import PCNDE

    training = {
        "--preset": preset != "paper",
        "--config": config,
        "--seed": seed,
        "--checkpoint": checkpoint,
    }
    if model is not None and any(training.values()):
        given = ", ".join(option for option, value in training.items() if value)
        raise InputError(f"A fitted model is not trained: leave out --model, or {given}.")
    settings = _settings(preset, config)
    _check_writable(json_file, inputs=[Path(data)])
    fitted = None if model is None else PCNDE.load(model, engine=engine.value)
    sets = _split(load_cases(data), split)
    if fitted is None:
        # Named by what is trained, so that it is never another run's.
        key = json.dumps([sets["train"].fingerprint(), settings.to_dict(), engine.value, seed])
        name = f"bench-{hashlib.sha256(key.encode()).hexdigest()[:12]}.checkpoint"
        state = checkpoint or Path(name)
        fitted = _fit_model(sets["train"], settings, engine, seed, state)
        if checkpoint is None:
            checkpoints.remove(state)
    rows = [bench_model(fitted, sets)]
    for name, baseline in standard_baselines().items():
        rows.append(bench_baseline(name, baseline, sets))
    if json_file is not None:
        facts = {
            "data": data,
            "split": split,
            "model": None if model is None else str(model),
            "config": fitted.config.to_dict(),
            "cases": {name: len(cases) for name, cases in sets.items()},
        }
        write_rows(json_file, rows, **facts)
    _print_bench(rows, list(sets))
    if data == "synthetic":
        _out.print("The 1D solver made these data: its own errors on them say nothing.")


@app.command("app")
def explore(
    model: ModelArgument,
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Of this machine; 0 takes a free one.")
    ] = 8050,
) -> None:
    """Serve a page, to this machine only, to explore a model."""
    from pcnde_bridge.app.server import serve
    from pcnde_bridge.model import PCNDE

    # Julia computes in one thread only, and a server has several.
    serve(PCNDE.load(model, engine="jax"), model.stem, port)


@app.command()
def figures(
    model: ModelArgument,
    data: DataArgument,
    out: Annotated[Path, typer.Option("--out", help="Folder for PNG, PDF and CSV files.")],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Make this figure; may be given several times."),
    ] = None,
    studies: Annotated[
        bool,
        typer.Option("--studies", help="Also those that train models anew, which takes minutes."),
    ] = False,
    split: SplitOption = "paper",
    engine: EngineOption = EngineChoice.auto,
    workers: WorkersOption = 1,
) -> None:
    """Make the paper's figures, and the numbers behind them, for a model and a data set."""
    from pcnde_bridge.datasets import load_cases
    from pcnde_bridge.figures import FIGURES, Entry, Material, choose, make_figures
    from pcnde_bridge.model import PCNDE
    from pcnde_bridge.tasks import processes

    names = only or []
    choose(names)
    fitted = PCNDE.load(model, engine=engine.value)
    cases = load_cases(data)
    sets = _split(cases, split)
    material = Material(fitted, cases, sets["train"], sets.get("test"))
    if data == "synthetic":
        material.truth_label, material.other = "1D solver", None
    elif data != "published":
        material.truth_label = "truth"
    if workers > 1:
        material.executor = processes(workers)

    def announce(number: int, count: int, entry: Entry) -> None:
        cost = f"; {entry.cost}" if entry.cost else ""
        _notes.print(
            f"[{number}/{count}] {entry.name}: {entry.about}{cost}",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )

    made = make_figures(material, out, only=names, with_studies=studies, on_entry=announce)
    for result in made:
        if result.reason:
            _say(f"{result.entry.name}: left out. {result.reason}")
        else:
            _say(f"{result.entry.name}: {', '.join(path.name for path in result.files)}")
    if not names and not studies:
        left = [f"{entry.name} ({entry.cost})" for entry in FIGURES if entry.cost]
        _say(f"Not made without --studies: {', '.join(left)}.")
    _say(f"The files are in {out}.")


@app.command()
def download(
    folder: Annotated[
        Path | None, typer.Option("--cache", help="Where to put the files; default the cache.")
    ] = None,
) -> None:
    """Download the published data set (100 cases, about 50 MB)."""
    from pcnde_bridge.datasets import download_published

    _out.print(f"The data set is in {download_published(folder)}.", highlight=False, soft_wrap=True)


@app.command()
def doctor() -> None:
    """Tell what is usable on this machine, and what to do about the rest."""
    from pcnde_bridge.doctor import examine

    findings = examine()
    _out.print(f"pcnde_bridge {__version__}", highlight=False)
    for finding in findings:
        mark = "[green]✓[/]" if finding.good else "[yellow]–[/]"
        _out.print(mark, end=" ")
        _say(f"{finding.what}: {finding.found}")
        if finding.advice:
            _say(f"  → {finding.advice}")
    if not any(finding.good for finding in findings if finding.is_engine):
        raise PCNDEError("No engine is usable: nothing can be computed on this machine.")


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
        _out.print(__version__, highlight=False, soft_wrap=True)
        raise typer.Exit


def _note_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Say what the package warns of without the line of code that Python would show."""
    if category.__module__.partition(".")[0] == "pcnde_bridge":
        text = str(message)
    else:
        text = warnings.formatwarning(message, category, filename, lineno, line)
    _notes.print(f"Warning: {text}", highlight=False, markup=False, soft_wrap=True)


def main() -> None:
    """Run the command line, turning errors into messages and exit codes, warnings into notes."""
    warnings.showwarning = _note_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with interrupts.kept():
            app()
    except PCNDEError as error:
        _fail(str(error), 2 if isinstance(error, InputError | FileError) else 1)
    except BrokenPipeError:
        # The reader of a pipe has gone; keep the interpreter from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def run() -> None:
    """Run the command line in a process of its own."""
    try:
        main()
    except SystemExit as end:
        if end.code == _INTERRUPTED:
            # JAX, interrupted while it compiles, would crash when the interpreter ends.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(_INTERRUPTED)
        raise


def _say(text: str) -> None:
    _out.print(text, highlight=False, markup=False, soft_wrap=True)


def _fail(message: str, code: int) -> None:
    _notes.print("Error:", style="bold red", end=" ")
    _notes.print(message, highlight=False, markup=False, soft_wrap=True)
    sys.exit(code)


def _check_writable(*paths: Path | None, size: int = 0, inputs: Sequence[Path] = ()) -> None:
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


def _check_data_set(path: Path, inputs: Sequence[Path] = ()) -> None:
    if path.suffix.lower() not in (".npz", ".h5", ".hdf5"):
        raise InputError(f"Cannot tell the format of {path}: it must end in .npz or .h5.")
    _check_writable(path, inputs=inputs)


def _settings(preset: str, path: Path | None) -> PCNDEConfig | ClosureConfig:
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


def _pairs(text: str | None, option: str) -> dict[str, str] | None:
    """Read name=value,name=value."""
    if text is None:
        return None
    parts = [part.partition("=") for part in text.split(",")]
    if not all(name and value for name, _, value in parts):
        raise InputError(f"{option} must look like flow=…,pressure=…, got {text!r}.")
    return {name: value for name, _, value in parts}


def _fit_model(
    train: Cases,
    settings: PCNDEConfig | ClosureConfig,
    engine: EngineChoice,
    seed: int,
    state: Path,
) -> PCNDE:
    """Train from the start or from the checkpoint; after Ctrl-C, say how to go on."""
    from pcnde_bridge.model import PCNDE

    if state.exists():
        _say_note(f"Continuing from {state}.")
    try:
        return PCNDE.fit(train, settings, engine=engine.value, seed=seed, checkpoint=state)
    except KeyboardInterrupt:
        raise _interrupted(f"The state of training is in {state}") from None


def _fit_ensemble(
    train: Cases,
    settings: PCNDEConfig | ClosureConfig,
    engine: EngineChoice,
    seed: int,
    members: int,
    workers: int,
    out: Path,
) -> Ensemble:
    """Fit an ensemble, keeping finished fits beside its file until that is written."""
    from pcnde_bridge.ensemble import Ensemble
    from pcnde_bridge.tasks import processes, remove_results

    folder = out.with_name(out.name + ".fits")
    if folder.exists():
        _say_note(f"Continuing with the finished fits in {folder}.")
    try:
        ensemble = Ensemble.fit(
            train,
            settings,
            engine.value,
            seed,
            members=members,
            executor=processes(workers),  # also one, so that their number changes no bit
            folder=folder,
        )
    except KeyboardInterrupt:
        raise _interrupted(f"The finished fits are in {folder}") from None
    ensemble.save(out)
    if not ensemble.provenance["failures"]:
        remove_results(folder)
    return ensemble


def _interrupted(where: str) -> typer.Exit:
    _say_note(f"\nInterrupted. {where}: run the same command again to continue.")
    return typer.Exit(_INTERRUPTED)


def _say_note(text: str) -> None:
    _notes.print(text, highlight=False, markup=False, soft_wrap=True)


def _split(cases: Cases, how: str) -> dict[str, Cases]:
    return {"train": cases} if how == "none" else cases.split(how)._asdict()


def _errors(model: PCNDE | Ensemble, sets: dict[str, Cases]) -> dict[str, dict[str, float]]:
    return {name: _pooled(model.evaluate(cases)) for name, cases in sets.items()}


def _pooled(table: pd.DataFrame) -> dict[str, float]:
    return {str(variable): float(error) for variable, error in table.iloc[-1].items()}


def _print_errors(errors: dict[str, dict[str, float]]) -> None:
    variables = list(next(iter(errors.values())))
    table = Table("relative error", *variables)
    for name, row in errors.items():
        table.add_row(name, *(f"{row[variable]:.4f}" for variable in variables))
    _out.print(table)


def _print_bench(rows: list[Row], sets: list[str]) -> None:
    variables = list(rows[0].errors[sets[0]])
    table = Table("relative error", "", *variables, show_lines=True)
    table.add_column("fit\ns", justify="right")
    table.add_column("predict\nms per case", justify="right")
    for row in rows:
        if row.reason is not None:
            table.add_row(row.name, "", *("–" for _ in variables), "–", "–")
            continue
        errors = ("\n".join(f"{row.errors[name][v]:.4f}" for name in sets) for v in variables)
        fit = "–" if row.fit_seconds is None else f"{row.fit_seconds:.1f}"
        table.add_row(row.name, "\n".join(sets), *errors, fit, f"{row.predict_ms_per_case:.2f}")
    _out.print(table)
    for row in rows:
        if row.reason is not None:
            _out.print(f"{row.name}: {row.reason}", highlight=False, markup=False, soft_wrap=True)
