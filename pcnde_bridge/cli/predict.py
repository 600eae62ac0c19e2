"""The commands that use what is trained: info, evaluate, predict, app and figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import pandas as pd
import typer
from rich.table import Table

from pcnde_bridge._utils import parallel as tasks
from pcnde_bridge._utils.files import atomic_write, write_json
from pcnde_bridge._utils.validation import counted
from pcnde_bridge.cli.console import (
    note,
    say,
    show,
    show_errors,
)
from pcnde_bridge.cli.options import (
    DataArgument,
    EngineChoice,
    EngineOption,
    ModelArgument,
    SplitOption,
    WorkersOption,
    check_outputs,
    split_of,
)
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.datasets import load_cases
from pcnde_bridge.io.predictions import check_target, save_csv
from pcnde_bridge.model.ensemble import load_model
from pcnde_bridge.model.metrics import pooled
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction

if TYPE_CHECKING:
    from pcnde_bridge.plots.paper_figures import PaperFigure

_IN_MEMORY = 256  # predictions of single cases, with their samples, while a table is written


def info(
    model: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A model, an ensemble, a checkpoint or a data set."),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, with all settings.")] = False,
) -> None:
    """Print what a file holds, and what it was made of."""
    from pcnde_bridge.model.describe import describe, lines

    found = describe(model)
    if as_json:
        say(json.dumps(found, indent=1))
        return
    table = Table(show_header=False)
    for name, text in lines(found):
        table.add_row(name, text)
    show(table)


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
    check_outputs(json_file, per_case, inputs=[model, Path(data)])
    fitted = load_model(model, engine=engine.value)
    sets = split_of(load_cases(data), split)
    tables = {name: fitted.evaluate(cases) for name, cases in sets.items()}
    errors = {name: pooled(table) for name, table in tables.items()}
    if json_file is not None:
        write_json(json_file, errors)
    if per_case is not None:
        with atomic_write(per_case) as temporary:
            pd.concat(tables, names=["set"]).to_csv(temporary)
    show_errors(errors)


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
            help="Result: .csv (tidy), .npz or .h5 (a data set), .vtp (centerlines, one for "
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
    """Predict flow, area and pressure of new cases.

    A model of the preset physics takes inflows at any equally spaced instants of a cycle and
    vessels at any points; another those of its training.
    """
    from pcnde_bridge.io.input_tables import read_inputs

    suffix = check_target(out, has_pressure=True)
    check_outputs(out, inputs=[model, inflow, area])
    if samples and suffix != ".csv":
        raise InputError("Standard deviations (--samples) are written to a .csv only.")
    fitted = load_model(model, engine=engine.value)
    check_target(out, fitted.has_pressure)
    given = read_inputs(inflow, area, fitted.grid, any_grid=fitted.any_grid)
    q, s_u = given.inflow, given.area_undeformed

    def named(prediction: Prediction) -> Prediction:
        return replace(prediction, labels=given.name_labels(prediction.labels))

    files = [out]
    if suffix == ".csv":
        if isinstance(fitted, PCNDE):
            draws, of_each = {"samples": samples}, samples
        else:  # whose members are its samples
            draws, of_each = {}, len(fitted.members)
        batch = max(1, _IN_MEMORY // (1 + of_each))
        parts = fitted.predict_batches(q, s_u, batch=batch, **given.where, **draws)
        count = save_csv(map(named, parts), out)
    else:
        prediction = named(fitted.predict(q, s_u, **given.where))
        files = prediction.save(out)
        count = len(prediction)
    place = out if out in files else f"{files[0]} to {files[-1].name}"
    say(f"Saved {counted(count, 'case')} in {place}.")


def explore(
    model: ModelArgument,
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Of this machine; 0 takes a free one.")
    ] = 8050,
) -> None:
    """Serve a page, to this machine only, to explore a model."""
    from pcnde_bridge.app.server import serve

    # Julia computes in one thread only, and a server has several.
    serve(PCNDE.load(model, engine="jax"), model.stem, port)


def figures(
    model: ModelArgument,
    data: DataArgument,
    out: Annotated[Path, typer.Option("--out", help="Folder for PNG, PDF and CSV files.")],
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only", help="Make this figure; may be given several times. A wrong name lists all."
        ),
    ] = None,
    studies: Annotated[
        bool,
        typer.Option("--studies", help="Also those that train models anew, which takes minutes."),
    ] = False,
    split: SplitOption = "paper",
    engine: EngineOption = EngineChoice.auto,
    workers: WorkersOption = 1,
) -> None:
    """Make the paper's figures of a model and a data set.

    The numbers behind most of them are written beside them.
    """
    from pcnde_bridge.plots.paper_figures import (
        FIGURES,
        FigureData,
        choose,
        make_figures,
    )

    names = only or []
    choose(names)
    fitted = PCNDE.load(model, engine=engine.value)
    cases = load_cases(data)
    sets = split_of(cases, split)
    figure_data = FigureData(fitted, cases, sets["train"], sets.get("test"))
    if data == "synthetic":
        figure_data.truth_label, figure_data.other = "1D solver", None
    elif data != "published":
        figure_data.truth_label = "truth"
    if workers > 1:
        figure_data.executor = tasks.processes(workers)

    def announce(number: int, count: int, figure: PaperFigure) -> None:
        cost = f"; {figure.cost}" if figure.cost else ""
        note(f"[{number}/{count}] {figure.name}: {figure.description}{cost}")

    made = make_figures(figure_data, out, only=names, with_studies=studies, on_figure=announce)
    for result in made:
        if result.reason:
            say(f"{result.figure.name}: left out. {result.reason}")
        else:
            say(f"{result.figure.name}: {', '.join(path.name for path in result.files)}")
    if not names and not studies:
        left = [f"{figure.name} ({figure.cost})" for figure in FIGURES if figure.cost]
        say(f"Not made without --studies: {', '.join(left)}.")
    say(f"The files are in {out}.")
