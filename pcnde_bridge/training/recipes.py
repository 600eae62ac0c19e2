"""One training run from its start or its checkpoint to its end."""

from __future__ import annotations

from typing import Protocol

from threadpoolctl import threadpool_limits

from pcnde_bridge.training.checkpoint import State
from pcnde_bridge.training.history import OnRecord
from pcnde_bridge.training.progress import listening


class _Trainer(Protocol[State]):
    on_record: OnRecord | None

    def start(self, seed: int) -> State: ...
    def total(self, state: State, /) -> int: ...
    def run(self, state: State) -> State: ...


def run(trainer: _Trainer[State], seed: int, progress: bool | OnRecord) -> State:
    """Run to the end from the start or from the checkpoint."""
    state = trainer.start(seed)
    # Sums of several threads depend on their number, which worker processes may limit;
    # these matrices are too small for threads to gain anything.
    heard = listening(progress, trainer.total(state), len(state.history))
    with threadpool_limits(1, user_api="blas"), heard as on_record:
        trainer.on_record = on_record
        return trainer.run(state)
