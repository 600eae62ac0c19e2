"""Commands that train: fit, cross-validate, bench, demo."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from pcnde_bridge._utils.files import locked, write_csv
from pcnde_bridge.cli import options
from pcnde_bridge.cli.console import note, resumable, say, show_numbers
from pcnde_bridge.cli.options import (
    check_outputs,
    lock_folder,
    option,
    outlet_of,
    settings_of,
    split_name,
    split_of,
)
from pcnde_bridge.engines import EngineName
from pcnde_bridge.errors import InputError, TaskError

if TYPE_CHECKING:
    from pcnde_bridge.evaluation.benchmark import Row

_MODEL_SIZE = 1 << 22  # bytes; the largest of the presets' models has one megabyte

_CHECKPOINT = option(
    None,
    "File that stores the state of training. By default OUT.checkpoint (fit) or "
    "bench-….checkpoint in this folder (bench), removed after the training.",
)


def fit(
    data: str = options.DATA,
    out: Path = option(..., "File for the fitted model."),
    split: str | None = options.SPLIT,
    preset: str = options.PRESET,
    config: Path | None = options.CONFIG,
    engine: EngineName = options.ENGINE,
    seed: int = options.SEED,
    outlet: Path | None = options.OUTLET,
    checkpoint: Path | None = _CHECKPOINT,
    members: int = option(1, "Number of models; more than 1 is an ensemble.", min=1),
    workers: int = options.WORKERS,
) -> None:
    """Train a model, or resume an interrupted run."""
    import pandas as pd

    from pcnde_bridge._utils.parallel import processes
    from pcnde_bridge._utils.result_folder import remove_results
    from pcnde_bridge.io.datasets import load_cases
    from pcnde_bridge.model.ensemble import Ensemble
    from pcnde_bridge.model.metrics import pooled
    from pcnde_bridge.model.pcnde import PCNDE

    settings = settings_of(preset, config)
    check_outputs(out, checkpoint, size=members * _MODEL_SIZE, inputs=[Path(data)])
    given = outlet_of(outlet)
    if given is not None and not given.is_common:
        raise InputError("--outlet takes one outlet for all cases.")
    if members > 1 and checkpoint is not None:
        raise InputError("An ensemble stores its fits in OUT.fits: leave --checkpoint out.")
    sets = split_of(load_cases(data), data, split)
    run = sets["train"], settings, engine, seed
    model: PCNDE | Ensemble
    if members == 1:
        with _training_state(checkpoint, out.with_name(out.name + ".checkpoint")) as state:
            parallel = processes(workers) if workers > 1 else None
            model = PCNDE.fit(*run, state, outlet=given, executor=parallel)
            model.save(out)
    else:
        folder = out.with_name(out.name + ".fits")  # until the ensemble is written
        if folder.exists():
            note(f"Continuing with the finished fits in {folder}.")
        # One worker is a process, too, so that the number of workers does not change a bit.
        executor = processes(workers)
        with resumable(f"The finished fits are in {folder}"):
            model = Ensemble.fit(
                *run, members=members, outlet=given, executor=executor, folder=folder
            )
        model.save(out)
        if not model.provenance["failures"]:
            remove_results(folder)
    show_numbers(pd.DataFrame({n: pooled(model.evaluate(cases)) for n, cases in sets.items()}).T)
    say(f"Saved {out}.")


def cross_validate(
    data: str = options.DATA,
    split: str | None = options.SPLIT,
    preset: str = options.PRESET,
    config: Path | None = options.CONFIG,
    engine: EngineName = options.ENGINE,
    seed: int = options.SEED,
    outlet: Path | None = options.OUTLET,
    workers: int = options.WORKERS,
    folder: Path | None = option(None, "Folder of finished fits, to resume an interrupted run."),
    csv: Path | None = options.CSV,
) -> None:
    """Leave out each waveform and geometry, and print errors.

    Each fold holds out one waveform or one geometry of the training cases.
    """
    import pandas as pd

    from pcnde_bridge._utils.parallel import processes
    from pcnde_bridge.evaluation import cross_validation
    from pcnde_bridge.io.datasets import load_cases
    from pcnde_bridge.model.metrics import ERRORS

    settings = settings_of(preset, config)
    check_outputs(csv, inputs=[Path(data)])
    train = split_of(load_cases(data), data, split)["train"]
    with resumable(f"The finished fits are in {folder}") if folder else nullcontext():
        table = cross_validation.cross_validate(
            *(train, settings, engine, seed),
            outlet=outlet_of(outlet),
            executor=processes(workers),
            folder=folder,
        )
    if csv is not None:
        write_csv(csv, table)
    errors = table[list(ERRORS)].dropna(axis="columns", how="all")
    means = errors.groupby("label").mean().rename("mean, {}".format)
    table.index = errors.index = pd.Index([" ".join(map(str, key)) for key in errors.index])
    if not errors.empty:
        show_numbers(pd.concat([errors, means]))
    for name, reason in table["failure"].dropna().items():
        say(f"{name}: {reason}")
    if table["failure"].notna().all():
        raise TaskError("All fits failed.")


def bench(
    data: str = options.DATA,
    split: str | None = options.SPLIT,
    model: Path | None = option(None, "Fitted model; without it, one is trained."),
    preset: str = options.PRESET,
    config: Path | None = options.CONFIG,
    engine: EngineName = options.ENGINE,
    seed: int = options.SEED,
    json_file: Path | None = options.JSON,
    checkpoint: Path | None = _CHECKPOINT,
) -> None:
    """Compare errors and times of a model with the baselines."""
    from pcnde_bridge.evaluation import baselines, benchmark
    from pcnde_bridge.io.datasets import load_cases
    from pcnde_bridge.model.pcnde import PCNDE

    training = {"preset": preset != "paper", "config": config, "seed": seed}
    given = [f"--{k}" for k, value in {**training, "checkpoint": checkpoint}.items() if value]
    if model is not None and given:
        raise InputError(
            f"A fitted model is not trained: leave out --model, or {', '.join(given)}."
        )
    settings = settings_of(preset, config)
    check_outputs(json_file, checkpoint, inputs=[Path(data)])
    fitted = None if model is None else PCNDE.load(model, engine)
    sets = split_of(load_cases(data), data, split)
    if fitted is None:
        run = sets["train"], settings, engine, seed
        with _training_state(checkpoint, Path(benchmark.checkpoint_name(*run))) as state:
            fitted = PCNDE.fit(*run, state)
    rows = [benchmark.bench_model(fitted, sets)]
    for name, baseline in baselines.standard_baselines().items():
        rows.append(benchmark.bench_baseline(name, baseline, sets))
    if json_file is not None:
        facts = {
            "data": data,
            "split": split_name(data, split),
            "model": None if model is None else str(model),
            "config": fitted.config.to_dict(),
            "cases": {name: len(cases) for name, cases in sets.items()},
        }
        benchmark.write_rows(json_file, rows, **facts)
    _show_rows(rows)
    say(
        "‘no change’ returns the inflow as the flow everywhere. The 1D solver and the pressure "
        "losses know the vessel, but no 3D simulation; on simulated data the solver is the "
        "reference itself. The polynomials know the training cases, but no physics."
    )


def demo(
    out: Path = option("demo", "Folder for all files."),
    seed: int = option(0, "Random seed of the waveforms and of the training.", min=0),
    engine: EngineName = options.ENGINE,
) -> None:
    """Simulate, train and predict FFR, in three minutes."""
    import pandas as pd

    from pcnde_bridge.cli.demo import run_demo

    lock_folder(out)
    with resumable(f"The state of training is in {out}"):
        result = run_demo(out, seed, engine)
    methods = result.errors.items()
    rows = {f"{s}, {method}": sets[s] for s in ("train", "test") for method, sets in methods}
    show_numbers(pd.DataFrame(rows).T)
    say(result.story)


@contextmanager
def _training_state(checkpoint: Path | None, default: Path) -> Iterator[Path]:
    """Yield the file for the state of training; the default one is removed after the block."""
    from pcnde_bridge.training import checkpoint as checkpoints

    state = checkpoint or default
    with locked(state):
        if state.exists():
            note(f"Continuing from {state}.")
        with resumable(f"The state of training is in {state}"):
            yield state
        if checkpoint is None:
            checkpoints.remove(state)


def _show_rows(rows: list[Row]) -> None:
    """Print errors and times of each method, then why some methods were not applicable."""
    import pandas as pd

    errors = {f"{row.name}, {name}": row.errors[name] for row in rows for name in row.errors}
    times = {
        row.name: {"fit, s": row.fit_seconds, "predict, ms/case": row.predict_ms_per_case}
        for row in rows
        if row.errors
    }
    # Without padding, the table fits into 80 characters.
    show_numbers(pd.DataFrame(errors).T, padding=0)
    show_numbers(pd.DataFrame(times, dtype=float).T, "time", digits=2)
    for row in rows:
        if row.reason is not None:
            say(f"{row.name}: {row.reason}")
