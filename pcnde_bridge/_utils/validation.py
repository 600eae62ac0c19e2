"""Checks that arguments of many functions have in common."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any, TypeVar

import numpy as np

from pcnde_bridge.errors import InputError

_T = TypeVar("_T")


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


def finite(name: str, value: Any, unit: str = "") -> float:
    """Return an argument that is a real number, which may be one of numpy's.

    Raises
    ------
    InputError
        If it is no real number, or not finite.
    """
    number = _real(name, value, unit)
    if not math.isfinite(number):
        raise InputError(f"{name} must be finite{_in(unit)}, got {value!r}.")
    return number


def positive(name: str, value: Any, unit: str = "") -> float:
    """Return an argument that is a positive real number, which may be one of numpy's.

    Raises
    ------
    InputError
        If it is no real number, not finite, or not positive.
    """
    number = _real(name, value, unit)
    if not 0.0 < number < math.inf:
        raise InputError(f"{name} must be positive and finite{_in(unit)}, got {value!r}.")
    return number


def _real(name: str, value: Any, unit: str) -> float:
    # A truth value is one of Python's real numbers, but not meant as one.
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{name} must be a number{_in(unit)}, got {value!r}.")
    return float(value)


def _in(unit: str) -> str:
    return f" ({unit})" if unit else ""


def all_of(kind: type[_T], name: str, values: Iterable[Any]) -> tuple[_T, ...]:
    """Return objects that are all of one kind.

    Raises
    ------
    InputError
        If one is of another kind, or they are not a sequence.
    """
    if not isinstance(values, Iterable):
        raise InputError(f"{name} must be a sequence of {kind.__name__}, got {_kind(values)}.")
    found = tuple(values)
    for i, value in enumerate(found):
        if not isinstance(value, kind):
            raise InputError(f"{name}[{i}] must be a {kind.__name__}, got {_kind(value)}.")
    return found


def _kind(value: Any) -> str:
    return type(value).__name__


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
