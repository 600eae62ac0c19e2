"""``pcnde demo``: the whole way from data to predictions, on data of our own."""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from pcnde_bridge._utils.files import (
    atomic_write,
    make_folder,
    write_json,
)
from pcnde_bridge._version import __version__
from pcnde_bridge.config import PCNDEConfig, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import (
    Engine,
    EngineName,
    select_engine,
)
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.evaluation.baselines import Unchanged
from pcnde_bridge.hemodynamics.synthetic import synthetic
from pcnde_bridge.model.metrics import (
    error_table,
    pooled,
    pooled_errors,
)
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots.paper_figures import hardest_case
from pcnde_bridge.training import checkpoint as checkpoints

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = (
    "model.npz",
    "cases.npz",
    "split.json",
    "errors.csv",
    "history.csv",
    "prediction.csv.gz",
    "inflow.csv",
    "area.csv",
    "prediction.png",
    "history.png",
)
"""What the demo writes, beside :data:`MARK`; each file is written whole or not at all."""

MARK = "demo.json"
"""File that says which demo a folder holds; written first, and again at the end."""

CHECKPOINT = "model.npz.checkpoint"
"""State of training, removed when the model is saved."""


@dataclass(frozen=True)
class Demo:
    """What the demo found.

    Attributes
    ----------
    folder : pathlib.Path
        Holds :data:`FILES` and :data:`MARK`.
    model : PCNDE
        The fitted model.
    errors : dict
        Relative errors by method (``"PCNDE"``, ``"no change"``), set
        (train, test) and variable, pooled.
    seconds : float
        Time of this run.
    """

    folder: Path
    model: PCNDE
    errors: dict[str, dict[str, dict[str, float]]]
    seconds: float


def run_demo(
    out: str | os.PathLike[str] = "demo",
    seed: int = 0,
    engine: EngineName | Engine = "auto",
    config: PCNDEConfig | str = "fast",
    *,
    cases: Cases | None = None,
    progress: bool = True,
) -> Demo:
    """Make the synthetic cases, train, evaluate, and write everything into a folder.

    Run again with the same arguments, it continues an interrupted training, or
    else does everything again and replaces its own files.  It never replaces
    another demo's files, nor any that it did not write.

    Parameters
    ----------
    out : path-like
        The folder, made if it is not there.
    seed : int
        Of the synthetic waveforms and of the training.
    engine : {'auto', 'julia', 'jax'} or Engine
        Who computes.
    config : PCNDEConfig or str
        Settings of the training, or a preset's name.
    cases : Cases, optional
        Cases to take in place of the synthetic ones; divided as the paper does.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    Demo
        The model and its errors.

    Raises
    ------
    InputError
        If an argument is not usable, or the folder holds another demo.
    FileError
        If the folder is a file, holds other files of the same names, or cannot
        be written.
    EngineUnavailableError
        If the engine asked for cannot be used.
    """
    began = time.perf_counter()
    settings = resolve_config(config)
    computing = select_engine(engine)
    folder = Path(out)
    facts: dict[str, Any] = {
        "kind": "pcnde-demo",
        "data": "synthetic" if cases is None else cases.fingerprint(),
        "seed": seed,
        "engine": computing.name,
        "config": json.loads(settings.to_json()),
        "version": __version__,
    }
    _claim(folder, facts)
    data = synthetic(seed=seed, progress=progress) if cases is None else cases
    train, test = data.split("paper")
    data.save(folder / "cases.npz")
    pairs = {"train": _keys(train), "test": _keys(test)}
    write_json(folder / "split.json", pairs, indent=None)

    state = folder / CHECKPOINT
    model = PCNDE.fit(
        train, settings, engine=computing, seed=seed, checkpoint=state, progress=progress
    )
    model.save(folder / "model.npz")
    checkpoints.remove(state)

    predictions = {"train": model.predict(train), "test": model.predict(test)}
    errors, table = _evaluate(predictions, {"train": train, "test": test})
    _write_table(folder / "errors.csv", table)
    _write_table(folder / "history.csv", model.history)
    truth_label = "1D solver" if cases is None else "data"
    _write_predictions(folder, predictions["test"], test, model.history, truth_label)
    seconds = time.perf_counter() - began
    results = {"finished": True, "seconds": round(seconds, 1), "errors": errors}
    write_json(folder / MARK, {**facts, **results})
    return Demo(folder, model, errors, seconds)


def _claim(folder: Path, facts: dict[str, Any]) -> None:
    """Make the folder this demo's, or say why it cannot be."""
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder} is a file; give a folder for the demo's files.")
    mark = folder / MARK
    if mark.exists():
        try:
            found = json.loads(mark.read_text(encoding="utf-8"))
            of_another = [name for name in facts if found.get(name) != facts[name]]
        except (OSError, ValueError, AttributeError, RecursionError) as error:
            raise FileError(
                f"{mark} is not a demo's: {error}. Give another folder, or remove this one."
            ) from error
        if of_another:
            raise InputError(
                f"{folder} holds the results of another demo (another {', '.join(of_another)}). "
                "Give another folder, or remove this one."
            )
        return
    foreign = [name for name in (*FILES, CHECKPOINT) if (folder / name).exists()]
    if foreign:
        raise FileError(
            f"{folder} holds {', '.join(foreign)}, which no demo has written. Give another folder."
        )
    make_folder(folder)
    write_json(mark, facts)


def _keys(cases: Cases) -> list[list[int]]:
    labels = cases.labels[["geometry", "waveform"]]
    return [[int(value) for value in row] for row in labels.to_numpy()]


def _evaluate(
    predictions: dict[str, Prediction], sets: dict[str, Cases]
) -> tuple[dict[str, dict[str, dict[str, float]]], pd.DataFrame]:
    """Pooled errors of model and baseline, and the model's errors case by case."""
    unchanged = Unchanged().fit(sets["train"])
    tables = {
        name: error_table(predictions[name].variables(), cases) for name, cases in sets.items()
    }
    errors = {
        "PCNDE": {name: pooled(table) for name, table in tables.items()},
        "no change": {
            name: pooled_errors(unchanged.predict(cases), cases) for name, cases in sets.items()
        },
    }
    return errors, pd.concat(tables, names=["set"]).reset_index()


def _write_predictions(
    folder: Path, prediction: Prediction, test: Cases, history: pd.DataFrame, truth_label: str
) -> None:
    """All test cases as a table, the hardest as a figure and as input for ``pcnde predict``."""
    from pcnde_bridge.plots import loss_history, time_and_space

    with atomic_write(folder / "prediction.csv.gz") as temporary:
        prediction.to_frame().to_csv(
            temporary, index=False, float_format="%.7g", compression="gzip"
        )
    hardest = hardest_case(test)
    inflow = {"time": test.time, "inflow": test.inflow[hardest]}
    _write_table(folder / "inflow.csv", pd.DataFrame(inflow))
    area = {"z": test.z, "area": test.area_undeformed[hardest]}
    _write_table(folder / "area.csv", pd.DataFrame(area))
    figure = time_and_space(prediction, test, hardest, truth_label=truth_label)
    _write_figure(folder / "prediction.png", figure)
    _write_figure(folder / "history.png", loss_history(history))


def _write_table(path: Path, table: pd.DataFrame) -> None:
    with atomic_write(path) as temporary:
        table.to_csv(temporary, index=False)


def _write_figure(path: Path, figure: Figure) -> None:
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=130)
