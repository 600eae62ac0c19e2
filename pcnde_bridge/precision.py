"""Double precision in JAX without touching the user's own setting."""

from __future__ import annotations

import importlib
from contextlib import AbstractContextManager
from typing import Any


def double_precision() -> AbstractContextManager[Any]:
    """Context in which JAX computes in float64."""
    import jax

    # Newer versions of JAX have it at the top, older ones under "experimental" only.
    where = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    context: AbstractContextManager[Any] = where.enable_x64(True)
    return context
