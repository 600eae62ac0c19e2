"""Interface between the training loop and a training procedure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Generic, NamedTuple

from pcnde_bridge._typing import AnyArray
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.training.history import Recorder
from pcnde_bridge.training.state import State


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
