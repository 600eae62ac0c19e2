"""Many independent tasks, such as fits, in one process or on many machines.

:func:`run` takes any :class:`concurrent.futures.Executor`.  On one machine::

    from pcnde_bridge._utils.parallel import processes

    ensemble = Ensemble.fit(cases, executor=processes(4))

On a cluster, through ``dask`` (``pip install "pcnde-bridge[dask]" dask-jobqueue``), here with
20 jobs of SLURM, one core each; a job that ends early is replaced::

    from dask.distributed import Client
    from dask_jobqueue import SLURMCluster

    cluster = SLURMCluster(
        cores=1, memory="4GB", walltime="02:00:00", job_script_prologue=["export NPROC=1"]
    )
    cluster.adapt(maximum_jobs=20)
    with Client(cluster) as client:
        ensemble = Ensemble.fit(cases, executor=client.get_executor(), folder="fits")

A fit gives the same bits in this process and in any other in which XLA has as many threads:
all cores that the process may use, or the environment variable ``NPROC``, one in
:func:`processes`.  Programs that start processes need ``if __name__ == "__main__":``.
"""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing
import os
import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures import BrokenExecutor as PoolBroken
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pcnde_bridge._utils.archive import (
    archive_kind,
    read_archive,
    write_archive,
)
from pcnde_bridge._utils.files import check_writable, make_folder
from pcnde_bridge._utils.progress import TaskProgress
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.errors import (
    FileError,
    InputError,
    PCNDEError,
    TaskError,
)

Task = TypeVar("Task")
Result = TypeVar("Result")
Workers = Executor | Callable[[], Executor]
"""An executor, or what makes one, such as :func:`processes`."""

_KIND, _VERSION = "pcnde-task", 1
_NAME = re.compile(r"\w[\w .,=+-]{0,199}")  # a file's name, too
_ARRAY = "result."  # begins the names of a result's arrays, which the archive's own thus never are

_BROKEN = (
    "a worker process died, and its pool with it; give what makes a pool, such as processes(2)"
)

_log = logging.getLogger("pcnde_bridge")


@dataclass(frozen=True)
class Outcome:
    """What came of some tasks.

    Attributes
    ----------
    results : dict
        By the names of the tasks that finished, in the order of all tasks.
    failures : dict of str to str
        Why the others did not.
    """

    results: dict[str, Any]
    failures: dict[str, str] = field(default_factory=dict)

    def check(self) -> dict[str, Any]:
        """Return the results if nothing failed.

        Raises
        ------
        TaskError
            Naming what failed, and why.
        """
        if self.failures:
            raise TaskError(self.complaint())
        return self.results

    def complaint(self) -> str:
        """Say what failed, and why."""
        total = len(self.results) + len(self.failures)
        reasons = "; ".join(f"{name}: {reason}" for name, reason in self.failures.items())
        return f"{len(self.failures)} of {total} tasks failed ({reasons})."


def processes(workers: int, threads: int | None = 1) -> Callable[[], Executor]:
    """Return what makes a pool of processes on this machine, anew if one of them dies.

    Parameters
    ----------
    workers : int
        Number of processes.
    threads : int or None
        Threads of XLA in each; None leaves it all cores.

    Raises
    ------
    InputError
        If ``workers`` is no whole number from 1 on.
    """
    workers = whole("workers", workers, 1)

    def make() -> Executor:
        spawn = multiprocessing.get_context("spawn")  # JAX and Julia do not survive a fork
        return ProcessPoolExecutor(workers, spawn, initializer=_limit, initargs=(threads,))

    return make


