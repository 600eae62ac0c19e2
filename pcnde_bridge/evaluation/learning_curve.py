"""Errors over the number of training cases, for designed and for random choices."""

from collections.abc import Sequence
from typing import Unpack

import numpy as np
import pandas as pd

from pcnde_bridge._utils.parallel import RunOptions
from pcnde_bridge._utils.validation import all_of, whole
from pcnde_bridge.config import Config, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.engines import EngineChoice
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.evaluation.design import choose
from pcnde_bridge.hemodynamics.outlet import Outlet
from pcnde_bridge.model.fit_task import FitTask, common_facts, same_everywhere, score_fits
from pcnde_bridge.model.inputs import check_cases
from pcnde_bridge.model.kinds import kind_of


def learning_curve(
    train: Cases,
    test: Cases,
    sizes: Sequence[int],
    config: Config | str = "physics",
    engine: EngineChoice = "auto",
    seed: int = 0,
    *,
    draws: int = 20,
    outlet: Outlet | None = None,
    **options: Unpack[RunOptions],
) -> pd.DataFrame:
    """Fit designed and random subsets of the training cases, and evaluate them.

    Parameters
    ----------
    train, test : Cases
        Cases to choose from, and cases to evaluate.
    sizes : sequence of int
        Numbers of training cases.
    config, engine, seed
        As in :meth:`pcnde_bridge.PCNDE.fit`; the seed also draws the random subsets.
    draws : int
        Number of random subsets of each size.
    outlet : Outlet, optional
        One outlet for all cases, see :meth:`pcnde_bridge.PCNDE.fit`.
    **options
        ``executor``, ``retries``, ``folder`` and ``progress``, as in
        :func:`pcnde_bridge._utils.parallel.run`.

    Returns
    -------
    DataFrame
        Indexed by ``size`` and ``subset``: ``designed`` (see
        :func:`pcnde_bridge.evaluation.design.choose`) or ``random 0``, ….  Columns: the errors
        of the test cases (:data:`pcnde_bridge.model.metrics.ERRORS`), those of the training
        cases, ``train_flow`` and so on, ``seconds``, and ``failure``, as those of
        :func:`pcnde_bridge.cross_validate`.

    Raises
    ------
    InputError
        If a size is larger than the number of training cases, an argument is not usable, or a
        model with these settings cannot predict on the grid of ``test``.
    """
    check_cases("train", train)
    check_cases("test", test)
    sizes = [whole(f"sizes[{i}]", size, 1) for i, size in enumerate(all_of(object, "sizes", sizes))]
    if not sizes or max(sizes) > len(train):
        raise InputError(f"sizes must be numbers up to {len(train)}, got {sizes}.")
    subsets = _subsets(train, sizes, whole("draws", draws), whole("seed", seed))
    settings, engine = resolve_config(config), same_everywhere(engine)
    kind_of(settings).check_grid(train.grid, test.grid, "train")
    tasks = {
        f"{size} {name}": FitTask(train.select(subset), settings, engine, seed, test, outlet)
        for (size, name), subset in subsets.items()
    }
    index = pd.MultiIndex.from_tuples(subsets, names=["size", "subset"])
    facts = {
        **common_facts("learning curve", train, settings, engine, outlet),
        "test": test.fingerprint(),
        "seed": seed,
        "subsets": [subset.tolist() for subset in subsets.values()],
    }
    return score_fits(tasks, index, facts, **options)


def _subsets(
    train: Cases, sizes: Sequence[int], draws: int, seed: int
) -> dict[tuple[int, str], Positions]:
    """Return the positions of the training cases of each subset, by size and name."""
    inputs = ModelInputs(train.inflow, train.area_undeformed, train.grid)
    order = choose(inputs, max(sizes))["case"].to_numpy()
    rng = np.random.default_rng(seed)
    found = {}
    for size in sizes:
        found[size, "designed"] = order[:size]
        for draw in range(draws):
            found[size, f"random {draw}"] = rng.choice(len(train), size, replace=False)
    return found
