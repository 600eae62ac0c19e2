"""The training loop: checkpoints, progress, Ctrl-C and thread limit of every kind of training.

A run is a fixed list of training steps.  The state after each step is all that the next
one needs, so that a run continued from a checkpoint repeats the interrupted one bit for bit.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from typing import Generic, NamedTuple

from threadpoolctl import threadpool_limits

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils import interrupts
from pcnde_bridge._utils.files import locked
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import ignore
from pcnde_bridge.training.checkpoint import Checkpoint
from pcnde_bridge.training.full_batch import FullBatchTraining
from pcnde_bridge.training.history import Iteration, OnIteration, Recorder
from pcnde_bridge.training.minibatch import MinibatchTraining
from pcnde_bridge.training.procedure import Procedure, State
from pcnde_bridge.training.progress import TrainingProgress
from pcnde_bridge.training.staged_training import StagedTraining


def staged_training(cases: Cases, config: PCNDEConfig, engine: Engine) -> StagedTraining:
    """Return the procedure with the algorithm that ``config.training`` names."""
    algorithm = {"minibatch": MinibatchTraining, "full_batch": FullBatchTraining}[config.training]
    return algorithm(cases, config, engine)


class Session(NamedTuple):
    """Callbacks of one or more runs: each iteration, each fit's outcome, each step's task."""

    on_iteration: OnIteration
    on_fit_end: Callable[[str], None]
    on_step: Callable[[str], None] = ignore


@contextmanager
def training_session(
    progress: bool | OnIteration, total: int, done: int = 0, slow: tuple[int, float] = (0, 1.0)
) -> Iterator[Session]:
    """Limit BLAS to one thread, handle Ctrl-C, and report progress.

    Sums over several threads depend on their number, which worker processes may limit, and
    the matrices are too small to gain from threads.

    Parameters
    ----------
    progress : bool or callable
        Whether to show a progress bar, or a function called with every iteration.
    total, done : int
        Iterations of all runs, and those done before.
    slow : tuple of int and float
        How many iterations at the end take longer, and how many times as long.
    """
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1, user_api="blas"))
        check_interrupt = stack.enter_context(interrupts.watched())
        bar = stack.enter_context(TrainingProgress(total, done, slow)) if progress is True else None
        report = bar or progress

        def on_iteration(iteration: Iteration) -> None:
            check_interrupt()
            if callable(report):
                report(iteration)

        yield (
            Session(on_iteration, bar.on_fit_end, bar.on_step)
            if bar
            else Session(on_iteration, ignore)
        )


class Trainer(Generic[State]):
    """Runs the steps of a training procedure.

    Parameters
    ----------
    procedure : Procedure
        Steps, and how to fit them.
    checkpoint : path-like, optional
        File that stores the state: read if it exists, written after each epoch of a task,
        and when training is interrupted
        (:class:`~pcnde_bridge.training.checkpoint.Checkpoint`).
    on_iteration, on_fit_end, on_step : callable
        Called with every :class:`~pcnde_bridge.training.history.Iteration`, with the outcome of
        every fit, and with the task of every step.
    """

    def __init__(
        self,
        procedure: Procedure[State],
        checkpoint: StrPath | None = None,
        on_iteration: OnIteration = ignore,
        on_fit_end: Callable[[str], None] = ignore,
        on_step: Callable[[str], None] = ignore,
    ) -> None:
        self._procedure = procedure
        self._checkpoint = None if checkpoint is None else Checkpoint(checkpoint, procedure)
        self._save = ignore if self._checkpoint is None else self._checkpoint.write
        self._callbacks = Session(on_iteration, on_fit_end, on_step)

    def fit(self, seed: int, progress: bool | OnIteration = True) -> State:
        """Run all steps, from the start or from the checkpoint; see :meth:`complete`.

        No other run may use the checkpoint at the same time.
        """
        with nullcontext() if self._checkpoint is None else locked(self._checkpoint.path):
            return self.complete(self.start(seed), progress)

    def complete(self, state: State, progress: bool | OnIteration = True) -> State:
        """Run all steps that are not finished, in a session of their own.

        Parameters
        ----------
        state : state of the procedure
            State to continue from.
        progress : bool or callable
            Whether to show progress, or a function called with every iteration.
        """
        total, slow = (
            self._procedure.count_iterations(state),
            self._procedure.slow_iterations(state),
        )
        with training_session(progress, total, len(state.history), slow) as self._callbacks:
            return self.run(state)

    def start(self, seed: int) -> State:
        """Return the first state of a run, or the state of the checkpoint if there is one.

        Raises
        ------
        InputError
            If the checkpoint belongs to other cases, settings or another seed.
        FileError
            If the checkpoint cannot be read, or could not be written later.
        """
        first = self._procedure.start(seed)
        if self._checkpoint is None:
            return first
        # A full or read-only disk is reported now, not after the first epoch.
        self._checkpoint.check(first)
        if (state := self._checkpoint.read(seed)) is not None:
            return state
        self._save(first)
        return first

    def run(self, state: State, until: int | None = None) -> State:
        """Run the steps that are not finished: all, or until ``until`` steps are finished.

        Raises
        ------
        KeyboardInterrupt
            If training is interrupted, after the checkpoint was written.
        SolveError
            If an equation diverges at the start of a fit.
        """
        steps = self._procedure.steps(state)
        began = time.perf_counter() - state.seconds
        try:
            for step in steps[state.finished : until]:
                self._callbacks.on_step(step.task)
                recorder = Recorder(began, *self._callbacks[:2])
                state = self._procedure.fit(step, state, recorder)
                history = (*state.history, *recorder.iterations)
                state = replace(state, finished=state.finished + 1, history=history)
                following = steps[state.finished :][:1]
                if not following or following[0][:2] != step[:2]:  # the epoch ends
                    self._save(state)
        except KeyboardInterrupt:
            self._save(state)
            raise
        return self._procedure.finish(state) if state.finished == len(steps) else state
