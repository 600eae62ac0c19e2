"""The commands that train: fit, cross-validate, bench and demo."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from pcnde_bridge._utils.files import atomic_write
from pcnde_bridge._utils.parallel import processes
from pcnde_bridge._utils.result_folder import remove_results
from pcnde_bridge.cli.console import (
    interrupted,
    note,
    say,
    show,
    show_errors,
)
from pcnde_bridge.cli.options import (
    ConfigOption,
    DataArgument,
    EngineChoice,
    EngineOption,
    PresetOption,
    SeedOption,
    SplitOption,
    WorkersOption,
    check_outputs,
    settings_of,
    split_of,
)
from pcnde_bridge.config import ClosureConfig, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError, TaskError
from pcnde_bridge.evaluation import cross_validation
from pcnde_bridge.io.datasets import load_cases
from pcnde_bridge.model.ensemble import Ensemble
from pcnde_bridge.model.metrics import pooled
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.training import checkpoint as checkpoints

if TYPE_CHECKING:
    from pcnde_bridge.evaluation.benchmark import Row

_MODEL_SIZE = 1 << 22  # bytes; the largest of the presets' models has one megabyte


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
    """Train a model, or go on with a run that was interrupted."""
    settings = settings_of(preset, config)
    check_outputs(out, size=members * _MODEL_SIZE, inputs=[Path(data)])
    check_outputs(checkpoint, inputs=[Path(data), out])
    if members > 1 and checkpoint is not None:
        raise InputError("An ensemble keeps its fits in OUT.fits: leave --checkpoint out.")
    if members == 1 and workers > 1:
        raise InputError("A single fit has one process: give --members, or no --workers.")
    sets = split_of(load_cases(data), split)
    model: PCNDE | Ensemble
    if members > 1:
        model = _fit_ensemble(sets["train"], settings, engine, seed, members, workers, out)
    else:
        state = checkpoint or out.with_name(out.name + ".checkpoint")
        model = _fit_model(sets["train"], settings, engine, seed, state)
        model.save(out)
        if checkpoint is None:
            checkpoints.remove(state)
    show_errors({name: pooled(model.evaluate(cases)) for name, cases in sets.items()})
    say(f"Saved {out}.")


def cross_validate(
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
    """Leave out each waveform and geometry, and print errors.

    These are those of the training cases: whole waveforms and whole geometries, in turns.
    """
    settings = settings_of(preset, config)
    check_outputs(csv, inputs=[Path(data)])
    train = split_of(load_cases(data), split)["train"]
    try:
        table = cross_validation.cross_validate(
            train, settings, engine.value, seed, executor=processes(workers), folder=folder
        )
    except KeyboardInterrupt:
        if folder is None:
            raise
        raise interrupted(f"The finished fits are in {folder}") from None
    if csv is not None:
        with atomic_write(csv) as temporary:
            table.to_csv(temporary)
    names = [" ".join(map(str, key)) for key in table.index.to_list()]
    if variables := [name for name in VARIABLES if table[name].notna().any()]:
        errors = dict(zip(names, table[variables].to_dict("records"), strict=True))
        for label, mean in table[variables].groupby("label").mean().to_dict("index").items():
            errors[f"mean, {label}"] = mean
        show_errors({name: {v: float(row[v]) for v in variables} for name, row in errors.items()})
    for name, why in zip(names, table["failure"], strict=True):
        if isinstance(why, str):
            say(f"{name}: {why}")
    if table["failure"].notna().all():
        raise TaskError("All fits failed.")


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
    """Print errors and times of a model beside the baselines'."""
    from pcnde_bridge.evaluation.baselines import standard_baselines
    from pcnde_bridge.evaluation.benchmark import (
        bench_baseline,
        bench_model,
        checkpoint_name,
        write_rows,
    )

    training = {
        "--preset": preset != "paper",
        "--config": config,
        "--seed": seed,
        "--checkpoint": checkpoint,
    }
    if model is not None and any(training.values()):
        given = ", ".join(option for option, value in training.items() if value)
        raise InputError(f"A fitted model is not trained: leave out --model, or {given}.")
    settings = settings_of(preset, config)
    check_outputs(json_file, checkpoint, inputs=[Path(data)])
    fitted = None if model is None else PCNDE.load(model, engine=engine.value)
    sets = split_of(load_cases(data), split)
    if fitted is None:
        name = checkpoint_name(sets["train"], settings, engine.value, seed)
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
    _show_rows(rows, list(sets))
    if data == "synthetic":
        say("The 1D solver made these data: its own errors on them say nothing.")


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for everything that is written.")] = (
        Path("demo")
    ),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of waveforms and training.")] = 0,
    engine: EngineOption = EngineChoice.auto,
) -> None:
    """Simulate, train, evaluate and predict, in three minutes."""
    from pcnde_bridge.cli.demo import run_demo

    try:
        result = run_demo(out, seed, engine.value)
    except KeyboardInterrupt:
        raise interrupted(f"The state of training is in {out}") from None
    show_errors(
        {
            f"{name}, {method}": row
            for name in ("train", "test")
            for method, row in ((m, sets[name]) for m, sets in result.errors.items())
        }
    )
    say(
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
    )


def _fit_model(
    train: Cases,
    settings: PCNDEConfig | ClosureConfig,
    engine: EngineChoice,
    seed: int,
    state: Path,
) -> PCNDE:
    """Train from the start or from the checkpoint; after Ctrl-C, say how to go on."""
    if state.exists():
        note(f"Continuing from {state}.")
    try:
        return PCNDE.fit(train, settings, engine=engine.value, seed=seed, checkpoint=state)
    except KeyboardInterrupt:
        raise interrupted(f"The state of training is in {state}") from None


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
    folder = out.with_name(out.name + ".fits")
    if folder.exists():
        note(f"Continuing with the finished fits in {folder}.")
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
        raise interrupted(f"The finished fits are in {folder}") from None
    ensemble.save(out)
    if not ensemble.provenance["failures"]:
        remove_results(folder)
    return ensemble


def _show_rows(rows: list[Row], sets: list[str]) -> None:
    """Print the methods side by side, then why some could not be applied."""
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
    show(table)
    for row in rows:
        if row.reason is not None:
            say(f"{row.name}: {row.reason}")
