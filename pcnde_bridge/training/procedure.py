"""Training procedures: their steps and states, and the algorithms that fit the paper's stages.

A checkpoint stores the state of a run.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from pcnde_bridge._typing import AnyArray, Array
from pcnde_bridge.config import Config, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.closure_parameters import CLOSURES, ClosureParameters
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.training.history import Iteration, Recorder
from pcnde_bridge.uncertainty.sampling import Uncertainty


@dataclass(frozen=True, kw_only=True)
class RunState:
    """State of a training run after some of its steps.

    Attributes
    ----------
    seed : int
        Random seed of the run.
    finished : int
        Number of finished training steps.
    history : tuple of Iteration
        All iterations of the finished steps.
    uncertainty : Uncertainty or None
        Result of the calibration after the last step, of the ``physics`` preset.
    """

    seed: int
    finished: int = 0
    history: tuple[Iteration, ...] = field(default=(), repr=False)
    uncertainty: Uncertainty | None = None

    @property
    def seconds(self) -> float:
        """Time spent in the finished steps."""
        return self.history[-1].seconds if self.history else 0.0

    @property
    def facts(self) -> dict[str, Any]:
        """Facts for the provenance of the model."""
        return {"seconds": self.seconds}


State = TypeVar("State", bound=RunState)


@dataclass(frozen=True, kw_only=True)
class TrainingState(RunState):
    """State of a run that trains the paper's networks.

    Attributes
    ----------
    batches : tuple of arrays of int
        Positions of the training cases in every batch; with ``training="full_batch"`` those
        of the training part and, if there is one, of the validation part.
    parameters : Parameters
        Parameters after the finished steps.
    couplings : tuple of Parameters
        Parameters at each coupling so far, which give the area that the flow network sees.
    """

    batches: tuple[Positions, ...]
    parameters: Parameters
    couplings: tuple[Parameters, ...] = ()

    @property
    def facts(self) -> dict[str, Any]:
        """Facts for the provenance of the model, with the positions of the cases in batches."""
        return {**super().facts, "batches": [[int(i) for i in batch] for batch in self.batches]}


@dataclass(frozen=True, kw_only=True)
class ClosureState(RunState):
    """State of a run that fits the closures of the ``physics`` preset.

    Attributes
    ----------
    vectors : dict of arrays
        Closures fitted so far, by name, then the ensemble's ``member_0``, ``member_1``, ….
    """

    vectors: dict[str, Array]

    @property
    def parameters(self) -> ClosureParameters:
        """All closures; those that are not fitted yet are empty."""
        return ClosureParameters(**{name: self.vectors.get(name, np.empty(0)) for name in CLOSURES})


class Step(NamedTuple):
    """A training step: the smallest part of a run that a checkpoint can separate.

    Attributes
    ----------
    task : str
        Name of what is fitted.
    epoch, batch : int
        Position in the run, counted from 1.  A checkpoint is written whenever the task or
        the epoch changes.
    """

    task: str
    epoch: int = 1
    batch: int = 1


class Procedure(ABC, Generic[State]):
    """Training procedure: a fixed list of steps, each of which takes a state to the next one.

    Attributes
    ----------
    checkpoint_format : tuple of str and int
        Kind and version of the checkpoint file, if the procedure can be resumed.
    cases, config, engine
        Training cases, settings and compute engine.
    """

    checkpoint_format: ClassVar[tuple[str, int]]
    cases: Cases
    config: Config
    engine: Engine

    @abstractmethod
    def start(self, seed: int) -> State:
        """Return the state before the first step."""

    @abstractmethod
    def steps(self, state: State) -> Sequence[Step]:
        """Return all steps of the run, the finished ones included."""

    @abstractmethod
    def count_iterations(self, state: State) -> int:
        """Count the iterations of all steps, if no fit ends early."""

    @abstractmethod
    def fit(self, step: Step, state: State, recorder: Recorder) -> State:
        """Return the state with the results of a step; the loop adds the step's history."""

    def finish(self, state: State) -> State:
        """Complete the state after the last step."""
        return state

    # The rest is needed for checkpoints only.

    def count_numbers(self, state: State) -> int:
        """Count the numbers in the last checkpoint, the history left out."""
        raise NotImplementedError

    def to_archive(self, state: State) -> tuple[dict[str, Any], dict[str, AnyArray]]:
        """Return facts (JSON) and arrays from which the state can be restored."""
        raise NotImplementedError

    def from_archive(self, facts: Mapping[str, Any], arrays: Mapping[str, AnyArray]) -> State:
        """Restore a state; the loop adds the history.

        Raises
        ------
        KeyError, TypeError, ValueError, IndexError
            If something is missing or does not belong together.
        """
        raise NotImplementedError


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
