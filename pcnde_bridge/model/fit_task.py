"""One fit as a task of an ensemble, a cross-validation or a sweep."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Unpack, cast

import numpy as np
import pandas as pd

from pcnde_bridge._utils.parallel import RunOptions, run
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import EngineChoice, EngineName, select_engine
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.outlet import Outlet
from pcnde_bridge.model.kinds import kind_of
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
    outlet, held_out_outlet : Outlet or None
        Outlets of both, see :meth:`PCNDE.fit`; one that is common to the training cases is also
        that of the others.

    Raises
    ------
    InputError
        If the outlet of the further cases is not known.
    """

    train: Cases
    config: Config
    engine: EngineChoice
    seed: int
    held_out: Cases | None = None
    outlet: Outlet | None = None
    held_out_outlet: Outlet | None = None

    def __post_init__(self) -> None:
        known = self.outlet is None or self.outlet.is_common or self.held_out_outlet is not None
        if self.held_out is not None and not known:
            raise InputError("outlet must be common to all cases here, not one for each.")

    def fit(self) -> PCNDE:
        """Fit the model."""
        run = self.train, self.config, self.engine, self.seed
        return PCNDE.fit(*run, progress=False, outlet=self.outlet)


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
    held_out = "", task.held_out, task.held_out_outlet
    for prefix, cases, outlet in (held_out, ("train_", task.train, task.outlet)):
        if cases is not None:
            errors = pooled(model.evaluate(cases, outlet))
            scores |= {f"{prefix}{name}": error for name, error in errors.items()}
    return {**scores, "seconds": float(model.provenance["seconds"])}


def common_facts(
    study: str, cases: Cases, config: Config, engine: EngineChoice, outlet: Outlet | None
) -> dict[str, Any]:
    """Return the facts that identify a study, for :func:`pcnde_bridge._utils.parallel.run`.

    Raises
    ------
    InputError
        If the outlet does not suit models with these settings, or the cases.
    """
    if outlet is not None:
        kind_of(config).check_outlet(outlet)
        outlet.values(len(cases), cases.time, cases.period, np.ones(len(cases)))  # checks it
    return {
        "study": study,
        "cases": cases.fingerprint(),
        "config": config.to_dict(),
        "engine": engine if isinstance(engine, str) else engine.name,
        **({} if outlet is None else {"outlet": outlet.to_dict()}),
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
