"""What a way to train the paper's stages is: its units of work, and how it fits a stage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from pcnde_bridge.cases import Cases
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.base import Engine
from pcnde_bridge.held_out import Positions
from pcnde_bridge.history import Recorder

if TYPE_CHECKING:
    from pcnde_bridge.training import TrainingState

Array = npt.NDArray[np.float64]


class Unit(NamedTuple):
    """A unit of work: ``"flow"``, ``"coupling"`` or a pressure stage."""

    work: str
    epoch: int
    batch: int


class Algorithm(Protocol):
    """What :mod:`pcnde_bridge.batches` and :mod:`pcnde_bridge.all_at_once` supply."""

    def divide(self, cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
        """Positions of the cases in every batch."""

    def plan(self, config: PCNDEConfig, n_batches: int) -> list[Unit]:
        """All units of a run, in order."""

    def count_iterations(self, config: PCNDEConfig, n_batches: int) -> int:
        """Count the iterations of all stages, if no fit ends early."""

    def fit(
        self,
        stage: str,
        unit: Unit,
        state: TrainingState,
        inputs: Any,
        target: Array,
        cases: Cases,
        engine: Engine,
        config: PCNDEConfig,
        record: Recorder,
    ) -> Array:
        """Fit a stage to all cases, from the parameters of the state; return its new ones.

        ``inputs`` and ``target`` are those of the engine's stage.
        """
