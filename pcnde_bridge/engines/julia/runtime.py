"""The one Julia of this process: started through juliacall, called with arrays and settings."""

from __future__ import annotations

import functools
import json
import os
import sys
import threading
import types
import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig, PCNDEConfig
from pcnde_bridge.engines.julia.project import (
    compatible,
    core_version,
    incompatible,
    julia_sources,
)
from pcnde_bridge.engines.julia.status import (
    EXECUTABLE,
    PROJECT,
    SIGNALS,
    THREADS,
    JuliaStatus,
    choose,
    how_to_prepare,
    juliacall_settings,
    status_of,
)
from pcnde_bridge.errors import (
    EngineError,
    EngineUnavailableError,
    PCNDEWarning,
    SolveError,
)


class Julia:
    """The running Julia: PCNDECore's entry points, with arrays and errors converted."""

    def __init__(self) -> None:
        self._juliacall = start()
        self._process, self._thread = os.getpid(), threading.get_ident()
        # A module of our own keeps the user's Main as it is.
        module = self._juliacall.newmodule("PCNDEBridge")
        try:
            module.seval("using PCNDECore")
        except self._juliacall.JuliaError as error:
            raise EngineUnavailableError(
                "PCNDECore does not load in the Julia project "
                f"{self._juliacall.CONFIG['project']}: {self._words(error)}. {how_to_prepare()}"
            ) from error
        self._core = module.PCNDECore
        # A function's name is looked up once: each time takes as long as calling it.
        self._function = functools.lru_cache(functools.partial(getattr, self._core))
        found, ours = self.versions()["PCNDECore"], core_version(julia_sources()) or ""
        if not compatible(found, ours):
            project = str(self._juliacall.CONFIG["project"])
            raise EngineUnavailableError(incompatible(found, "running", ours, project))
        self._config = functools.lru_cache(maxsize=64)(self._new_config)
        self.held: object = None  # whose problem Julia holds

    def versions(self) -> dict[str, str]:
        """Versions of Julia and the packages that compute."""
        return {str(name): str(version) for name, version in self.call("versions").items()}

    def call(self, name: str, *arguments: Any, in_place: Iterable[Array] = ()) -> Any:
        """Call one of PCNDECore's functions; arrays and settings are converted.

        Of the arrays ``in_place``, float64 and C-ordered, the function is told, last, where
        they are; it reads and fills them there, and keeps none.
        """
        if os.getpid() != self._process:
            raise EngineError(
                "Julia does not survive a fork: start worker processes with the 'spawn' method "
                '(multiprocessing.get_context("spawn")), and make the engine there.'
            )
        if threading.get_ident() != self._thread:
            raise EngineError(
                "Julia answers only in the thread that started it: make and use the engine in "
                'one thread, or take engine="jax", which any thread may use.'
            )
        try:
            where = [number for array in in_place for number in _memory(array)]
            result = self._function(name)(*map(self._to_julia, arguments), *where)
            return self._to_python(result)
        except self._juliacall.JuliaError as error:
            failure = self._failure(error)
        # Raised here, so that it holds nothing of Julia's, which another thread might let go.
        raise failure

    def _to_julia(self, value: Any) -> Any:
        """Copy arrays: a C-ordered (case, time, z) array is (z, time, case) in Julia's order."""
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value, dtype=np.float64)
            return self._function("from_python")(*_memory(array))
        if isinstance(value, tuple):
            return tuple(map(self._to_julia, value))
        if isinstance(value, PCNDEConfig | ClosureConfig):
            return self._config(value)
        return value

    def _to_python(self, value: Any) -> Any:
        """Copy arrays: the results are numpy's own, not views of Julia's memory."""
        if isinstance(value, self._juliacall.ArrayValue):
            return np.array(value.to_numpy(copy=False).T, order="C")
        if isinstance(value, tuple):
            return tuple(map(self._to_python, value))
        return value

    def _new_config(self, config: PCNDEConfig | ClosureConfig) -> Any:
        """Julia's copy of the settings, as a TOML text of plain numbers and words."""
        lines = [
            f"{group}.{name} = {json.dumps(value)}"
            for group, settings in config.to_dict().items()
            if isinstance(settings, dict)
            for name, value in settings.items()
            if value is not None
        ]
        read = self._core.config if isinstance(config, PCNDEConfig) else self._core.closure_config
        return read("\n".join(lines))

    def _failure(self, error: Any) -> BaseException:
        kind = str(self._juliacall.Base.nameof(self._juliacall.Base.typeof(error.exception)))
        if kind == "InterruptException":
            return KeyboardInterrupt()
        if kind == "SolveError":
            return SolveError(self._words(error))
        failure = EngineError(f"Julia failed: {self._words(error)}")
        failure.__cause__ = RuntimeError(str(error))  # with Julia's stack trace
        return failure

    def _words(self, error: Any) -> str:
        """Julia's own message, without its stack trace."""
        base = self._juliacall.Base
        text = str(base.sprint(base.showerror, error.exception)).strip()
        return text if len(text) <= 1000 else f"{text[:1000]} …"


def _memory(array: Array) -> tuple[int, ...]:
    """Address and shape in Julia's order, so that Julia need not compile for Python's types."""
    return array.__array_interface__["data"][0], *reversed(array.shape)


_lock = threading.Lock()
_julia: Julia | None = None
_warned = False


def running() -> Julia:
    """Return it, started if need be."""
    global _julia
    with _lock:
        if _julia is None:
            _julia = Julia()
        return _julia


def start() -> types.ModuleType:
    """Start Julia through juliacall; return juliacall.

    Raises
    ------
    EngineUnavailableError
        Saying what is missing and how to mend it.
    """
    choice = choose()
    status = status_of(choice)
    if choice.source == "running":
        _warn_if_foreign(status)
    elif not (status.usable or status.installable):
        raise EngineUnavailableError(status.message)
    elif status.threads != "1" and status.handle_signals == "no":
        raise EngineUnavailableError(
            f"Julia with {status.threads} threads must handle signals, or it dies of its own: "
            f"unset {SIGNALS}, or set {THREADS}=1."
        )
    else:
        for name, value in {**choice.environment, **juliacall_settings()}.items():
            os.environ.setdefault(name, value)
        if choice.executable and choice.project:
            os.environ[EXECUTABLE] = choice.executable
            os.environ[PROJECT] = choice.project
        if status.installable:
            print(
                "pcnde_bridge installs Julia and its packages, once; this takes some minutes.",
                file=sys.stderr,
            )
    try:
        import juliacall
    except Exception as error:
        raise EngineUnavailableError(
            f"Julia did not start: {_last_line(error)}. {how_to_prepare()}"
        ) from error
    return juliacall  # type: ignore[no-any-return]


def _last_line(error: Exception) -> str:
    output = getattr(error, "stderr", None) or str(error)
    return str(output).strip().splitlines()[-1].rstrip(".") if str(output).strip() else repr(error)


def _warn_if_foreign(status: JuliaStatus) -> None:
    """Warn, once, of another package's settings that are not safe."""
    global _warned
    if status.threads != "1" and status.handle_signals == "no" and not _warned:
        _warned = True
        warnings.warn(
            f"Julia was already started by another package with {status.threads} threads but "
            "without its signals, and may crash. Make the pcnde_bridge engine first, or set "
            f"{SIGNALS}=yes.",
            PCNDEWarning,
            stacklevel=5,
        )
