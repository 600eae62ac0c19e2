"""Activation functions of the pressure network (section 3.2 of the paper).

Flow and area do not know the pressure network, so only the two pressure stages are
fitted again, to the same numbers as in a whole fit with that activation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.parallel import Workers, each
from pcnde_bridge._utils.validation import whole_seeds
from pcnde_bridge.config import Activation, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.parameters import PRESSURE_STAGES, Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import relative_error
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.training.trainer import (
    Trainer,
    TrainingState,
    plan,
)

ACTIVATIONS: tuple[Activation, ...] = ("gelu", "relu", "tanh", "sigmoid", "swish")
"""The paper's, in its order."""


def activation_study(
    model: PCNDE,
    train: Cases,
    test: Cases | None = None,
    *,
    activations: Sequence[Activation] = ACTIVATIONS,
    seeds: Sequence[int] = (0,),
    executor: Workers | None = None,
    progress: bool = True,
) -> pd.DataFrame:
    """Fit the pressure stages of a model with each activation function.

    Parameters
    ----------
    model : PCNDE
        A model with networks (any preset but ``physics``), which gives flow and area.
    train : Cases
        Its training cases.
    test : Cases, optional
        Other cases to predict.
    activations : sequence of str
        Of 'tanh', 'gelu', 'relu', 'sigmoid' and 'swish'.
    seeds : sequence of int
        Of the pressure network's first weights; all activations are fitted with each.
    executor : Executor, or callable that makes one, optional
        Who runs the fits; None runs them here.  The same bits come of
        as many threads of XLA, see :mod:`pcnde_bridge._utils.parallel`.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    DataFrame
        Indexed by ``activation`` and ``seed``.  ``train`` and ``test`` are the relative
        errors of the pressure; ``train_explained`` and ``test_explained`` the part of
        its variance over time that is predicted: about 0 if only the mean over time is
        learnt, 1 at best.

    Raises
    ------
    InputError
        If the model has no pressure network, cases are not on its grid, or an argument is
        not usable.
    """
    config = model.config
    if not isinstance(config, PCNDEConfig) or not isinstance(model.parameters, Parameters):
        raise InputError(
            "A model of the preset physics has no pressure network whose activation could be "
            "changed. Give a model of the preset paper or fast."
        )
    unknown = [name for name in activations if name not in get_args(Activation)]
    if unknown or not activations or len(set(activations)) < len(activations):
        raise InputError(
            f"Give at least one activation of {list(get_args(Activation))}, and none twice; got "
            f"{list(activations)}."
        )
    seeds = whole_seeds(seeds)
    for cases in (train, test):
        if cases is not None:
            model.check_grid(cases)
    pairs = [(activation, seed) for activation in activations for seed in seeds]
    tasks = {
        f"{name}, seed {seed}": (
            model.engine,
            config.replace(temporal_pressure={"activation": name}),
            model.parameters,
            seed,
            train,
            test,
        )
        for name, seed in pairs
    }
    rows = each(_fit_and_measure, tasks, executor, progress)
    index = pd.MultiIndex.from_tuples(pairs, names=["activation", "seed"])
    return pd.DataFrame(rows, index=index)


def fit_pressure(
    engine: Engine, config: PCNDEConfig, parameters: Parameters, seed: int, train: Cases
) -> Parameters:
    """Fit the two pressure stages anew, with flow and area as they are.

    The same numbers as of a whole fit with this seed, if its flow and area are these.
    """
    first = TrainingState.start(train, config, seed)
    fresh = {stage: getattr(first.parameters, stage) for stage in PRESSURE_STAGES}
    units = plan(config, len(first.batches))
    before = sum(unit.work not in PRESSURE_STAGES for unit in units)
    state = TrainingState(seed, first.batches, parameters.replace(**fresh), finished=before)
    with threadpool_limits(1, user_api="blas"):  # as in a whole fit
        return Trainer(train, config, engine).run(state).parameters


def _fit_and_measure(
    engine: Engine,
    config: PCNDEConfig,
    parameters: Parameters,
    seed: int,
    train: Cases,
    test: Cases | None,
) -> dict[str, Any]:
    """Errors of the pressure with one activation."""
    fitted = fit_pressure(engine, config, parameters, seed, train)
    row = {}
    for name, cases in (("train", train), ("test", test)):
        if cases is None:
            continue
        grid = cases.grid
        solved = engine.predict(fitted, cases.inflow, cases.area_undeformed, grid, config)
        assert solved.pressure is not None
        row[name] = relative_error(solved.pressure, cases.pressure)
        row[f"{name}_explained"] = explained_variation(solved.pressure, cases.pressure)
    return row


def explained_variation(predicted: Array, truth: Array) -> float:
    """Part of the variance over time, at each point of each case, that is predicted.

    Parameters
    ----------
    predicted, truth : array of shape (case, time, z)
        Of the same variable.

    Returns
    -------
    float
        1 − Σ(Y′ − Y′_GT)²/Σ Y′_GT², with Y′ the difference from the mean over time.
    """
    varies = truth - truth.mean(axis=1, keepdims=True)
    wrong = predicted - predicted.mean(axis=1, keepdims=True) - varies
    return float(1 - np.sum(wrong**2) / np.sum(varies**2))
