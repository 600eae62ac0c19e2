"""Commands that use a fitted model: info, evaluate, predict, app, figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.table import Table

from pcnde_bridge._utils.files import write_csv, write_json
from pcnde_bridge.cli import options
from pcnde_bridge.cli.console import note, say, show, show_numbers
from pcnde_bridge.cli.options import (
    check_outputs,
    lock_folder,
    option,
    outlet_of,
    split_of,
)
from pcnde_bridge.engines import EngineName
from pcnde_bridge.errors import InputError

if TYPE_CHECKING:
    from pcnde_bridge.model.prediction import Prediction

_IN_MEMORY = 256  # predictions of single cases, with their samples, while a table is written


def info(
    file: Path = typer.Argument(metavar="FILE", help="Model, ensemble, checkpoint or data set."),
    as_json: bool = option(False, "Print JSON, with all settings.", "--json"),
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
    model: Path = options.MODEL,
    data: str = options.DATA,
    split: str | None = options.SPLIT,
    engine: EngineName = options.ENGINE,
    json_file: Path | None = options.JSON,
    csv: Path | None = options.CSV,
) -> None:
    """Print relative errors of a model on a data set."""
    import pandas as pd

    from pcnde_bridge._utils.validation import counted
    from pcnde_bridge.data.selection import case_keys
    from pcnde_bridge.io.datasets import load_cases
    from pcnde_bridge.model.ensemble import load_model
    from pcnde_bridge.model.metrics import pooled

    check_outputs(json_file, csv, inputs=[model, Path(data)])
    fitted = load_model(model, engine)
    sets = split_of(load_cases(data), data, split, whole="all")
    known = {tuple(key) for key in fitted.provenance.get("cases_labels", ())}
    if seen := known.intersection(case_keys(sets["test"].labels) if "test" in sets else ()):
        note(
            f"{counted(len(seen), 'test case')} may not be new to the model: it was trained on "
            "cases with the same geometry and waveform (pcnde info)."
        )
    tables = {name: fitted.evaluate(cases) for name, cases in sets.items()}
    errors = {name: pooled(table) for name, table in tables.items()}
    if json_file is not None:
        write_json(json_file, errors)
    if csv is not None:
        write_csv(csv, pd.concat(tables, names=["set"]))
    show_numbers(pd.DataFrame(errors).T)


def predict(
    model: Path = options.MODEL,
    inflow: Path = option(..., "CSV: time (s), then one column of Q (mL/s) per case."),
    area: Path = option(..., "CSV: z (cm), then one column of S_u (cm²) per case."),
    out: Path = option(
        ...,
        "Result: .csv (tidy), .npz or .h5 (a data set), .vtp (centerlines, one per case) "
        "or .pvd (animation for ParaView); with --samples, .csv only.",
    ),
    engine: EngineName = options.ENGINE,
    samples: int = option(
        0,
        "Number of samples for standard deviations, which only a .csv has (preset physics; 64 "
        "are enough). An ensemble always gives standard deviations.",
        min=0,
    ),
    outlet: Path | None = options.OUTLET,
    units: str | None = options.UNITS,
    period: float | None = option(None, "Cycle length, s; a time point at its end is left out."),
    interpolate: bool = option(False, "Resample to equal time steps and to the model's grid."),
    indices: Path | None = option(
        None,
        "Also write pressure drop, FFR, resistance and other indices of each case to this "
        ".csv, with 90 % intervals where there are samples.",
        callback=options.table_file,
    ),
) -> None:
    """Predict flow, area and pressure of new cases.

    A model of the preset physics accepts any equally spaced time points of a cycle and any
    points along the vessel; other models need those of their training.
    """
    import pandas as pd

    from pcnde_bridge._utils.validation import counted, positive
    from pcnde_bridge.data.stenosis import summary
    from pcnde_bridge.data.units import in_cgs, stated_units
    from pcnde_bridge.io.input_tables import read_inputs
    from pcnde_bridge.io.predictions import check_target, save_csv
    from pcnde_bridge.model.ensemble import Ensemble, load_model

    suffix = check_target(out, has_pressure=True)
    check_outputs(out, indices, inputs=[model, inflow, area])
    if samples and suffix != ".csv":
        raise InputError("Standard deviations (--samples) are written to a .csv only.")
    fitted = load_model(model, engine)
    check_target(out, fitted.has_pressure)
    members = len(fitted.members) if isinstance(fitted, Ensemble) else 0
    if samples and members:
        raise InputError(
            f"{model} is an ensemble, whose standard deviations and intervals need no samples: "
            "leave out --samples."
        )
    fitted.check_samples(samples)
    given = read_inputs(
        inflow,
        area,
        fitted.grid,
        any_grid=fitted.any_grid,
        units=units,
        period=None if period is None else positive("--period", period, "s"),
        interpolate=interpolate,
    )
    inputs = given.inflow, given.area_undeformed
    settings: dict[str, Any] = {"units": units, "samples": samples, **given.where}
    settings["outlet"] = outlet_of(outlet)
    tables: list[pd.DataFrame] = []

    def named(prediction: Prediction) -> Prediction:
        prediction = replace(prediction, labels=given.name_labels(prediction.labels))
        if indices is not None:
            tables.append(prediction.indices())
        return prediction

    files = [out]
    if suffix == ".csv":
        batch = max(1, _IN_MEMORY // (1 + samples + members))
        count = save_csv(map(named, fitted.predict_batches(*inputs, batch=batch, **settings)), out)
    else:
        prediction = named(fitted.predict(*inputs, **settings))
        files, count = prediction.save(out), len(prediction)
    place = out if out in files else f"{files[0]} to {files[-1].name}"
    areas = in_cgs("area", given.area_undeformed, stated_units(units))
    say(summary(given.where.get("z", fitted.grid.z), areas))
    say(f"Saved {counted(count, 'case')} in {place}.")
    if indices is not None:
        write_csv(indices, pd.concat(tables), index=False)
        say(f"Saved their indices in {indices}.")


def explore(
    model: Path = options.MODEL,
    port: int = option(8050, "Port on this machine; 0: any free port.", min=0, max=65535),
    url: str = option("", "Address of the page behind a proxy, such as JupyterHub's."),
) -> None:
    """Explore a model on a web page, on this machine only."""
    from pcnde_bridge.app.server import serve
    from pcnde_bridge.model.pcnde import PCNDE

    # Julia computes in one thread only, but a server has several.
    serve(PCNDE.load(model, "jax"), model.stem, port, url)


def figures(
    model: Path = options.MODEL,
    data: str = options.DATA,
    out: Path = option(..., "Folder for PNG, PDF and CSV files."),
    only: list[str] = option([], "Figure to draw, repeatable. An unknown name prints all names."),
    studies: bool = option(False, "Include figures that train models (minutes).", "--studies"),
    split: str | None = options.SPLIT,
    engine: EngineName = options.ENGINE,
    workers: int = options.WORKERS,
) -> None:
    """Draw the paper's figures for a model and a data set.

    The numbers of most figures are written beside them.
    """
    from pcnde_bridge._utils.parallel import processes
    from pcnde_bridge.io.datasets import load_cases
    from pcnde_bridge.model.pcnde import PCNDE
    from pcnde_bridge.plots.figures import COSTS, FigureData, choose, make_figures

    choose(only)
    fitted, cases = PCNDE.load(model, engine), load_cases(data)
    sets = split_of(cases, data, split)
    lock_folder(out)
    truth_label = {"synthetic": "1D solver", "published": "3D, averaged"}.get(data, "truth")
    figure_data = FigureData(fitted, cases, sets["train"], sets.get("test"), truth_label)
    if data == "synthetic":
        figure_data.other = None
    if workers > 1:
        figure_data.executor = processes(workers)
    made = make_figures(figure_data, out, only=only, with_studies=studies, announce=note)
    for name, files in made.items():
        if files:
            say(f"{name}: {', '.join(path.name for path in files)}")
    if not only and not studies:
        costly = (f"{name} ({cost})" for name, cost in COSTS.items())
        say(f"Left out without --studies: {', '.join(costly)}.")
    say(f"The files are in {out}.")
