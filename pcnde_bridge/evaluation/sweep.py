"""Sweeps over settings and random seeds on the same cases."""

from collections.abc import Mapping, Sequence
from typing import Unpack

import pandas as pd

from pcnde_bridge._utils.parallel import RunOptions
from pcnde_bridge._utils.validation import whole_seeds
from pcnde_bridge.config import Config, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import EngineChoice
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.outlet import Outlet
from pcnde_bridge.model.fit_task import FitTask, common_facts, same_everywhere, score_fits
from pcnde_bridge.model.inputs import check_cases
from pcnde_bridge.model.kinds import kind_of


def sweep(
    train: Cases,
    held_out: Cases | None,
    configs: Mapping[str, Config | str],
    seeds: Sequence[int] = (0,),
    engine: EngineChoice = "auto",
    *,
    outlet: Outlet | None = None,
    **options: Unpack[RunOptions],
) -> pd.DataFrame:
    """Fit every configuration with every seed, and return the errors.

    Parameters
    ----------
    train : Cases
        Training cases.
    held_out : Cases or None
        Further cases to evaluate.
    configs : mapping of str to PCNDEConfig, ClosureConfig or str
        Mapping from a name of your choice to settings or the name of a preset.
    seeds : sequence of int
        Random seeds of the fits.
    engine
        As in :meth:`pcnde_bridge.PCNDE.fit`.
    outlet : Outlet, optional
        One outlet for all cases, see :meth:`pcnde_bridge.PCNDE.fit`.
    **options
        ``executor``, ``retries``, ``folder`` and ``progress``, as in
        :func:`pcnde_bridge._utils.parallel.run`.

    Returns
    -------
    DataFrame
        Indexed by ``config`` and ``seed``; columns as in
        :func:`pcnde_bridge.cross_validate`, without ``cases``.

    Raises
    ------
    InputError
        If there is nothing to fit, a seed is repeated, a preset is unknown, or a model
        with these settings cannot predict on the grid of ``held_out``.

    Examples
    --------
    >>> from pcnde_bridge import PRESETS, sweep
    >>> wider = PRESETS["fast"].replace(flow={"hidden": [16, 16]})
    >>> sweep(train, test, {"fast": "fast", "wider": wider}, seeds=range(3))  # doctest: +SKIP
    """
    check_cases("train", train)
    if not isinstance(configs, Mapping) or not configs:
        raise InputError("sweep needs a mapping of names to configurations: at least one.")
    seeds = whole_seeds(seeds)
    settings = {name: resolve_config(config) for name, config in configs.items()}
    if held_out is not None:
        check_cases("held_out", held_out)
        for config in settings.values():
            kind_of(config).check_grid(train.grid, held_out.grid, "train")
    engine = same_everywhere(engine)
    keys = [(name, seed) for name in settings for seed in seeds]
    tasks = {
        f"{name}, seed {seed}": FitTask(train, settings[name], engine, seed, held_out, outlet)
        for name, seed in keys
    }
    facts = {
        "held_out": None if held_out is None else held_out.fingerprint(),
        "configs": {
            name: common_facts("sweep", train, config, engine, outlet)
            for name, config in settings.items()
        },
    }
    index = pd.MultiIndex.from_tuples(keys, names=["config", "seed"])
    return score_fits(tasks, index, facts, **options)
