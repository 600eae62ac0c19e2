"""Workers that hold parts of the data, such as a subset of the cases, for repeated use.

The results of all parts come in the order of the parts, so that sums of them do not depend on the
number of workers.
"""

import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from pcnde_bridge._utils.parallel import Processes, processes
from pcnde_bridge.errors import InputError, TaskError

Part = Callable[..., Any]
"""Part of the data: a function that computes with it."""

_PATIENCE = 5.0  # s without a result, after which a worker may have ended
_ENDED = (
    "A worker ended, and with it its part of the cases. Repeat the fit; it continues from its "
    "checkpoint if it has one."
)

_held: dict[str, list[Part]] = {}
"""Parts that this process holds, by their key."""


class Worker(NamedTuple):
    """A process that holds parts.

    Attributes
    ----------
    submit : callable
        Starts a call in this process and returns its future.
    key : str
        Prefix of the keys of its parts; two workers may be threads of one process.
    is_alive : callable
        Returns whether the process still has its parts.
    """

    submit: Callable[..., Any]
    key: str
    is_alive: Callable[[], bool] = lambda: True

    def result(self, future: Any) -> Any:
        """Wait for a result of this worker.

        Raises
        ------
        TaskError
            If the worker has ended.
        """
        while True:
            try:
                return future.result(timeout=_PATIENCE)
            except TimeoutError:
                if not self.is_alive():
                    raise TaskError(_ENDED) from None
            except BrokenExecutor as error:
                raise TaskError(_ENDED) from error


class Parts:
    """Parts of the data, in this process or divided among workers.

    Parameters
    ----------
    parts : iterable of callable
        The parts; workers need functions or objects that can be pickled.
    workers : sequence of Worker
        Processes that hold them, none for this one.
    """

    def __init__(self, parts: Iterable[Part], workers: Sequence[Worker] = ()) -> None:
        self._workers, self._key, self._count = workers, uuid.uuid4().hex, 0
        if not workers:
            self._parts = list(parts)
            return
        pending: deque[tuple[Worker, Any]] = deque()
        for part in parts:
            if len(pending) == len(workers):  # no more are in memory here
                first, future = pending.popleft()
                first.result(future)
            worker = workers[self._count % len(workers)]
            pending.append((worker, worker.submit(_hold, worker.key + self._key, part)))
            self._count += 1
        for worker, future in pending:
            worker.result(future)

    def __call__(self, *arguments: Any) -> list[Any]:
        """Return the result of each part for the same arguments, in the order of the parts."""
        if not self._workers:
            return [part(*arguments) for part in self._parts]
        used = self._workers[: self._count]
        running = [w.submit(_compute, w.key + self._key, arguments) for w in used]
        found = [worker.result(future) for worker, future in zip(used, running, strict=True)]
        return [found[n % len(found)][n // len(found)] for n in range(self._count)]


def _hold(key: str, part: Part) -> None:
    _held.setdefault(key, []).append(part)


def _release(prefix: str) -> None:
    for key in [key for key in _held if key.startswith(prefix)]:
        del _held[key]


def _compute(key: str, arguments: tuple[Any, ...]) -> list[Any]:
    with threadpool_limits(1, user_api="blas"):
        return [part(*arguments) for part in _held[key]]


@contextmanager
def started_workers(executor: Any) -> Iterator[list[Worker]]:
    """Return the workers of an executor; they release all parts at the end of the block.

    Parameters
    ----------
    executor : int, distributed.Client, the result of ``processes``, or None
        Number of processes on this machine, or a client of a dask cluster; None is no worker.

    Raises
    ------
    InputError
        If it is something else, or the cluster has no workers.
    """
    if executor is None:
        yield []
    elif hasattr(executor, "scheduler_info"):
        session = uuid.uuid4().hex
        try:
            yield _of_dask(executor, session)
        finally:
            executor.run(_release, session)
    elif isinstance(executor, int | Processes):
        several = executor if isinstance(executor, Processes) else processes(executor)
        pools = [several.pool() for _ in range(several.workers)]
        try:
            yield [Worker(pool.submit, "") for pool in pools]
        finally:
            for pool in pools:
                pool.shutdown(kill_workers=True)
    else:
        raise InputError(
            "executor must be a number of processes or a dask client, got "
            f"{type(executor).__name__}."
        )


def _of_dask(client: Any, session: str) -> list[Worker]:
    def worker(address: str) -> Worker:
        submit = partial(client.submit, workers=[address], pure=False)
        return Worker(submit, session + address, lambda: address in client.nthreads())

    if not (workers := [worker(address) for address in client.nthreads()]):
        raise InputError("The dask cluster has no workers yet: client.wait_for_workers(1).")
    return workers
