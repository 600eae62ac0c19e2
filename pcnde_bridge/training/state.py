"""State of a training run, which a checkpoint stores."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.closure_parameters import CLOSURES, ClosureParameters
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.training.history import Iteration
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
