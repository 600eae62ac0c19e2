"""Julia of this process: started once through juliacall, called with arrays and settings."""

import functools
import json
import os
import re
import subprocess
import sys
import threading
import tomllib
import types
import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import Config, PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.julia.environment import (
    SIGNALS,
    THREADS,
    check_core,
    how_to_prepare,
    julia_status,
)
from pcnde_bridge.errors import EngineError, EngineUnavailableError, PCNDEWarning, SolveError

# In a module of its own, which leaves the user's Main unchanged; juliacall.newmodule takes 1 s.
_LOAD = 'include_string(Module(:PCNDEBridge), "using PCNDECore; PCNDECore.call")'


class Julia:
    """The running Julia: PCNDECore's functions, with arrays and errors converted.

    Attributes
    ----------
    versions : dict of str to str
        Versions of Julia and the packages that compute.
    problem : object
        Identity of the objective whose data PCNDECore stores.
    """

    def __init__(self) -> None:
        self._juliacall = start()
        self._process, self._thread = os.getpid(), threading.get_ident()
        project = str(self._juliacall.CONFIG["project"])
        try:
            self._julia_call = self._juliacall.Main.seval(_LOAD)
        except self._juliacall.JuliaError as error:
            raise EngineUnavailableError(
                f"PCNDECore does not load in the Julia project {project}: "
                f"{self._text(error)}. {how_to_prepare()}"
            ) from error
        self.versions: dict[str, str] = tomllib.loads(self.call("versions"))
        check_core(self.versions["PCNDECore"], "running", project)
        try:
            self.call("self_check")
        except EngineError as error:
            raise EngineUnavailableError(f"{error} {how_to_prepare()}") from error
        self._config = functools.lru_cache(maxsize=64)(self._new_config)
        self.problem: object = None

    def call(self, name: str, *arguments: Any, in_place: Iterable[Array] = ()) -> Any:
        """Call one of PCNDECore's functions; arrays and settings are converted.

        Parameters
        ----------
        name : str
            The function's name.
        *arguments
            Arrays, tuples of arrays, settings, numbers and callables, and a grid, which is passed
            as its points and its period.
        in_place : iterable of arrays
            Float64 and C-ordered; their addresses and shapes are passed last.  The function
            reads and writes them in place, and keeps no reference.

        Raises
        ------
        SolveError
            If an equation cannot be solved.
        EngineError
            If Julia fails otherwise, or is called from another thread or process.
        """
        if os.getpid() != self._process:
            raise EngineError(
                "Julia does not survive a fork: start worker processes with the 'spawn' method "
                '(multiprocessing.get_context("spawn")), and create the engine there.'
            )
        if threading.get_ident() != self._thread:
            raise EngineError(
                "Julia answers only in the thread that started it: create and use the engine in "
                'one thread, or use engine="jax", which works in any thread.'
            )
        try:
            addresses = [number for array in in_place for number in _memory(array)]
            given = [converted for value in arguments for converted in self._to_julia(value)]
            result = self._julia_call(name, *given, *addresses)
            return self._to_python(result)
        except self._juliacall.JuliaError as error:
            failure = self._failure(error)
        # Raised here, so that it refers to no Julia object, which another thread might release.
        raise failure

    def _to_julia(self, value: Any) -> tuple[Any, ...]:
        """Copy arrays: a C-ordered (case, time, z) array is (z, time, case) in Julia's order."""
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value, dtype=np.float64)
            return (self._julia_call("copy_python_array", *_memory(array)),)
        if isinstance(value, tuple):
            return (tuple(each for part in value for each in self._to_julia(part)),)
        if isinstance(value, Grid):
            return *self._to_julia(value.z), float(value.period)
        if isinstance(value, Config):
            return (self._config(value),)
        return (value,)

    def _to_python(self, value: Any) -> Any:
        """Copy arrays: the results own their memory and are no views of Julia's."""
        if isinstance(value, self._juliacall.ArrayValue):
            return np.array(value.to_numpy(copy=False).T, order="C")
        if isinstance(value, tuple):
            return tuple(map(self._to_python, value))
        return value

    def _new_config(self, config: Config) -> Any:
        """Return Julia's copy of the settings, passed as TOML of plain numbers and strings."""
        lines = [
            f"{group}.{name} = {json.dumps(value)}"
            for group, settings in config.to_dict().items()
            if isinstance(settings, dict)
            for name, value in settings.items()
            if value is not None
        ]
        read = "config" if isinstance(config, PCNDEConfig) else "closure_config"
        return self._julia_call(read, "\n".join(lines))

    def _failure(self, error: Any) -> BaseException:
        kind = str(self._juliacall.Base.nameof(self._juliacall.Base.typeof(error.exception)))
        if kind == "InterruptException":
            return KeyboardInterrupt()
        if kind == "SolveError":
            text = self._text(error)
            return SolveError(text, map(int, re.findall(r"case (\d+)", text)))
        failure = EngineError(f"Julia failed: {self._text(error)}")
        failure.__cause__ = RuntimeError(str(error))  # with Julia's stack trace
        return failure

    def _text(self, error: Any) -> str:
        """Return Julia's own message, without its stack trace."""
        base = self._juliacall.Base
        text = str(base.sprint(base.showerror, error.exception)).strip()
        return text if len(text) <= 1000 else f"{text[:1000]} …"


def _memory(array: Array) -> tuple[int, ...]:
    """Return address and shape in Julia's order: Julia need not compile for Python's types."""
    return array.__array_interface__["data"][0], *reversed(array.shape)


_START = threading.Lock()


def running() -> Julia:
    """Return the :class:`Julia` of this process, started if necessary."""
    with _START:
        return _julia()


@functools.cache
def _julia() -> Julia:
    return Julia()


def start() -> types.ModuleType:
    """Start Julia through juliacall; return juliacall.

    Raises
    ------
    EngineUnavailableError
        If Julia cannot start; the message says what is missing and what to do.
    """
    status = julia_status()
    is_running = status.source == "running"
    if not (status.usable or status.installable or is_running):
        raise EngineUnavailableError(status.message)
    if status.threads != "1" and status.handle_signals == "no":
        problem = (
            f"Julia with {status.threads} threads must handle signals, otherwise the process may "
            f"crash: set {SIGNALS}=yes or {THREADS}=1 before pcnde_bridge, or another package, "
            "starts Julia."
        )
        if not is_running:
            raise EngineUnavailableError(problem)
        warnings.warn(problem, PCNDEWarning, stacklevel=6)
    os.environ.update(status.environment)
    try:
        import juliacall
    except Exception as error:
        output = str(getattr(error, "stderr", None) or error).strip().splitlines() or [repr(error)]
        raise EngineUnavailableError(
            f"Julia did not start: {output[-1].rstrip('.')}. {how_to_prepare()}"
        ) from error
    return juliacall


def load_error(timeout: float | None = None) -> str:
    """Start Julia with all packages in a new process; return its error message, empty if none.

    Parameters
    ----------
    timeout : float, optional
        Longest time to wait, s; by default, until everything is compiled.
    """
    command = [sys.executable, "-c", f"from {__name__} import running; running()"]
    try:
        done = subprocess.run(command, capture_output=True, check=False, timeout=timeout)
    except subprocess.TimeoutExpired:
        return (
            f"Julia did not load its packages in {timeout:g} s: pcnde doctor --load compiles them."
        )
    if done.returncode == 0:
        return ""
    # The last line of a traceback is the kind of the error and its message.
    message = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    return message.rpartition("Error: ")[2] or f"Julia ended with exit code {done.returncode}."