def _limit(threads: int | None) -> None:
    """Set the threads of XLA, which has not started yet in a new process."""
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
        Takes a task and returns its result.  With processes, one that a module
        defines.
    tasks : mapping
        By name, for messages and files: up to 200 letters, digits, spaces and ``._,=+-``.
    executor : Executor, or callable that makes one, optional
        None works in this process, one task after the other.  Of a pool of
        processes give the callable, as :func:`processes` returns it: a pool is of
        no more use when one of its processes dies.
    retries : int
        How often a failed task is tried again.  The package's own errors are
        reported at once, because they would come again.
    folder : path-like, optional
        Keeps the result of every finished task, so that a run that was killed
        continues; made if missing.  Results must then be mappings of text to
        arrays and to whatever JSON can hold.
    facts : mapping, optional
        With ``folder``: what the results depend on, for JSON; results kept of
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
        If a name cannot be used, the folder holds results of other facts, or a result
        cannot be kept there.
    FileError
        If the folder cannot be written.
    KeyboardInterrupt
        As it came; finished results are in the folder.

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
    kept = None if folder is None else _Kept(Path(folder), facts or {})
    results: dict[str, Any] = {}
    failures: dict[str, str] = {}
    if kept is not None:
        found = {name: kept.read(name) for name in tasks}
        results = {name: result for name, result in found.items() if result is not None}
    names = [name for name in tasks if name not in results]
    if executor is None:
        finished = _one_by_one(function, tasks, names, retries)
    else:
        finished = _at_once(function, tasks, names, executor, retries)
    shown = TaskProgress(len(tasks), len(results), progress)
    # Closed by name: an error's traceback keeps the iterator, and so the pool, alive.
    with contextlib.closing(finished), shown as bar:
        for name, result, failure in finished:
            if failure is not None:
                failures[name] = failure
            else:
                results[name] = result
                if kept is not None:
                    kept.write(name, result)
            bar(name, failure)
    return Outcome(
        {name: results[name] for name in tasks if name in results},
        {name: failures[name] for name in tasks if name in failures},
    )


_Finished = Generator[tuple[str, Any, str | None], None, None]  # name, result, why it failed


class _Failures:
    """Decides whether a task that failed is tried again."""

    def __init__(self, retries: int) -> None:
        self._retries = retries
        self._count: Counter[str] = Counter()

    def final(self, name: str, error: BaseException) -> bool:
        self._count[name] += 1
        if isinstance(error, PCNDEError) or self._count[name] > self._retries:
            return True
        _log.warning("Task %s failed and is tried again: %s", name, _words(error))
        return False


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, PCNDEError) else f"{type(error).__name__}: {error}"


def _one_by_one(
    function: Callable[[Task], Any], tasks: Mapping[str, Task], names: list[str], retries: int
) -> _Finished:
    failures = _Failures(retries)
    for name in names:
        while True:
            try:
                result = function(tasks[name])
            except Exception as error:
                if failures.final(name, error):
                    yield name, None, _words(error)
                    break
            else:
                yield name, result, None
                break


def _at_once(
    function: Callable[[Task], Any],
    tasks: Mapping[str, Task],
    names: list[str],
    executor: Workers,
    retries: int,
) -> _Finished:
    """Keep the executor busy.

    A process that dies takes its pool with it, and the tasks of the other processes;
    which one killed it is not known.  So each of them is then tried alone in a new
    pool, and only a task that breaks a pool alone has failed.
    """
    failures = _Failures(retries)
    pool = executor if isinstance(executor, Executor) else executor()
    # Pools know their size; where there is none (dask), the scheduler has the queue.
    width = getattr(pool, "_max_workers", None) or len(names)
    waiting, suspects = deque(names), deque[str]()
    running: dict[Future[Any], str] = {}
    done_well = False
    try:
        while waiting or suspects or running:
            if suspects and not running:
                queue, most = suspects, 1
            else:
                queue, most = waiting, 0 if suspects else width
            while queue and len(running) < most:
                try:
                    running[pool.submit(function, tasks[queue[0]])] = queue[0]
                except PoolBroken:
                    if running:
                        break
                    if isinstance(executor, Executor):
                        yield from ((name, None, _BROKEN) for name in waiting)
                        return
                    pool = executor()
                else:
                    queue.popleft()
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            if any(isinstance(future.exception(), PoolBroken) for future in done):
                done, _ = wait(running)
            lost = []
            for future in done:
                name = running.pop(future)
                error = future.exception()
                if error is None:
                    yield name, future.result(), None
                elif isinstance(error, PoolBroken):
                    lost.append((name, error))
                elif failures.final(name, error):
                    yield name, None, _words(error)
                else:
                    waiting.append(name)
            if not lost:
                continue
            if isinstance(executor, Executor):
                yield from ((name, None, _BROKEN) for name in (*(n for n, _ in lost), *waiting))
                return
            if len(lost) > 1:
                suspects.extend(name for name, _ in lost)
            elif failures.final(*lost[0]):
                yield lost[0][0], None, "its worker process died"
            else:
                suspects.append(lost[0][0])
            pool.shutdown(wait=False)
            pool = executor()
        done_well = True
    finally:
        for future in running:
            future.cancel()
        if not isinstance(executor, Executor):
            # A shutdown that does not wait leaves tasks running, and the interpreter's exit
            # would wait for them.
            unwanted = {} if done_well else getattr(pool, "_processes", None) or {}
            workers = list(unwanted.values())
            pool.shutdown(wait=done_well, cancel_futures=True)
            for worker in workers:
                worker.terminate()


