"""Checks and training that several studies share."""

from collections.abc import Iterator

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.training.procedure import Procedure, RunState, State
from pcnde_bridge.training.trainer import Session, Trainer


def check_single(cases: Cases, study: str) -> None:
    """Raise InputError unless there is exactly one case."""
    if len(cases) != 1:
        raise InputError(f"{study} one case, got {len(cases)}. Select it, such as cases[0].")


def train_until_divergence(
    procedure: Procedure[State], state: State, session: Session, steps: int
) -> Iterator[State]:
    """Yield the first state, and the state after each step, until an equation diverges.

    Parameters
    ----------
    procedure : Procedure
        Training procedure.
    state : RunState
        State before the first step.
    session : Session
        Callbacks of the run.
    steps : int
        Number of steps.
    """
    trainer = Trainer(procedure, None, *session)
    yield state
    for number in range(1, steps + 1):
        try:
            state = trainer.run(state, until=number)
        except SolveError:
            return
        yield state


def describe_outcome(state: RunState, steps: int) -> str:
    """Return ``"trained"``, or where training diverged, from the last state of a run."""
    if state.finished == steps:
        return "trained"
    if not state.history:
        return "diverged at the first parameters"
    last = state.history[-1]
    return f"diverged after {last.stage.replace('_', ' ')}, epoch {last.epoch}, batch {last.batch}"
