"""Context for all calls of JAX: double precision, and a reliable Ctrl-C."""

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
    """Return the identifier of the process in which JAX first computed."""
    return os.getpid()


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
    """
    if os.getpid() != _process():
        raise EngineError(
            "JAX does not survive a fork: start worker processes with the 'spawn' method "
            '(multiprocessing.get_context("spawn")), as '
            "pcnde_bridge._utils.parallel.processes does."
        )
    import jax

    # Newer versions of JAX have it at the top level, older ones only under "experimental".
    module = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    with (
        interrupts.watched(),
        module.enable_x64(True),
        # The user may have set stricter rules for their own code.
        jax.numpy_rank_promotion("allow"),
        jax.numpy_dtype_promotion("standard"),
    ):
        yield
