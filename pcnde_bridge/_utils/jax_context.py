"""Context for all calls of JAX: double precision, Ctrl-C, and compiled functions on disk.

JAX stores compiled functions in a folder and loads them in the next process, so that a second
fit compiles nothing.  Its keys contain the function, JAX's version and its options.
"""

import ctypes
import hashlib
import os
import platform
import shutil
import stat
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, wraps
from multiprocessing import current_process
from pathlib import Path
from typing import Any

from pcnde_bridge._utils import interrupts
from pcnde_bridge._utils.files import cache_folder
from pcnde_bridge.errors import EngineError, EngineUnavailableError


def _jax_runs() -> bool:
    """Return whether JAX has started the threads of a device, in this process or before a fork."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bridge.backends_are_initialized()


# This package may have been imported after the fork.
_forked = _jax_runs() and type(current_process()).__name__ == "ForkProcess"


def _after_fork() -> None:
    global _forked
    _forked = _jax_runs()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)

_SHORTEST_COMPILATION = 0.1  # s; loading a function takes about 0.01 s
_LARGEST_CACHE, _FREE_SPACE = 1 << 30, 1 << 29  # bytes
# M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of mallopt, and the largest that glibc itself chooses.
_THRESHOLDS = (-1, 1 << 26), (-3, 1 << 25)  # bytes


@cache
def _start() -> None:
    """Start JAX, once in each process."""
    import jax

    try:
        jax.devices()
    except Exception as error:  # of any kind, depending on the platform
        raise EngineUnavailableError(
            f"JAX has no device to compute on ({error}). Unset the environment variable "
            f"JAX_PLATFORMS, which is {os.environ.get('JAX_PLATFORMS')!r}."
        ) from error
    _reuse_memory()


def _reuse_memory() -> None:
    """Let glibc reuse the memory of arrays in workers of dask, whose setting returns it at once.

    Requesting it again for each computation takes longer than most computations.
    """
    if os.environ.get("MALLOC_TRIM_THRESHOLD_") == "65536":
        with suppress(AttributeError, OSError, TypeError):  # another C library
            mallopt = ctypes.CDLL(None).mallopt
            for threshold in _THRESHOLDS:
                mallopt(*threshold)


@cache
def _store_compiled_functions() -> None:
    """Let JAX store compiled functions, unless the user has named a folder or switched it off.

    A folder that other users can write to is not used, because JAX runs what it finds there.
    Damaged files and failures to write only cost time; JAX's warnings about them are ignored.
    """
    import jax

    settings: Any = jax.config
    named = settings.jax_compilation_cache_dir is not None
    if named or not settings.jax_enable_compilation_cache:
        return
    folder = cache_folder(None) / "compiled" / _machine()
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _remove_oldest(folder)
        if _is_private(folder) and shutil.disk_usage(folder).free > _FREE_SPACE:
            message = "Error (reading|writing) persistent compilation cache entry"
            warnings.filterwarnings("ignore", message)
            settings.update("jax_compilation_cache_dir", str(folder))
            minimum = "jax_persistent_cache_min_compile_time_secs"
            settings.update(minimum, _SHORTEST_COMPILATION)


def _machine() -> str:
    """Return a key of what compiled functions depend on and JAX's keys may not contain.

    It is a checksum of the processor's instruction sets and of the number of threads.
    """
    described = platform.machine() + platform.processor()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        described += next((x for x in lines if x.lower().startswith(("flags", "features"))), "")
    affinity = getattr(os, "sched_getaffinity", None)
    threads = os.environ.get("NPROC") or (len(affinity(0)) if affinity else os.cpu_count())
    return hashlib.sha256(f"{described} {threads}".encode()).hexdigest()[:16]


def _is_private(folder: Path) -> bool:
    """Return whether only this user, who can, may write to a folder."""
    found = folder.stat()
    owned = not hasattr(os, "getuid") or found.st_uid == os.getuid()  # Windows has no owners
    shared = os.name == "posix" and found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return owned and not shared and os.access(folder, os.W_OK)


def _remove_oldest(folder: Path) -> None:
    """Remove the oldest files until the rest is not larger than the largest cache."""
    files = [(file.stat(), file) for file in folder.iterdir()]
    size = 0
    for found, file in sorted(files, key=lambda pair: -pair[0].st_mtime):
        size += found.st_size
        if size > _LARGEST_CACHE:
            file.unlink()


@cache
def _compiler_options() -> dict[str, Any]:
    """Return options with which XLA compiles in two thirds of the time, where it knows them."""
    import jax

    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda: 0, compiler_options=options)()
    except Exception:  # of a type that depends on JAX's version
        return {}
    return options


def compiled(*static: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile a function that no other compiled one calls, for each value of the arguments named.

    Unlike :func:`jax.jit`, this does not start JAX before the function is called.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @cache
        def jitted() -> Any:
            import jax

            options = _compiler_options()
            return jax.jit(function, static_argnames=static, compiler_options=options)

        @wraps(function)
        def call(*arguments: Any, **settings: Any) -> Any:
            return jitted()(*arguments, **settings)

        return call

    return decorate


@contextmanager
def double_precision() -> Iterator[None]:
    """Compute in float64 inside the block, whatever the user's settings of JAX are.

    The settings are restored afterwards.  Ctrl-C is watched because JAX replaces a
    KeyboardInterrupt by a ValueError while it compares settings; see
    :func:`pcnde_bridge._utils.interrupts.watched`.

    Raises
    ------
    EngineError
        In a fork of a process in which JAX has computed: JAX would block there forever.
    EngineUnavailableError
        If JAX finds no device.
    """
    if _forked:
        raise EngineError(
            "JAX does not survive a fork: start worker processes with the 'spawn' method "
            '(multiprocessing.get_context("spawn")), or pass executor=2 to functions of many fits.'
        )
    _start()
    import jax

    _store_compiled_functions()
    with (
        interrupts.watched(),
        jax.enable_x64(True),
        # The user may have set stricter rules for their own code.
        jax.numpy_rank_promotion("allow"),
        jax.numpy_dtype_promotion("standard"),
    ):
        yield
