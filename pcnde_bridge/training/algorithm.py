"""Interface between the training of the paper's stages and an algorithm that fits them."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.training.history import Recorder
from pcnde_bridge.training.procedure import Step
from pcnde_bridge.training.state import TrainingState


class StageFit(NamedTuple):
    """Fit of one stage, as a training step asks for it.

    Attributes
    ----------
    stage : str
        Name of the stage.
    step : Step
        Training step that asks.
    state : TrainingState
        State before the step.
    inputs, target
        Inputs of the engine's stage and reference data, (case, time, z), for all cases.
    cases, config, engine
        Training cases, settings and compute engine.
    recorder : Recorder
        Receives the iterations.
    """

    stage: str
    step: Step
    state: TrainingState
    inputs: Any
    target: Array
    cases: Cases
    config: PCNDEConfig
    engine: Engine
    recorder: Recorder

    @property
    def start(self) -> Array:
        """Parameters of the stage before the fit."""
        start: Array = getattr(self.state.parameters, self.stage)
        return start


class Algorithm(Protocol):
    """Algorithm that fits the paper's stages, such as :mod:`pcnde_bridge.training.minibatch`."""

    def divide(self, cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
        """Return the positions of the cases in every batch."""

    def plan(self, config: PCNDEConfig, n_batches: int) -> list[Step]:
        """Return all steps of a run, in order.

        The tasks are ``"flow"``, ``"coupling"`` (both area stages), ``"temporal_pressure"``
        and ``"spatial_pressure"``.
        """

    def count_iterations(self, config: PCNDEConfig, n_batches: int) -> int:
        """Count the iterations of all steps, if no fit ends early."""

    def fit(self, wanted: StageFit) -> Array:
        """Return the new parameters of a stage."""
