"""Benchmark of a model and baselines: errors, and times of fitting and predicting."""

import hashlib
import json
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import write_json
from pcnde_bridge._version import __version__
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.evaluation.baselines import Baseline
from pcnde_bridge.model.metrics import pooled_errors
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.predictor import predict

_REPEATS, _ENOUGH_SECONDS = 5, 1.0


@dataclass(frozen=True)
class Row:
    """Results of one method.

    Attributes
    ----------
    name : str
        Name of the method.
    errors : dict
        Pooled relative errors by set (train, test), then by variable.
    fit_seconds : float or None
        Time of the fit, s; for a loaded model, the time of its training.
    predict_ms_per_case : float or None
        Time of one prediction of the test cases (else the training cases) per case, ms,
        after compilation: the median of up to five calls.
    reason : str or None
        Reason why the method is not applicable; then there are no numbers.
    """

    name: str
    errors: dict[str, dict[str, float]] = field(default_factory=dict)
    fit_seconds: float | None = None
    predict_ms_per_case: float | None = None
    reason: str | None = None


def checkpoint_name(train: Cases, config: Config, engine: str, seed: int) -> str:
    """Return the name of a checkpoint that is unique to the cases, settings and seed.

    Parameters
    ----------
    train : Cases
        Training cases.
    config : PCNDEConfig or ClosureConfig
        Settings.
    engine : str
        Engine as requested: ``auto``, ``julia`` or ``jax``.
    seed : int
        Random seed of the fit.

    Returns
    -------
    str
        ``bench-….checkpoint``.
    """
    key = json.dumps([train.fingerprint(), config.to_dict(), engine, seed])
    return f"bench-{hashlib.sha256(key.encode()).hexdigest()[:12]}.checkpoint"


def bench_model(model: PCNDE, sets: Mapping[str, Cases]) -> Row:
    """Return the errors and times of a fitted model.

    Parameters
    ----------
    model : PCNDE
        The model.
    sets : mapping of str to Cases
        ``train``, and ``test`` if there is one.

    Raises
    ------
    InputError
        If the grid of the cases is not that of the model.
    """
    errors, taken = _measure(lambda cases: predict(model, cases).variables(), sets)
    return Row(f"PCNDE ({model.engine.name})", errors, model.provenance.get("seconds"), taken)


def bench_baseline(name: str, baseline: Baseline, sets: Mapping[str, Cases]) -> Row:
    """Fit a baseline on the training cases, and return its errors and times.

    A baseline that is not applicable to the cases gives a row with the reason and without
    numbers.

    Parameters
    ----------
    name : str
        Name in the table.
    baseline : Baseline
        Unfitted baseline.
    sets : mapping of str to Cases
        ``train``, and ``test`` if there is one.
    """
    try:
        began = time.perf_counter()
        baseline.fit(sets["train"])
        fit_seconds = time.perf_counter() - began
        errors, taken = _measure(baseline.predict, sets)
    except (InputError, SolveError) as error:
        return Row(name, reason=str(error))
    return Row(name, errors, fit_seconds, taken)


def _measure(
    predict: Callable[[Cases], dict[str, Array]], sets: Mapping[str, Cases]
) -> tuple[dict[str, dict[str, float]], float]:
    """Return pooled errors of every set, and milliseconds per case of the last."""
    errors = {name: pooled_errors(predict(cases), cases) for name, cases in sets.items()}
    cases = list(sets.values())[-1]
    seconds: list[float] = []
    while len(seconds) < _REPEATS and sum(seconds) < _ENOUGH_SECONDS:
        began = time.perf_counter()
        predict(cases)
        seconds.append(time.perf_counter() - began)
    return errors, 1e3 * statistics.median(seconds) / len(cases)


def write_rows(path: StrPath, rows: Iterable[Row], **facts: Any) -> None:
    """Write rows as JSON: ``{…facts, "pcnde_bridge": version, "rows": […]}``.

    Parameters
    ----------
    path : path-like
        File to write, atomically.
    rows : iterable of Row
        Rows; each becomes an object with the attributes of :class:`Row`.
    **facts
        Further content, such as the name of the data set.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    content = {**facts, "pcnde_bridge": __version__, "rows": [asdict(row) for row in rows]}
    write_json(path, content)
