"""``pcnde demo``: from synthetic data to a fitted model and its predictions."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import atomic_write, make_folder, write_json
from pcnde_bridge._version import __version__
from pcnde_bridge.config import PCNDEConfig, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import EngineChoice, select_engine
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.evaluation.baselines import Unchanged
from pcnde_bridge.hemodynamics.synthetic import synthetic
from pcnde_bridge.model.metrics import error_table, pooled, pooled_errors
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.plots import loss_history, time_and_space
from pcnde_bridge.plots.paper_figures import hardest_case
from pcnde_bridge.training import checkpoint as checkpoints

_TABLES = ("errors.csv", "history.csv", "prediction.csv.gz", "inflow.csv", "area.csv")
FILES = ("model.npz", "cases.npz", "split.json", *_TABLES, "prediction.png", "history.png")
"""Files of the demo beside :data:`MARK`; each is written as a whole or not at all."""

MARK = "demo.json"
"""File that identifies the demo in a folder; written first, and again at the end."""

CHECKPOINT = "model.npz.checkpoint"
"""State of training, removed when the model is saved."""

NEXT_STEPS = """Took {seconds:.0f} s. In {folder}:
  model.npz           the model
  cases.npz           the 100 simulated cases; split.json, the training and the test cases
  errors.csv          errors of every case; history.csv, the loss of every iteration
  prediction.csv.gz   flow, area and pressure of the test cases
  prediction.png      the hardest test case; history.png, the loss
To predict with your own waveform and vessel in these two files:
  pcnde predict {folder}/model.npz --inflow {folder}/inflow.csv --area {folder}/area.csv --out mine.csv
To compare the model with simpler methods:
  pcnde bench {folder}/cases.npz --model {folder}/model.npz
To train on the paper's 3D simulations, as in the paper:
  pcnde fit published --out model.npz"""  # noqa: E501


class Demo(NamedTuple):
    """Result of the demo.

    Attributes
    ----------
    model : PCNDE
        Fitted model.
    errors : dict
        Relative errors over all cases, by method (``"PCNDE"``, ``"no change"``), set
        (train, test) and variable.
    seconds : float
        Time of this run.
    """

    model: PCNDE
    errors: dict[str, dict[str, dict[str, float]]]
    seconds: float


def run_demo(
    out: StrPath = "demo",
    seed: int = 0,
    engine: EngineChoice = "auto",
    config: PCNDEConfig | str = "fast",
    *,
    cases: Cases | None = None,
    progress: bool = True,
) -> Demo:
    """Create synthetic cases, train, evaluate, and write all results into a folder.

    A second run with the same arguments resumes an interrupted training, or else
    repeats everything and replaces its own files.  It never replaces the files of
    another demo, nor any other files.

    Parameters
    ----------
    out : path-like
        Folder, created if missing.
    seed : int
        Random seed of the synthetic waveforms and of the training.
    engine : {'auto', 'julia', 'jax'} or Engine
        Compute engine.
    config : PCNDEConfig or str
        Settings of the training, or the name of a preset.
    cases : Cases, optional
        Cases in place of the synthetic ones; they are divided as in the paper.
    progress : bool
        Whether to show progress on standard error.

    Returns
    -------
    Demo
        The model and its errors.

    Raises
    ------
    InputError
        If an argument is not usable, or the folder holds another demo.
    FileError
        If the folder is a file, holds other files with the same names, or cannot
        be written.
    EngineUnavailableError
        If the engine cannot be used.
    """
    began = time.perf_counter()
    settings = resolve_config(config)
    selected = select_engine(engine)
    folder = Path(out)
    facts: dict[str, Any] = {
        "kind": "pcnde-demo",
        "data": "synthetic" if cases is None else cases.fingerprint(),
        "seed": seed,
        "engine": selected.name,
        "config": json.loads(settings.to_json()),
        "version": __version__,
    }
    _claim(folder, facts)
    data = synthetic(seed=seed, progress=progress) if cases is None else cases
    sets = data.split("paper")._asdict()
    data.save(folder / "cases.npz")
    write_json(folder / "split.json", {n: _keys(part) for n, part in sets.items()}, indent=None)

    state = folder / CHECKPOINT
    model = PCNDE.fit(
        sets["train"], settings, engine=selected, seed=seed, checkpoint=state, progress=progress
    )
    model.save(folder / "model.npz")
    checkpoints.remove(state)

    errors = _write_results(folder, model, sets, "1D solver" if cases is None else "data")
    seconds = time.perf_counter() - began
    results = {"finished": True, "seconds": round(seconds, 1), "errors": errors}
    write_json(folder / MARK, {**facts, **results})
    return Demo(model, errors, seconds)


def _claim(folder: Path, facts: dict[str, Any]) -> None:
    """Mark the folder as this demo's, unless it holds other files."""
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder} is a file; give a folder for the demo's files.")
    mark = folder / MARK
    if mark.exists():
        try:
            found = json.loads(mark.read_text(encoding="utf-8"))
            differences = [name for name in facts if found.get(name) != facts[name]]
        except (OSError, ValueError, AttributeError, RecursionError) as error:
            raise FileError(
                f"{mark} is not a demo's: {error}. Give another folder, or remove this one."
            ) from error
        if differences:
            raise InputError(
                f"{folder} holds the results of another demo (another {', '.join(differences)}). "
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
    keys: list[list[int]] = labels.to_numpy(dtype=int).tolist()
    return keys


def _write_results(
    folder: Path, model: PCNDE, sets: dict[str, Cases], truth_label: str
) -> dict[str, dict[str, dict[str, float]]]:
    """Write errors, history, predictions and figures; return the errors over all cases."""
    predictions = {name: model.predict(cases) for name, cases in sets.items()}
    tables = {name: error_table(predictions[name].variables(), sets[name]) for name in sets}
    baseline = Unchanged().fit(sets["train"])
    errors = {
        "PCNDE": {name: pooled(table) for name, table in tables.items()},
        "no change": {n: pooled_errors(baseline.predict(part), part) for n, part in sets.items()},
    }
    test, prediction = sets["test"], predictions["test"]
    hardest = hardest_case(test)
    inflow = pd.DataFrame({"time": test.time, "inflow": test.inflow[hardest]})
    area = pd.DataFrame({"z": test.z, "area": test.area_undeformed[hardest]})
    all_errors = pd.concat(tables, names=["set"]).reset_index()
    written = all_errors, model.history, prediction.to_frame(), inflow, area
    for name, table in zip(_TABLES, written, strict=True):
        with atomic_write(folder / name) as temporary:  # its ending also selects the compression
            digits = "%.7g" if name.startswith("prediction") else None
            table.to_csv(temporary, index=False, float_format=digits)
    figure = time_and_space(prediction, test, hardest, truth_label=truth_label)
    _write_figure(folder / "prediction.png", figure)
    _write_figure(folder / "history.png", loss_history(model.history))
    return errors


def _write_figure(path: Path, figure: Figure) -> None:
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=130)
