"""Independent tasks of a study, one after the other or side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from typing import Any, TypeVar

from pcnde_bridge.engines import Engine, EngineName

Result = TypeVar("Result")


def each(
    task: Callable[..., Result], *columns: Iterable[Any], executor: Executor | None = None
) -> Iterator[Result]:
    """Results of a task for each row of the columns, in their order.

    Parameters
    ----------
    task : callable
        A function of a module, so that worker processes can find it.
    *columns : iterables
        One for each argument of the task.
    executor : concurrent.futures.Executor, optional
        Who runs the tasks; None runs them here.
    """
    yield from map(task, *columns) if executor is None else executor.map(task, *columns)


def portable(engine: Engine, executor: Executor | None) -> Engine | EngineName:
    """Return the engine, or for the tasks of an executor its name.

    An engine holds compiled functions, which cannot go to another process; each
    process starts one of its own by the name.
    """
    return engine if executor is None else engine.name  # type: ignore[return-value]
