"""Training procedures: their steps, and the state of a run, which a checkpoint stores."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from pcnde_bridge._typing import AnyArray
from pcnde_bridge._utils.workers import Worker
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.hemodynamics.outlet import Outlet
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
    outlet : Outlet or None
        Outlet of the cases if it is given, not trained.
    workers : sequence of Worker
        Processes that hold parts of the cases; none for this process.
    left_out : sequence of arrays of int
        Positions of the cases that the fits for the uncertainty leave out, one after the other.
    """

    checkpoint_format: ClassVar[tuple[str, int]]
    cases: Cases
    config: Config
    engine: Engine
    outlet: Outlet | None = None
    workers: Sequence[Worker] = ()
    left_out: Sequence[Positions] = ()

    @abstractmethod
    def start(self, seed: int) -> State:
        """Return the state before the first step."""

    @abstractmethod
    def steps(self, state: State) -> Sequence[Step]:
        """Return all steps of the run, the finished ones included."""

    @abstractmethod
    def count_iterations(self, state: State) -> int:
        """Count the iterations of all steps, as many as a run usually has."""

    def slow_iterations(self, state: State) -> tuple[int, float]:
        """Return how many iterations at the end take longer, and how many times as long."""
        return 0, 1.0

    @abstractmethod
    def fit(self, step: Step, state: State, recorder: Recorder) -> State:
        """Return the state with the results of a step; the loop adds the step's history."""

    def finish(self, state: State) -> State:
        """Complete the state after the last step."""
        return state

    # The rest is needed for checkpoints only.

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
