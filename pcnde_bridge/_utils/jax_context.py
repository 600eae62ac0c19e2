"""What every call of JAX needs: double precision, and a Ctrl-C that stays one."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from pcnde_bridge._utils import interrupts
from pcnde_bridge.errors import EngineError


@cache
def _process() -> int:
    """Return the process in which JAX has begun to compute."""
    return os.getpid()


@contextmanager
def double_precision() -> Iterator[None]:
    """Context in which JAX computes in float64, whatever the user set, and leaves that as it is.

    JAX makes a ValueError of a Ctrl-C that comes while it compares settings; see
    :func:`pcnde_bridge._utils.interrupts.kept`.

    Raises
    ------
    EngineError
        In a fork of a process in which JAX has computed: JAX would wait for ever there.
    """
    if os.getpid() != _process():
        raise EngineError(
            "JAX does not survive a fork: start worker processes with the 'spawn' method "
            '(multiprocessing.get_context("spawn")), as '
            "pcnde_bridge._utils.parallel.processes does."
        )
    import jax

    # Newer versions of JAX have it at the top, older ones under "experimental" only.
    where = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    with (
        interrupts.kept(),
        where.enable_x64(True),
        # The user's own code may be held to stricter rules than ours.
        jax.numpy_rank_promotion("allow"),
        jax.numpy_dtype_promotion("standard"),
    ):
        yield
