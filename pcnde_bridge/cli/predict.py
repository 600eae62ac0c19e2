"""Commands that use a fitted model: info, evaluate, predict, app, figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.table import Table

from pcnde_bridge._utils.files import atomic_write, write_json
from pcnde_bridge._utils.parallel import processes
from pcnde_bridge._utils.validation import counted, positive
from pcnde_bridge.cli.console import note, say, show, show_errors
from pcnde_bridge.cli.options import (
    DataArgument,
    EngineOption,
    JsonOption,
    ModelArgument,
    SplitOption,
    UnitsOption,
    WorkersOption,
    check_outputs,
    option,
    split_of,
    units_of,
)
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.datasets import load_cases
from pcnde_bridge.io.predictions import check_target, save_csv
from pcnde_bridge.model.ensemble import load_model
from pcnde_bridge.model.metrics import pooled
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction

_IN_MEMORY = 256  # predictions of single cases, with their samples, while a table is written


def info(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Model, ensemble, checkpoint or data set.")
    ],
    as_json: Annotated[bool, option("Print JSON, with all settings.", "--json")] = False,
) -> None:
    """Print the content of a file, and how a model was trained."""
    from pcnde_bridge.model.describe import describe, lines

    found = describe(file)
    if as_json:
        say(json.dumps(found, indent=1))
        return
    table = Table(show_header=False)
    for row in lines(found):
        table.add_row(*row)
    show(table)


def evaluate(
    model: ModelArgument,
    data: DataArgument,
    split: SplitOption = "paper",
    engine: EngineOption = "auto",
    json_file: JsonOption = None,
    csv: Annotated[Path | None, option("Also write the errors of every case.")] = None,
) -> None:
    """Print relative errors of a model on a data set."""
    check_outputs(json_file, csv, inputs=[model, Path(data)])
    fitted = load_model(model, engine)
    sets = split_of(load_cases(data), split)
    tables = {name: fitted.evaluate(cases) for name, cases in sets.items()}
    errors = {name: pooled(table) for name, table in tables.items()}
    if json_file is not None:
        write_json(json_file, errors)
    if csv is not None:
        with atomic_write(csv) as temporary:
            pd.concat(tables, names=["set"]).to_csv(temporary)
    show_errors(errors)


def predict(
    model: ModelArgument,
    inflow: Annotated[Path, option("CSV: time (s), then one column of Q (mL/s) per case.")],
    area: Annotated[Path, option("CSV: z (cm), then one column of S_u (cm²) per case.")],
    out: Annotated[
        Path,
        option(
            "Result: .csv (tidy), .npz or .h5 (a data set), .vtp (centerlines, one per case) "
            "or .pvd (animation for ParaView)."
        ),
    ],
    engine: EngineOption = "auto",
    samples: Annotated[
        int,
        option(
            "Number of samples for the standard deviations in a .csv (preset physics; 64 are "
            "enough). An ensemble always gives standard deviations.",
            min=0,
        ),
    ] = 0,
    units: UnitsOption = None,
    period: Annotated[
        float | None, option("Cycle length, s; a time point at its end is left out.")
    ] = None,
    interpolate: Annotated[
        bool, option("Interpolate unequal time steps, and to the model's grid.")
    ] = False,
    indices: Annotated[
        Path | None,
        option(
            "Also write pressure drop, FFR, resistance and other indices of each case to this "
            ".csv, with 90 % intervals where there are samples."
        ),
    ] = None,
) -> None:
    """Predict flow, area and pressure of new cases.

    A model of the preset physics accepts any equally spaced time points of a cycle and any
    points along the vessel; other models need those of their training.
    """
    from pcnde_bridge.io.input_tables import read_inputs

    suffix = check_target(out, has_pressure=True)
    check_outputs(out, indices, inputs=[model, inflow, area])
    if samples and suffix != ".csv":
        raise InputError("Standard deviations (--samples) are written to a .csv only.")
    fitted = load_model(model, engine)
    check_target(out, fitted.has_pressure)
    stated = units_of(units)
    given = read_inputs(
        inflow,
        area,
        fitted.grid,
        any_grid=fitted.any_grid,
        units=stated,
        period=None if period is None else positive("--period", period, "s"),
        interpolate=interpolate,
    )
    q, s_u = given.inflow, given.area_undeformed
    tables: list[pd.DataFrame] = []

    def named(prediction: Prediction) -> Prediction:
        prediction = replace(prediction, labels=given.name_labels(prediction.labels))
        if indices is not None:
            tables.append(prediction.indices())
        return prediction

    files, options = [out], {"units": stated, **given.where}
    if suffix == ".csv":
        if isinstance(fitted, PCNDE):
            batch, options["samples"] = _IN_MEMORY // (1 + samples), samples
        else:  # the members are the samples
            batch = _IN_MEMORY // (1 + len(fitted.members))
        batches = fitted.predict_batches(q, s_u, batch=max(1, batch), **options)
        count = save_csv(map(named, batches), out)
    else:
        prediction = named(fitted.predict(q, s_u, **options))
        files, count = prediction.save(out), len(prediction)
    place = out if out in files else f"{files[0]} to {files[-1].name}"
    say(f"Saved {counted(count, 'case')} in {place}.")
    if indices is not None:
        with atomic_write(indices) as temporary:
            pd.concat(tables).to_csv(temporary, index=False)
        say(f"Saved their indices in {indices}.")


def explore(
    model: ModelArgument,
    port: Annotated[
        int, option("Port on this machine; 0: any free port.", min=0, max=65535)
    ] = 8050,
) -> None:
    """Explore a model on a web page, on this machine only."""
    from pcnde_bridge.app.server import serve

    # Julia computes in one thread only, but a server has several.
    serve(PCNDE.load(model, "jax"), model.stem, port)


def figures(
    model: ModelArgument,
    data: DataArgument,
    out: Annotated[Path, option("Folder for PNG, PDF and CSV files.")],
    only: Annotated[
        list[str] | None,
        option("Figure to draw; may be repeated. An unknown name prints all names."),
    ] = None,
    studies: Annotated[
        bool, option("Include figures that train models, which takes minutes.", "--studies")
    ] = False,
    split: SplitOption = "paper",
    engine: EngineOption = "auto",
    workers: WorkersOption = 1,
) -> None:
    """Draw the paper's figures for a model and a data set.

    The numbers of most figures are written beside them.
    """
    from pcnde_bridge.plots import paper_figures

    names = only or []
    paper_figures.choose(names)
    fitted, cases = PCNDE.load(model, engine), load_cases(data)
    sets = split_of(cases, split)
    figure_data = paper_figures.FigureData(fitted, cases, sets["train"], sets.get("test"))
    if data == "synthetic":
        figure_data.truth_label, figure_data.other = "1D solver", None
    elif data != "published":
        figure_data.truth_label = "truth"
    if workers > 1:
        figure_data.executor = processes(workers)

    def announce(number: int, count: int, figure: paper_figures.PaperFigure) -> None:
        cost = f"; {figure.cost}" if figure.cost else ""
        note(f"[{number}/{count}] {figure.name}: {figure.description}{cost}")

    for result in paper_figures.make_figures(
        figure_data, out, only=names, with_studies=studies, on_figure=announce
    ):
        files = ", ".join(path.name for path in result.files)
        reason = f"left out. {result.reason}"
        say(f"{result.figure.name}: {reason if result.reason else files}")
    if not names and not studies:
        costly = [f"{f.name} ({f.cost})" for f in paper_figures.FIGURES if f.cost]
        say(f"Left out without --studies: {', '.join(costly)}.")
    say(f"The files are in {out}.")
