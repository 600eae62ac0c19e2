"""``pcnde demo``: from synthetic data to a fitted model and its predictions."""

import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import atomic_write, make_folder, reading, write_csv, write_json
from pcnde_bridge._version import __version__
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import case_keys
from pcnde_bridge.engines import EngineChoice, select_engine
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.evaluation.baselines import Unchanged
from pcnde_bridge.hemodynamics.synthetic import synthetic
from pcnde_bridge.model.metrics import pooled, pooled_errors
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.plots import loss_history, time_and_space
from pcnde_bridge.training import checkpoint as checkpoints

FILES = (
    *("model.npz", "cases.npz", "split.json", "prediction.png", "history.png"),
    *("errors.csv", "history.csv", "prediction.csv.gz", "inflow.csv", "area.csv"),
)
"""Files of the demo beside :data:`MARK`; each is written as a whole or not at all."""

MARK = "demo.json"
"""File that identifies the demo in a folder; written first, and again at the end."""

CHECKPOINT = "model.npz.checkpoint"
"""State of training, removed when the model is saved."""

_WAVEFORM = 3  # left out of the training, and predicted
_SAMPLES = 64

STORY = """
The model was trained on {trained} simulated vessels at maximal flow, and predicted {predicted}
with another waveform. The narrowest is {blockage:.0%} blocked:
  FFR   {ffr:.3f}{limits}, simulated {simulated:.3f}; below 0.80 a stenosis is usually treated
  drop  {drop:.1f} mmHg, simulated {simulated_drop:.1f} mmHg
Took {seconds:.0f} s. In {folder}:
  prediction.png      this vessel; history.png, the loss
  model.npz           the model
  cases.npz           the simulated vessels; split.json, those for training and test
  errors.csv          errors of every case; history.csv, the loss of every iteration
  prediction.csv.gz   flow, area and pressure of the test cases
Put your own waveform and vessel into these two files, and predict them:
  pcnde predict {folder}/model.npz --inflow {folder}/inflow.csv --area {folder}/area.csv \\
    --samples 64 --out mine.csv --indices indices.csv
Explore the model on a page, or compare it with simpler methods:
  pcnde app {folder}/model.npz
  pcnde bench {folder}/cases.npz --split {folder}/split.json --model {folder}/model.npz
Train on the paper's 3D simulations (50 MB):
  pcnde fit published --preset physics --out model.npz"""


class Demo(NamedTuple):
    """Result of the demo.

    Attributes
    ----------
    model : PCNDE
        Fitted model.
    errors : dict
        Relative errors over all cases, by method (``"PCNDE"``, ``"no change"``), set
        (train, test) and variable.
    story : str
        Result of the narrowest test vessel, and what to do next.
    """

    model: PCNDE
    errors: dict[str, dict[str, dict[str, float]]]
    story: str


def run_demo(out: StrPath = "demo", seed: int = 0, engine: EngineChoice = "auto") -> Demo:
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

    Returns
    -------
    Demo
        The model and its errors.

    Raises
    ------
    InputError
        If the folder holds another demo.
    FileError
        If the folder is a file, holds other files with the same names, or cannot
        be written.
    EngineUnavailableError
        If the engine cannot be used.
    """
    began = time.perf_counter()
    selected = select_engine(engine)
    folder = Path(out)
    facts: dict[str, Any] = {
        "kind": "pcnde-demo",
        "data": "synthetic",
        "seed": seed,
        "engine": selected.name,
        "config": json.loads(PHYSICS.to_json()),
        "version": __version__,
    }
    _claim(folder, facts)
    cases = synthetic(8, 5, seed, hyperemia=4.0)
    cases.save(folder / "cases.npz")
    sets = cases.split(waveform=_WAVEFORM)._asdict()
    pairs = {name: case_keys(subset.labels) for name, subset in sets.items()}
    write_json(folder / "split.json", pairs, indent=None)

    state = folder / CHECKPOINT
    model = PCNDE.fit(sets["train"], PHYSICS, engine=selected, seed=seed, checkpoint=state)
    model.save(folder / "model.npz")
    checkpoints.remove(state)

    test = sets["test"]
    prediction = model.predict(
        test, samples=0 if model.uncertainty is None else _SAMPLES, seed=seed
    )
    errors = _write_results(folder, model, sets, prediction)
    seconds = time.perf_counter() - began
    results = {"finished": True, "seconds": round(seconds, 1), "errors": errors}
    write_json(folder / MARK, {**facts, **results})
    counts = {"trained": len(sets["train"]), "predicted": len(test)}
    return Demo(model, errors, _tell(prediction, test, folder=folder, seconds=seconds, **counts))


def _tell(prediction: Prediction, test: Cases, **facts: Any) -> str:
    """Return the story of the narrowest test vessel."""
    case = _narrowest(test)
    found, simulated = prediction.indices().iloc[case], test.indices().iloc[case]
    limits = ""
    if "ffr_low" in found:
        limits = f" (90 % interval {found['ffr_low']:.3f} to {found['ffr_high']:.3f})"
    drops = {"drop": found["mean_drop_mmHg"], "simulated_drop": simulated["mean_drop_mmHg"]}
    ffr = {"ffr": found["ffr"], "simulated": simulated["ffr"], "limits": limits}
    return STORY.format(blockage=found["blockage"], **ffr, **drops, **facts)


def _narrowest(cases: Cases) -> int:
    return int(cases.labels["blockage"].argmax())


def _claim(folder: Path, facts: dict[str, Any]) -> None:
    """Mark the folder as this demo's, unless it holds other files."""
    make_folder(folder)
    mark = folder / MARK
    if mark.exists():
        with reading(mark, "a demo's mark"):
            found = json.loads(mark.read_text(encoding="utf-8"))
            differences = [name for name in facts if found.get(name) != facts[name]]
        if differences:
            raise InputError(
                f"{folder} holds the results of another demo (another {', '.join(differences)}). "
                "Give another folder, or remove this one."
            )
    elif foreign := [name for name in (*FILES, CHECKPOINT) if (folder / name).exists()]:
        raise FileError(
            f"{folder} holds {', '.join(foreign)}, which no demo has written. Give another folder."
        )
    else:
        write_json(mark, facts)


def _write_results(
    folder: Path, model: PCNDE, sets: dict[str, Cases], prediction: Prediction
) -> dict[str, dict[str, dict[str, float]]]:
    """Write errors, history, predictions and figures; return the errors over all cases."""
    tables = {name: model.evaluate(cases) for name, cases in sets.items()}
    baseline = Unchanged().fit(sets["train"])
    test, case = sets["test"], _narrowest(sets["test"])
    for name, table in {
        "errors.csv": pd.concat(tables, names=["set"]).reset_index(),
        "history.csv": model.history,
        "inflow.csv": pd.DataFrame({"time": test.time, "inflow": test.inflow[case]}),
        "area.csv": pd.DataFrame({"z": test.z, "area": test.area_undeformed[case]}),
    }.items():
        write_csv(folder / name, table, index=False)
    write_csv(folder / "prediction.csv.gz", prediction.to_frame(), index=False, float_format="%.7g")
    for name, figure in {
        "prediction.png": time_and_space(prediction, test, case, truth_label="1D solver"),
        "history.png": loss_history(model.history),
    }.items():
        with atomic_write(folder / name) as temporary:
            figure.savefig(temporary, dpi=130)
    return {
        "PCNDE": {name: pooled(table) for name, table in tables.items()},
        "no change": {n: pooled_errors(baseline.predict(part), part) for n, part in sets.items()},
    }
