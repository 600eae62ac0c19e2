"""Independent tasks of a study, one after the other or side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pcnde_bridge.tasks import Workers, run

Result = TypeVar("Result")


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
        As :func:`pcnde_bridge.tasks.run` takes them.

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
