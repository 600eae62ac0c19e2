"""Activation functions of the pressure network (section 3.2 of the paper).

Flow and area do not depend on the pressure network, so only the two pressure stages are
fitted again; the results equal those of a whole fit with that activation.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.parallel import Workers, each
from pcnde_bridge._utils.validation import whole_seeds
from pcnde_bridge.config import PCNDEConfig, resolve_pcnde_config
from pcnde_bridge.config.settings import Activation
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.parameters import PRESSURE_STAGES, Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import relative_error
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.training.trainer import Trainer, staged_training

ACTIVATIONS: tuple[Activation, ...] = ("gelu", "relu", "tanh", "sigmoid", "swish")
"""Activation functions of the paper, in its order."""


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
        Model with networks (any preset but ``physics``), which gives flow and area.
    train : Cases
        Training cases of the model.
    test : Cases, optional
        Other cases to predict.
    activations : sequence of {'tanh', 'gelu', 'relu', 'sigmoid', 'swish'}
        Activation functions.
    seeds : sequence of int
        Random seeds for the initial weights of the pressure network; each activation
        function is fitted with each seed.
    executor : Executor or int, optional
        Executor, or number of processes, of the fits; by default they run in this process.
        Results are equal bit for bit if XLA has as many threads.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    DataFrame
        Indexed by ``activation`` and ``seed``.  ``train`` and ``test`` are the relative
        errors of the pressure; ``train_explained`` and ``test_explained`` are the
        fraction of its variance over time that is predicted: about 0 if the network
        learns the mean over time only, 1 at best.

    Raises
    ------
    InputError
        If the model has no pressure network, cases are not on its grid, or an argument is
        invalid.
    """
    config = resolve_pcnde_config(model.config)
    known = get_args(Activation)
    if not activations or len(set(activations)) < len(activations) or set(activations) - {*known}:
        raise InputError(f"Give some activations of {known}, none twice; got {activations}.")
    seeds = whole_seeds(seeds)
    subsets = {"train": train} if test is None else {"train": train, "test": test}
    for cases in subsets.values():
        model.check_grid(cases)
    pairs = [(activation, seed) for activation in activations for seed in seeds]
    configs = {a: config.replace(temporal_pressure={"activation": a}) for a in activations}
    tasks = {
        f"{name}, seed {seed}": (model.engine, configs[name], model.parameters, seed, subsets)
        for name, seed in pairs
    }
    rows = each(_fit_and_measure, tasks, executor, progress)
    index = pd.MultiIndex.from_tuples(pairs, names=["activation", "seed"])
    return pd.DataFrame(rows, index=index)


def fit_pressure(
    engine: Engine, config: PCNDEConfig, parameters: Parameters, seed: int, train: Cases
) -> Parameters:
    """Fit the two pressure stages again, for given flow and area.

    The result equals that of a whole fit with this seed and the same flow and area.
    """
    procedure = staged_training(train, config, engine)
    state = procedure.start(seed)
    fresh = {stage: getattr(state.parameters, stage) for stage in PRESSURE_STAGES}
    before = sum(step.task not in PRESSURE_STAGES for step in procedure.steps(state))
    state = replace(state, parameters=parameters.replace(**fresh), finished=before)
    return Trainer(procedure).complete(state, progress=False).parameters


def _fit_and_measure(
    engine: Engine, config: PCNDEConfig, parameters: Parameters, seed: int, sets: dict[str, Cases]
) -> dict[str, float]:
    """Return the pressure errors of one activation function and seed."""
    fitted = fit_pressure(engine, config, parameters, seed, sets["train"])
    row = {}
    for name, cases in sets.items():
        inputs = ModelInputs(cases.inflow, cases.area_undeformed, cases.grid)
        pressure = engine.predict(fitted, inputs, config).pressure
        assert pressure is not None
        row[name] = relative_error(pressure, cases.pressure)
        row[f"{name}_explained"] = explained_variance(pressure, cases.pressure)
    return row


def explained_variance(predicted: Array, truth: Array) -> float:
    """Return the fraction of the variance over time that is predicted.

    Parameters
    ----------
    predicted, truth : array of shape (case, time, z)
        Values of the same variable.

    Returns
    -------
    float
        1 − Σ(Y′ − Y′_GT)²/Σ Y′_GT², where Y′ is the difference from the mean over time at
        each grid point of each case.
    """
    variation = truth - truth.mean(axis=1, keepdims=True)
    error = predicted - predicted.mean(axis=1, keepdims=True) - variation
    return float(1 - np.sum(error**2) / np.sum(variation**2))
