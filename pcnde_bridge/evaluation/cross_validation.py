"""Cross-validation of the training cases by whole waveforms and whole geometries."""

from typing import Unpack

import numpy as np
import pandas as pd

from pcnde_bridge._utils.parallel import RunOptions
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.config import Config, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import each_waveform_and_geometry
from pcnde_bridge.engines import EngineChoice
from pcnde_bridge.hemodynamics.outlet import Outlet
from pcnde_bridge.model.fit_task import FitTask, common_facts, same_everywhere, score_fits


def cross_validate(
    cases: Cases,
    config: Config | str = "paper",
    engine: EngineChoice = "auto",
    seed: int = 0,
    *,
    outlet: Outlet | None = None,
    **options: Unpack[RunOptions],
) -> pd.DataFrame:
    """Fit without each waveform and each geometry in turn, and evaluate on it.

    Parameters
    ----------
    cases : Cases
        Training cases.  Settings chosen by these errors leave the test cases independent.
    config, engine, seed, outlet
        As in :meth:`pcnde_bridge.PCNDE.fit`.
    **options
        ``executor``, ``retries``, ``folder`` and ``progress``, as in
        :func:`pcnde_bridge._utils.parallel.run`.

    Returns
    -------
    DataFrame
        Indexed by ``label`` (waveform or geometry) and ``value``.  Columns: ``cases``, the
        number of cases held out; their relative errors, such as ``flow``, see
        :data:`~pcnde_bridge.model.metrics.ERRORS`; those of the training cases,
        ``train_flow`` and so on; ``seconds`` of the fit; ``failure``, the reason for missing
        numbers, else None.

    Raises
    ------
    InputError
        If no waveform or geometry can be held out, or an argument is not usable.

    Examples
    --------
    >>> from pcnde_bridge import cross_validate, load_cases
    >>> train = load_cases("published").split("paper").train  # doctest: +SKIP
    >>> cross_validate(train, "fast").groupby("label").mean(numeric_only=True)  # doctest: +SKIP
    """
    seed = whole("seed", seed)
    settings = resolve_config(config)
    engine = same_everywhere(engine)
    facts = {**common_facts("cross-validation", cases, settings, engine, outlet), "seed": seed}
    folds = each_waveform_and_geometry(cases)
    tasks = {}
    for (label, value), positions in folds.items():
        rest = np.setdiff1d(np.arange(len(cases)), positions)
        tasks[f"{label} {value}"] = FitTask(
            cases.select(rest),
            settings,
            engine,
            seed,
            cases.select(positions),
            outlet and outlet.select(rest),
            outlet and outlet.select(positions),
        )
    index = pd.MultiIndex.from_tuples(folds, names=["label", "value"])
    table = score_fits(tasks, index, facts, **options)
    table.insert(0, "cases", [len(positions) for positions in folds.values()])
    return table
