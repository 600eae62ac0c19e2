"""One fit as a task of an ensemble, a cross-validation or a sweep."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Unpack, cast

import pandas as pd

from pcnde_bridge._utils.parallel import RunOptions, run
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import EngineChoice, EngineName, select_engine
from pcnde_bridge.model.metrics import ERRORS, pooled
from pcnde_bridge.model.pcnde import PCNDE


@dataclass(frozen=True)
class FitTask:
    """A fit, and the cases on which its errors are wanted.

    Attributes
    ----------
    train : Cases
        Training cases.
    config : PCNDEConfig or ClosureConfig
        Settings.
    engine : {'auto', 'julia', 'jax'} or Engine
        Compute engine.
    seed : int
        Random seed of the fit.
    held_out : Cases or None
        Further cases that :func:`score_fits` evaluates.
    """

    train: Cases
    config: Config
    engine: EngineChoice
    seed: int
    held_out: Cases | None = None

    def fit(self) -> PCNDE:
        """Fit the model."""
        return PCNDE.fit(self.train, self.config, self.engine, self.seed, progress=False)


def fit_model(task: FitTask) -> dict[str, Any]:
    """Fit, and return the content of the model's file, which travels between processes."""
    facts, arrays = task.fit().to_archive()
    return {"facts": facts, **arrays}


def model_of(result: dict[str, Any], engine: EngineChoice) -> PCNDE:
    """Return the model from the result of :func:`fit_model`."""
    arrays = {name: value for name, value in result.items() if name != "facts"}
    return PCNDE.from_archive(result["facts"], arrays, engine)


def score_fits(
    tasks: Mapping[str, FitTask],
    index: pd.MultiIndex,
    facts: Mapping[str, Any],
    **options: Unpack[RunOptions],
) -> pd.DataFrame:
    """Run fits, and return their errors in columns that do not depend on failures.

    Parameters
    ----------
    tasks : mapping of str to FitTask
        Fits by name, one or more.
    index : MultiIndex
        Index of the rows, one for each task in their order.
    facts : mapping
        Facts that identify the study, see :func:`common_facts`.
    **options
        ``executor``, ``retries``, ``folder`` and ``progress``, as in
        :func:`pcnde_bridge._utils.parallel.run`.

    Returns
    -------
    DataFrame
        Columns of :data:`~pcnde_bridge.model.metrics.ERRORS` where cases were held out, NaN
        where there is no such error, ``train_flow`` and so on, ``seconds``, and ``failure``:
        the reason for missing numbers, else None.
    """
    outcome = run(_fit_and_score, tasks, facts=facts, **options)
    held_out = any(task.held_out is not None for task in tasks.values())
    prefixes = ("", "train_") if held_out else ("train_",)
    numbers = [f"{prefix}{name}" for prefix in prefixes for name in ERRORS] + ["seconds"]
    rows = [outcome.results.get(name, {}) for name in tasks]
    table = pd.DataFrame(rows, index=index, columns=numbers, dtype=float)
    table["failure"] = pd.Series(list(map(outcome.failures.get, tasks)), index, dtype=object)
    return table


def _fit_and_score(task: FitTask) -> dict[str, float]:
    """Fit, and return relative errors of both sets of cases, and seconds."""
    model = task.fit()
    scores: dict[str, float] = {}
    for prefix, cases in (("", task.held_out), ("train_", task.train)):
        if cases is not None:
            errors = pooled(model.evaluate(cases))
            scores |= {f"{prefix}{name}": error for name, error in errors.items()}
    return {**scores, "seconds": float(model.provenance["seconds"])}


def common_facts(study: str, cases: Cases, config: Config, engine: EngineChoice) -> dict[str, Any]:
    """Return the facts that identify a study, for :func:`pcnde_bridge._utils.parallel.run`."""
    return {
        "study": study,
        "cases": cases.fingerprint(),
        "config": config.to_dict(),
        "engine": engine if isinstance(engine, str) else engine.name,
    }


def same_everywhere(engine: EngineChoice) -> EngineChoice:
    """Replace ``auto`` by the engine that it selects here, so that all workers use the same.

    Raises
    ------
    EngineUnavailableError
        If the engine cannot be used here.
    """
    found = select_engine(engine)
    return cast(EngineName, found.name) if isinstance(engine, str) else engine
