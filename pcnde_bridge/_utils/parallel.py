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
import operator
import os
import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Mapping
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypedDict, TypeVar

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.progress import TaskProgress
from pcnde_bridge._utils.result_folder import ResultFolder
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.errors import InputError, PCNDEError, TaskError

Task = TypeVar("Task")
Result = TypeVar("Result")
Workers = Executor | Callable[[], Executor]
"""An executor, or a function that creates one, such as :func:`processes`."""


class RunOptions(TypedDict, total=False):
    """Optional arguments of :func:`run` that functions with many fits pass on."""

    executor: Workers | None
    retries: int
    folder: StrPath | None
    progress: bool


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
    spawn = multiprocessing.get_context("spawn")  # JAX and Julia do not survive a fork
    return partial(futures.ProcessPoolExecutor, workers, spawn, _set_threads, (threads,))


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
    folder: StrPath | None = None,
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
    for name in tasks:
        if not _NAME.fullmatch(name):
            raise InputError(
                f"{name!r} cannot name a task: use up to 200 letters, digits, spaces and '._,=+-'."
            )
    stored = None if folder is None else ResultFolder(folder, facts or {})
    found = {name: None if stored is None else stored.read(name) for name in tasks}
    results: dict[str, Any] = {name: r for name, r in found.items() if r is not None}
    failures: dict[str, str] = {}
    missing = {name: task for name, task in tasks.items() if name not in results}
    finished = _Run(function, missing, executor, retries).results()
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
    calls = {name: partial(function, *arguments) for name, arguments in tasks.items()}
    return list(run(operator.call, calls, executor=executor, progress=progress).check().values())


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, PCNDEError) else f"{type(error).__name__}: {error}"


class _ThisProcess(Executor):
    """Executor that runs each task when it is submitted."""

    _max_workers = 1

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = Future[Any]()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class _Run:
    """Tasks on an executor, with a new pool whenever a worker process dies.

    A process that dies takes its pool and the tasks of all its processes with it, and it is
    unknown which task was the cause.  Each of these suspects is then repeated alone in a new
    pool; only a task that breaks a pool alone has failed.
    """

    def __init__(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[str, Any],
        executor: Workers | None,
        retries: int,
    ) -> None:
        self._function, self._tasks, self._retries = function, tasks, retries
        executor = executor or _ThisProcess()
        self._create = None if isinstance(executor, Executor) else executor
        self._pool = executor if isinstance(executor, Executor) else executor()
        # Pools know their size; dask has none, and its scheduler has a queue of its own.
        self._width = getattr(self._pool, "_max_workers", None) or len(tasks)
        self._waiting, self._suspects = deque(tasks), deque[str]()
        self._running: dict[Future[Any], str] = {}
        self._failed: Counter[str] = Counter()

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
        done, _ = futures.wait(self._running, return_when=futures.FIRST_COMPLETED)
        if any(isinstance(future.exception(), BrokenExecutor) for future in done):
            done, _ = futures.wait(self._running)
        lost: dict[str, BaseException] = {}
        for future in done:
            name, error = self._running.pop(future), future.exception()
            if error is None:
                yield name, future.result(), None
            elif isinstance(error, BrokenExecutor):
                lost[name] = error
            elif self._is_final(name, error):
                yield name, None, _words(error)
            else:
                self._waiting.append(name)
        return lost

    def _blame(self, lost: Mapping[str, BaseException]) -> _Finished:
        """Yield the task that broke the pool alone once too often; suspect lost tasks otherwise."""
        if len(lost) == 1 and self._is_final(*next(iter(lost.items()))):
            yield next(iter(lost)), None, _DIED
        else:
            self._suspects.extend(lost)

    def _is_final(self, name: str, error: BaseException) -> bool:
        """Return whether a task that has failed is not repeated."""
        self._failed[name] += 1
        if isinstance(error, PCNDEError) or self._failed[name] > self._retries:
            return True
        _log.warning("Task %s failed and is repeated: %s", name, _words(error))
        return False

    def _close(self, complete: bool) -> None:
        """Cancel what still runs; a pool that was created here is shut down."""
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