def remove_results(folder: str | os.PathLike[str]) -> None:
    """Remove the results that :func:`run` kept, and the folder if nothing else is in it."""
    for path in Path(folder).glob("*.npz"):
        if archive_kind(path) == _KIND:
            path.unlink()
    with contextlib.suppress(OSError):
        Path(folder).rmdir()


class _Kept:
    """Results in a folder, a file for each."""

    def __init__(self, folder: Path, facts: Mapping[str, Any]) -> None:
        self._folder = folder
        # As a file gives it back: tuples are lists there.
        self._facts = json.loads(json.dumps(facts))
        make_folder(folder)
        check_writable(self._path("result"))

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npz"

    def read(self, name: str) -> dict[str, Any] | None:
        """Return a task's result, or None if it has not finished."""
        path = self._path(name)
        if not path.exists():
            return None
        try:
            facts, arrays = read_archive(path, _KIND, _VERSION, "result")
            if facts["facts"] != self._facts:
                raise InputError(
                    f"{path} is the result of other tasks (other cases, settings or seeds). Give "
                    "another folder, or remove this one."
                )
            values = {_ARRAY + key: value for key, value in facts["values"].items()} | arrays
            return {key: values[_ARRAY + key] for key in facts["order"]}
        except FileError as error:
            _log.warning("%s The task is done again.", error)
        except KeyError as error:
            _log.warning("%s is not a whole result: %s. The task is done again.", path, error)
        return None

    def write(self, name: str, result: Any) -> None:
        if not isinstance(result, Mapping):
            raise InputError(
                f"The result of {name} is {type(result).__name__}; only mappings can be kept in "
                "a folder."
            )
        arrays, values = {}, {}
        for key, value in result.items():
            if isinstance(value, np.ndarray):
                arrays[f"{_ARRAY}{key}"] = value
            else:
                values[key] = value.item() if isinstance(value, np.generic) else value
        content = {"facts": self._facts, "values": values, "order": list(result)}
        try:
            if not all(isinstance(key, str) for key in result):
                raise TypeError("a name is not text")
            write_archive(self._path(name), _KIND, _VERSION, content, arrays)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"The result of {name} cannot be kept in a folder: {error}. Return arrays of "
                "numbers or text, and what JSON can hold, by names."
            ) from error


def each(
    function: Callable[..., Result],
    tasks: Mapping[str, tuple[Any, ...]],
    executor: Workers | None = None,
    progress: bool = True,
) -> list[Result]:
    """Results of a function for the arguments of each task, in their order.

    Parameters
    ----------
    function : callable
        A function of a module, so that worker processes can find it.
    tasks : mapping of str to tuple
        The arguments, by the task's name.
    executor, progress
        As :func:`pcnde_bridge._utils.parallel.run` takes them.

    Raises
    ------
    TaskError
        If a task failed in the end.
    """
    calls = {name: (function, arguments) for name, arguments in tasks.items()}
    return list(run(_call, calls, executor=executor, progress=progress).check().values())


def _call(call: tuple[Callable[..., Result], tuple[Any, ...]]) -> Result:
    function, arguments = call
    return function(*arguments)
