"""What differs between the two kinds of model: the paper's networks, and the closures.

:class:`~pcnde_bridge.model.pcnde.PCNDE` is one class for both; its configuration says which.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.closure_parameters import CLOSURES, ClosureParameters
from pcnde_bridge.engines.parameters import STAGES, Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import Solution
from pcnde_bridge.errors import InputError
from pcnde_bridge.training.checkpoint import State
from pcnde_bridge.training.closure_trainer import ClosureTrainer
from pcnde_bridge.training.history import Iteration, OnRecord
from pcnde_bridge.training.progress import listening
from pcnde_bridge.training.trainer import Trainer
from pcnde_bridge.uncertainty.sampling import Uncertainty

Config = PCNDEConfig | ClosureConfig


class Trained(NamedTuple):
    """Result of a training run; ``facts`` are kept in the model's provenance."""

    config: Config
    parameters: Parameters | ClosureParameters
    uncertainty: Uncertainty | None
    history: tuple[Iteration, ...]
    facts: dict[str, Any]


def train(
    cases: Cases,
    config: Config,
    engine: Engine,
    seed: int,
    checkpoint: str | os.PathLike[str] | None,
    progress: bool | OnRecord,
) -> Trained:
    """Train from the start or from the checkpoint; see :meth:`PCNDE.fit`."""
    if isinstance(config, ClosureConfig):
        closures = ClosureTrainer(cases, config, engine, checkpoint)
        end = _run(closures, seed, progress)
        parameters, facts = end.parameters, {"seconds": end.seconds}
        return Trained(closures.config, parameters, end.uncertainty, end.history, facts)
    state = _run(Trainer(cases, config, engine, checkpoint), seed, progress)
    batches = [[int(i) for i in batch] for batch in state.batches]
    of_run = {"seconds": state.seconds, "batches": batches}
    return Trained(config, state.parameters, None, state.history, of_run)


class _Trainer(Protocol[State]):
    on_record: OnRecord | None

    def start(self, seed: int) -> State: ...
    def total(self, state: State, /) -> int: ...
    def run(self, state: State) -> State: ...


def _run(trainer: _Trainer[State], seed: int, progress: bool | OnRecord) -> State:
    """Run to the end from the start or from the checkpoint."""
    state = trainer.start(seed)
    # Sums of several threads depend on their number, which worker processes may limit;
    # these matrices are too small for threads to gain anything.
    heard = listening(progress, trainer.total(state), len(state.history))
    with threadpool_limits(1, user_api="blas"), heard as on_record:
        trainer.on_record = on_record
        return trainer.run(state)


def parameters_from(config: Config, arrays: Mapping[str, Array]) -> Parameters | ClosureParameters:
    """Take the parameters from the arrays of a model file.

    Raises
    ------
    KeyError
        If one is missing.
    """
    if isinstance(config, ClosureConfig):
        return ClosureParameters(**{name: arrays[name] for name in CLOSURES})
    return Parameters(**{stage: arrays[stage] for stage in STAGES})


def check(config: Config, parameters: Parameters | ClosureParameters, grid: Grid) -> None:
    """Raise if the parameters do not fit the configuration.

    Raises
    ------
    InputError
        Naming what does not.
    """
    for name, axis in (("time", grid.time), ("z", grid.z)):
        if axis.ndim != 1 or not np.isfinite(axis).all() or (np.diff(axis) <= 0).any():
            raise InputError(f"The model's {name} must be a row of increasing numbers.")
    if not (np.isfinite(grid.period) and grid.period > 0):
        raise InputError(f"The model's period must be positive (s), got {grid.period!r}.")
    if isinstance(config, ClosureConfig) and isinstance(parameters, ClosureParameters):
        parameters.check(config)
    elif isinstance(config, PCNDEConfig) and isinstance(parameters, Parameters):
        parameters.check(config, grid.time.size, grid.z.size)
    else:
        raise TypeError(f"{type(parameters).__name__} do not go with {type(config).__name__}")


def predict(
    engine: Engine,
    config: Config,
    parameters: Parameters | ClosureParameters,
    inflow: Array,
    area_undeformed: Array,
    grid: Grid,
) -> Solution:
    """Predict flow, area and pressure from checked inputs."""
    if isinstance(config, ClosureConfig):
        assert isinstance(parameters, ClosureParameters)
        shift = np.zeros(len(inflow))
        return engine.closures.predict(parameters, shift, inflow, area_undeformed, grid, config)
    assert isinstance(parameters, Parameters)
    return engine.predict(parameters, inflow, area_undeformed, grid, config)
