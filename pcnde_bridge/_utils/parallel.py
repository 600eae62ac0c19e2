"""Many independent tasks, such as fits, in one process or on many machines.

:func:`run` accepts any :class:`concurrent.futures.Executor`.  On one machine::

    ensemble = Ensemble.fit(cases, executor=4)  # processes

On a cluster, with ``dask`` (``pip install ".[dask]" dask-jobqueue``), here with
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
:func:`processes`.
"""

import contextlib
import logging
import operator
import os
import re
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Mapping
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple, TypedDict, TypeVar

import psutil

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import locked
from pcnde_bridge._utils.progress import TaskProgress
from pcnde_bridge._utils.result_folder import ResultFolder
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.errors import InputError, PCNDEError, TaskError

Task = TypeVar("Task")
Result = TypeVar("Result")


class Processes(NamedTuple):
    """Processes of :func:`processes`, one pool each: one that dies interrupts only its task."""

    workers: int
    pool: Callable[[], Any]


Workers = Executor | Processes | int
"""An executor, a number of processes on this machine, or the result of :func:`processes`."""


class RunOptions(TypedDict, total=False):
    """Optional arguments of :func:`run` that functions with many fits pass on."""

    executor: Workers | None
    retries: int
    folder: StrPath | None
    progress: bool


_NAME = re.compile(r"\w[\w .,=+-]{0,199}")  # also usable as the name of a file
_DIED = "its worker process died"
_BROKEN = "a worker process died, and its pool with it; pass executor=2, which replaces it"

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


def processes(workers: int) -> Processes:
    """Return processes on this machine, each of which is replaced when it dies.

    Parameters
    ----------
    workers : int
        Number of processes, in each of which XLA has one thread.

    Raises
    ------
    InputError
        If ``workers`` is not a whole number ≥ 1.
    """
    workers = whole("workers", workers, 1)
    import loky

    # Not forked, as JAX and Julia do not survive that; and the user's program is not run again.
    # JAX cannot store functions with diffrax's checks of its arguments.
    settings = {"NPROC": "1", "EQX_ON_ERROR": "off"}
    pool = partial(loky.ProcessPoolExecutor, 1, env=settings, initializer=_watch_parent)
    return Processes(workers, partial(pool, initargs=(os.getpid(),)))


def _watch_parent(parent: int) -> None:
    """End this worker process when its parent ends; it would wait for tasks forever."""

    def watch() -> None:
        with contextlib.suppress(psutil.NoSuchProcess):
            psutil.Process(parent).wait()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
    executor : Executor, int, distributed.Client, or the result of :func:`processes`, optional
        A number is that of :func:`processes` on this machine.  None runs the tasks one after
        the other in this process.  Prefer a number to a pool: a pool is unusable after one of
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
    workers = _workers(executor)
    stored = None if folder is None else ResultFolder(folder, facts or {})
    found = {name: None if stored is None else stored.read(name) for name in tasks}
    results: dict[str, Any] = {name: r for name, r in found.items() if r is not None}
    failures: dict[str, str] = {}
    missing = {name: task for name, task in tasks.items() if name not in results}
    finished = _finished(function, missing, workers, retries)
    silent = contextlib.nullcontext(lambda name, failure: None)
    shown = TaskProgress(len(tasks), len(results)) if progress else silent
    # Closed explicitly: an error's traceback keeps the generator, and so the pool, alive.
    folder_lock = contextlib.nullcontext() if folder is None else locked(folder)
    with folder_lock, contextlib.closing(finished), shown as bar:
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


def _finished(
    function: Callable[[Any], Any],
    tasks: Mapping[str, Any],
    executor: Executor | Processes | None,
    retries: int,
) -> Generator[tuple[str, Any, str | None], None, None]:
    """Yield name, result and reason of failure of each task when they are known."""
    create = executor.pool if isinstance(executor, Processes) else None
    free = _pools(executor, len(tasks))
    waiting, failed = deque(tasks), Counter[str]()
    running: dict[Future[Any], tuple[str, Executor | None]] = {}
    try:
        while waiting or running:
            while waiting and free:
                name, pool = waiting.popleft(), free.pop()
                running[_submit(pool, function, tasks[name])] = name, pool
            done, _ = futures.wait(running, return_when=futures.FIRST_COMPLETED)
            for future in done:
                (name, pool), error = running.pop(future), future.exception()
                broken = isinstance(error, BrokenExecutor)
                free.append(create() if broken and create else pool)
                failed[name] += 1
                if error is None:
                    yield name, future.result(), None
                elif broken and not create:
                    yield name, None, _BROKEN
                elif isinstance(error, PCNDEError) or failed[name] > retries:
                    yield name, None, _DIED if broken else _words(error)
                else:
                    _log.warning("Task %s failed and is repeated: %s", name, _words(error))
                    waiting.append(name)
    finally:
        for future in running:
            future.cancel()
        if create:  # busy processes would run on, and the interpreter would wait for them
            pools: list[Any] = [*free, *(pool for _, pool in running.values())]
            for pool in pools:
                pool.shutdown(kill_workers=True)


def _workers(executor: Any) -> Executor | Processes | None:
    """Return the workers of a number of processes, of a dask client, or those that are given."""
    if isinstance(executor, int):
        return processes(executor)
    found: Executor | Processes | None = (
        executor.get_executor() if hasattr(executor, "get_executor") else executor
    )
    return found


def _pools(executor: Executor | Processes | None, most: int) -> list[Executor | None]:
    """Return one entry for each task that may run at the same time: its pool, or None."""
    if isinstance(executor, Processes):
        return [executor.pool() for _ in range(min(executor.workers, most))]
    # Pools know their size; dask has none, and its scheduler has a queue of its own.
    return [executor] * (getattr(executor, "_max_workers", most) if executor else 1)


def _submit(pool: Executor | None, function: Callable[[Any], Any], task: Any) -> Future[Any]:
    """Start a task in a pool; without one, or if it is broken, the future is already done."""
    future = Future[Any]()
    try:
        if pool is not None:
            return pool.submit(function, task)
        future.set_result(function(task))
    except Exception as error:
        future.set_exception(error)
    return future
