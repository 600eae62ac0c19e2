"""Cross-validation inside the training cases: whole waveforms and whole geometries held out."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.parallel import Workers, run
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.config import (
    ClosureConfig,
    PCNDEConfig,
    resolve_config,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import each_waveform_and_geometry
from pcnde_bridge.engines import EngineName
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.model.fit_task import (
    FitTask,
    common_facts,
    fit_and_score,
    same_everywhere,
    score_table,
)


def cross_validate(
    cases: Cases,
    config: PCNDEConfig | ClosureConfig | str = "paper",
    engine: EngineName | Engine = "auto",
    seed: int = 0,
    *,
    executor: Workers | None = None,
    retries: int = 1,
    folder: StrPath | None = None,
    progress: bool = True,
) -> pd.DataFrame:
    """Fit without each waveform and each geometry in turns, and predict it.

    Parameters
    ----------
    cases : Cases
        The training cases.  Choose settings by these errors, so that those on the test
        cases stay a test.
    config, engine, seed
        As of :meth:`pcnde_bridge.PCNDE.fit`.
    executor, retries, folder, progress
        As of :func:`pcnde_bridge._utils.parallel.run`.

    Returns
    -------
    DataFrame
        Indexed by ``label`` (waveform or geometry) and ``value``; columns ``cases``
        (held out), the relative errors ``flow``, ``area`` and ``pressure`` of these,
        ``train_flow`` and so on, ``seconds`` of the fit, and ``failure``, why there are no
        numbers, else None.

    Raises
    ------
    InputError
        If nothing can be held out, or an argument is not usable.

    Examples
    --------
    >>> from pcnde_bridge import cross_validate, load_cases
    >>> train = load_cases("published").split("paper").train  # doctest: +SKIP
    >>> cross_validate(train, "fast").groupby("label").mean(numeric_only=True)  # doctest: +SKIP
    """
    seed = whole("seed", seed)
    settings = resolve_config(config)
    engine = same_everywhere(engine)
    chosen = each_waveform_and_geometry(cases)
    everything = np.arange(len(cases))
    tasks = {
        f"{label} {value}": FitTask(
            cases.select(np.setdiff1d(everything, positions)),
            settings,
            engine,
            seed,
            cases.select(positions),
        )
        for (label, value), positions in chosen.items()
    }
    outcome = run(
        fit_and_score,
        tasks,
        executor=executor,
        retries=retries,
        folder=folder,
        facts={**common_facts("cross-validation", cases, settings, engine), "seed": seed},
        progress=progress,
    )
    index = pd.MultiIndex.from_tuples(list(chosen), names=["label", "value"])
    table = score_table(tasks, outcome, index)
    table.insert(0, "cases", [len(positions) for positions in chosen.values()])
    return table
