"""Checks that arguments of many functions have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pcnde_bridge.errors import InputError


def whole(name: str, value: Any, least: int = 0) -> int:
    """Return an argument that counts something, which may be one of numpy's integers.

    Raises
    ------
    InputError
        If it is no whole number, or less than ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name} must be a whole number ≥ {least}, got {value!r}.")
    return int(value)


def whole_seeds(seeds: Sequence[int]) -> list[int]:
    """Return the seeds of a study.

    Raises
    ------
    InputError
        If there are none, or one is no whole number ≥ 0, or comes twice.
    """
    found = [whole(f"seeds[{number}]", seed) for number, seed in enumerate(seeds)]
    if not found or len(set(found)) < len(found):
        raise InputError(f"Give at least one seed, and none twice; got {found}.")
    return found


def counted(n: int, noun: str) -> str:
    """Return a number with what it counts."""
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return f"{n} {noun if n == 1 else plural}"


def listed(values: Sequence[Any], most: int = 10) -> str:
    """List values in a message, but not hundreds of them."""
    text = ", ".join(str(value) for value in values[:most])
    return text if len(values) <= most else f"{text}, … ({len(values)} in all)"
