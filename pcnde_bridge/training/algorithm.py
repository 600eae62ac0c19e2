"""What a way to train the paper's stages is: its units of work, and how it fits a stage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.training.history import Recorder

if TYPE_CHECKING:
    from pcnde_bridge.training.trainer import TrainingState


class Unit(NamedTuple):
    """A unit of work: ``"flow"``, ``"coupling"`` or a pressure stage."""

    work: str
    epoch: int
    batch: int


class StageFit(NamedTuple):
    """A stage that a unit of work asks to be fitted to all cases.

    Attributes
    ----------
    stage : str
        Its name.
    unit : Unit
        Of the work.
    state : TrainingState
        With the parameters before.
    inputs, target
        Of the engine's stage: what it takes, and the data, (case, time, z).
    cases, engine, config
        Of the run.
    record : Recorder
        Of the iterations.
    """

    stage: str
    unit: Unit
    state: TrainingState
    inputs: Any
    target: Array
    cases: Cases
    engine: Engine
    config: PCNDEConfig
    record: Recorder


class Algorithm(Protocol):
    """Training procedure, such as :mod:`pcnde_bridge.training.minibatch`."""

    def divide(self, cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
        """Positions of the cases in every batch."""

    def plan(self, config: PCNDEConfig, n_batches: int) -> list[Unit]:
        """All units of a run, in order."""

    def count_iterations(self, config: PCNDEConfig, n_batches: int) -> int:
        """Count the iterations of all stages, if no fit ends early."""

    def fit(self, wanted: StageFit) -> Array:
        """Return the stage's new parameters."""
