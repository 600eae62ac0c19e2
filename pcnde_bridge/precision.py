"""What every call of JAX needs: double precision, and a Ctrl-C that stays one."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager

from pcnde_bridge import interrupts


@contextmanager
def double_precision() -> Iterator[None]:
    """Context in which JAX computes in float64, without touching the user's own setting.

    JAX makes a ValueError of a Ctrl-C that comes while it compares settings; see
    :func:`pcnde_bridge.interrupts.kept`.
    """
    import jax

    # Newer versions of JAX have it at the top, older ones under "experimental" only.
    where = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    with interrupts.kept(), where.enable_x64(True):
        yield
