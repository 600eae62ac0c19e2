"""Many independent tasks, such as fits, in one process or on many machines.

:func:`run` accepts any :class:`concurrent.futures.Executor`.  On one machine::

    from pcnde_bridge._utils.parallel import processes

    ensemble = Ensemble.fit(cases, executor=processes(4))

On a cluster, with ``dask`` (``pip install "pcnde-bridge[dask]" dask-jobqueue``), here with
20 jobs of SLURM, one core each; a job that ends early is replaced::

    from dask.distributed import Client
    from dask_jobqueue import SLURMCluster

    cluster = SLURMCluster(
        cores=1, memory="4GB", walltime="02:00:00", job_script_prologue=["export NPROC=1"]
    )
    cluster.adapt(maximum_jobs=20)
    with Client(cluster) as client:
        ensemble = Ensemble.fit(cases, executor=client.get_executor(), folder="fits")

A fit gives the same bits in every process in which XLA has the same number of threads: all
cores that the process may use, or the environment variable ``NPROC``, or one in
:func:`processes`.  Programs that start processes need ``if __name__ == "__main__":``.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pcnde_bridge._utils.progress import TaskProgress
from pcnde_bridge._utils.result_folder import ResultFolder
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.errors import InputError, PCNDEError, TaskError

Task = TypeVar("Task")
Result = TypeVar("Result")
Workers = Executor | Callable[[], Executor]
"""An executor, or a function that creates one, such as :func:`processes`."""

_NAME = re.compile(r"\w[\w .,=+-]{0,199}")  # also usable as the name of a file
_DIED = "its worker process died"
_BROKEN = (
    "a worker process died, and its pool with it; pass a function that creates pools, such as "
    "processes(2)"
)
_Finished = Generator[tuple[str, Any, str | None], None, None]  # name, result, reason of failure

_log = logging.getLogger("pcnde_bridge")


@dataclass(frozen=True)
class Outcome:
    """Results and failures of some tasks.

    Attributes
    ----------
    results : dict
        Results of the tasks that finished, by name, in the order of all tasks.
    failures : dict of str to str
        Reason why each other task failed.
    """

    results: dict[str, Any]
    failures: dict[str, str] = field(default_factory=dict)

    def check(self) -> dict[str, Any]:
        """Return the results if nothing failed.

        Raises
        ------
        TaskError
            If a task failed; the message names it and its reason.
        """
        if self.failures:
            raise TaskError(self.complaint())
        return self.results

    def complaint(self) -> str:
        """Return a sentence with the failed tasks and their reasons."""
        total = len(self.results) + len(self.failures)
        reasons = "; ".join(f"{name}: {reason}" for name, reason in self.failures.items())
        return f"{len(self.failures)} of {total} tasks failed ({reasons})."


def processes(workers: int, threads: int | None = 1) -> Callable[[], Executor]:
    """Return a function that creates a pool of processes on this machine.

    Parameters
    ----------
    workers : int
        Number of processes.
    threads : int or None
        Threads of XLA in each process; None allows all cores.

    Raises
    ------
    InputError
        If ``workers`` is not a whole number ≥ 1.
    """
    workers = whole("workers", workers, 1)

    def create() -> Executor:
        spawn = multiprocessing.get_context("spawn")  # JAX and Julia do not survive a fork
        return ProcessPoolExecutor(workers, spawn, initializer=_set_threads, initargs=(threads,))

    return create


def _set_threads(threads: int | None) -> None:
    """Set the number of threads of XLA, which has not started yet in a new process."""
    if threads is not None:
        os.environ["NPROC"] = str(threads)


def run(
    function: Callable[[Task], Any],
    tasks: Mapping[str, Task],
    *,
    executor: Workers | None = None,
    retries: int = 1,
    folder: str | os.PathLike[str] | None = None,
    facts: Mapping[str, Any] | None = None,
    progress: bool = True,
) -> Outcome:
    """Call a function on every task.

    Parameters
    ----------
    function : callable
        Takes a task and returns its result.  Worker processes need a function that is
        defined in a module.
    tasks : mapping
        Tasks by name, for messages and files: up to 200 letters, digits, spaces and
        ``._,=+-``.
    executor : Executor, or callable that creates one, optional
        None runs the tasks one after the other in this process.  For a pool of processes
        give the callable that :func:`processes` returns: a pool is unusable after one of
        its processes died.
    retries : int
        Number of times that a failed task is repeated.  Errors of this package are
        reported at once, because they would occur again.
    folder : path-like, optional
        Folder for the result of every finished task, so that a killed run can be resumed;
        it is created if it is missing.  Results must be mappings of names to arrays and
        to data that JSON can represent.
    facts : mapping, optional
        With ``folder``: data, for JSON, that the results depend on.  Stored results with
        other facts are refused.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    Outcome
        Results and failures.

    Raises
    ------
    InputError
        If a name cannot be used, the folder holds results with other facts, or a result
        cannot be stored there.
    FileError
        If the folder cannot be written.
    KeyboardInterrupt
        On Ctrl-C; finished results are in the folder.

    Examples
    --------
    >>> from pcnde_bridge._utils.parallel import run
    >>> run(abs, {"first": -1, "second": 2}, progress=False).results
    {'first': 1, 'second': 2}
    """
    _check_names(tasks)
    stored = None if folder is None else ResultFolder(folder, facts or {})
    found = {name: None if stored is None else stored.read(name) for name in tasks}
    results: dict[str, Any] = {name: r for name, r in found.items() if r is not None}
    failures: dict[str, str] = {}
    names = [name for name in tasks if name not in results]
    finished = _run(function, tasks, names, executor, _Retries(retries))
    shown = TaskProgress(len(tasks), len(results), progress)
    # Closed explicitly: an error's traceback keeps the generator, and so the pool, alive.
    with contextlib.closing(finished), shown as bar:
        for name, result, failure in finished:
            if failure is not None:
                failures[name] = failure
            else:
                results[name] = result
                if stored is not None:
                    stored.write(name, result)
            bar(name, failure)
    return Outcome(
        {name: results[name] for name in tasks if name in results},
        {name: failures[name] for name in tasks if name in failures},
    )


def each(
    function: Callable[..., Result],
    tasks: Mapping[str, tuple[Any, ...]],
    executor: Workers | None = None,
    progress: bool = True,
) -> list[Result]:
    """Return the results of a function for the arguments of each task, in the same order.

    Parameters
    ----------
    function : callable
        Function that is defined in a module, so that worker processes can find it.
    tasks : mapping of str to tuple
        Arguments by the name of the task.
    executor, progress
        See :func:`run`.

    Raises
    ------
    TaskError
        If a task failed.
    """
    calls = {name: (function, arguments) for name, arguments in tasks.items()}
    return list(run(_call, calls, executor=executor, progress=progress).check().values())


def _call(call: tuple[Callable[..., Result], tuple[Any, ...]]) -> Result:
    function, arguments = call
    return function(*arguments)


def _check_names(names: Iterable[str]) -> None:
    for name in names:
        if not _NAME.fullmatch(name):
            raise InputError(
                f"{name!r} cannot name a task: use up to 200 letters, digits, spaces and '._,=+-'."
            )


class _Retries:
    """Decision whether a failed task is repeated."""

    def __init__(self, retries: int) -> None:
        self._retries = retries
        self._failed: Counter[str] = Counter()

    def are_used_up(self, name: str, error: BaseException) -> bool:
        self._failed[name] += 1
        if isinstance(error, PCNDEError) or self._failed[name] > self._retries:
            return True
        _log.warning("Task %s failed and is repeated: %s", name, _words(error))
        return False


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, PCNDEError) else f"{type(error).__name__}: {error}"


def _run(
    function: Callable[[Task], Any],
    tasks: Mapping[str, Task],
    names: list[str],
    executor: Workers | None,
    retries: _Retries,
) -> _Finished:
    """Return an iterator over the outcomes of tasks, in the order in which they finish."""
    if executor is None:
        return _run_here(function, tasks, names, retries)
    return _PoolRun(function, tasks, names, executor, retries).results()


def _run_here(
    function: Callable[[Task], Any], tasks: Mapping[str, Task], names: list[str], retries: _Retries
) -> _Finished:
    """Run tasks in this process, one after the other."""
    waiting = deque(names)
    while waiting:
        name = waiting[0]
        finished: tuple[str, Any, str | None]
        try:
            finished = name, function(tasks[name]), None
        except Exception as error:
            if not retries.are_used_up(name, error):
                continue
            finished = name, None, _words(error)
        waiting.popleft()
        yield finished


class _PoolRun:
    """Tasks on an executor, with a new pool whenever a worker process dies.

    A process that dies takes its pool and the tasks of all its processes with it, and it is
    unknown which task was the cause.  Each of these suspects is then repeated alone in a new
    pool; only a task that breaks a pool alone has failed.
    """

    def __init__(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[str, Any],
        names: list[str],
        executor: Workers,
        retries: _Retries,
    ) -> None:
        self._function, self._tasks, self._retries = function, tasks, retries
        self._create = None if isinstance(executor, Executor) else executor
        self._pool = executor if isinstance(executor, Executor) else executor()
        # Pools know their size; dask has none, and its scheduler has a queue of its own.
        self._width = getattr(self._pool, "_max_workers", None) or len(names)
        self._waiting, self._suspects = deque(names), deque[str]()
        self._running: dict[Future[Any], str] = {}

    def results(self) -> _Finished:
        """Yield the outcome of each task when it is known."""
        complete = False
        try:
            while self._waiting or self._suspects or self._running:
                lost: dict[str, BaseException] = {}
                if self._submit():
                    lost = yield from self._collect()
                    if not lost:
                        continue
                if self._create is None:
                    yield from ((name, None, _BROKEN) for name in (*lost, *self._waiting))
                    return
                yield from self._blame(lost)
                self._pool.shutdown(wait=False)
                self._pool = self._create()
            complete = True
        finally:
            self._close(complete)

    def _submit(self) -> bool:
        """Keep the pool busy; return False if it is broken and nothing runs in it."""
        queue, most = (self._suspects, 1) if self._suspects else (self._waiting, self._width)
        while queue and len(self._running) < most:
            try:
                future = self._pool.submit(self._function, self._tasks[queue[0]])
            except BrokenExecutor:
                return bool(self._running)
            self._running[future] = queue.popleft()
        return True

    def _collect(self) -> Generator[tuple[str, Any, str | None], None, dict[str, BaseException]]:
        """Yield tasks that finished; return those that were lost with the pool."""
        done, _ = wait(self._running, return_when=FIRST_COMPLETED)
        if any(isinstance(future.exception(), BrokenExecutor) for future in done):
            done, _ = wait(self._running)
        lost: dict[str, BaseException] = {}
        for future in done:
            name, error = self._running.pop(future), future.exception()
            if error is None:
                yield name, future.result(), None
            elif isinstance(error, BrokenExecutor):
                lost[name] = error
            elif self._retries.are_used_up(name, error):
                yield name, None, _words(error)
            else:
                self._waiting.append(name)
        return lost

    def _blame(self, lost: Mapping[str, BaseException]) -> _Finished:
        """Yield a lost task that ran alone and has no retries left; else mark all as suspects."""
        if len(lost) == 1:
            ((name, error),) = lost.items()
            if self._retries.are_used_up(name, error):
                yield name, None, _DIED
                return
        self._suspects.extend(lost)

    def _close(self, complete: bool) -> None:
        """Cancel running tasks; a pool that was created here is shut down."""
        for future in self._running:
            future.cancel()
        if self._create is None:
            return
        # A shutdown that does not wait leaves tasks running, and the interpreter would wait
        # for them on exit.
        unwanted = {} if complete else getattr(self._pool, "_processes", None) or {}
        workers = list(unwanted.values())
        self._pool.shutdown(wait=complete, cancel_futures=True)
        for worker in workers:
            worker.terminate()
