"""Checks of arguments: each returns the usable value or raises an ``InputError``."""

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import permutations
from numbers import Real
from os import PathLike
from pathlib import PurePath
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import psutil

from pcnde_bridge._typing import AnyArray, Array
from pcnde_bridge.errors import InputError

_T = TypeVar("_T")
_FEW = 1 << 24  # numbers that every machine has memory for


def whole(name: str, value: Any, least: int = 0) -> int:
    """Return an integer argument as an ``int``.

    Raises
    ------
    InputError
        If it is not a whole number, or less than ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name} must be a whole number ≥ {least}, got {value!r}.")
    return int(value)


def finite(name: str, value: Any, unit: str = "") -> float:
    """Return a finite real argument as a ``float``.

    Raises
    ------
    InputError
        If it is not a real number, or not finite.
    """
    return _real(name, value, unit, "finite", -math.inf)


def positive(name: str, value: Any, unit: str = "") -> float:
    """Return a positive and finite real argument as a ``float``.

    Raises
    ------
    InputError
        If it is not a real number, not finite, or not positive.
    """
    return _real(name, value, unit, "positive and finite", 0.0)


def check_memory(what: str, numbers: int, advice: str) -> None:
    """Raise if so many numbers do not fit into the free memory.

    Parameters
    ----------
    what : str
        What needs them, for the message.
    numbers : int
        Numbers of eight bytes.
    advice : str
        How to need fewer.

    Raises
    ------
    InputError
        If they need more memory than is free.
    """
    if numbers < _FEW:
        return
    free = psutil.virtual_memory().available
    if 8 * numbers > free:
        raise InputError(
            f"{what} would need {8 * numbers / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are "
            f"free: {advice}."
        )


def check_fields(instance: object, check: Callable[..., Any], **arguments: Any) -> None:
    """Check fields of a frozen dataclass, and replace them by the usable values.

    Parameters
    ----------
    instance : object
        The dataclass; messages have its name before the field's.
    check : callable
        Takes name, value and argument, such as :func:`finite`, and returns the usable value.
    **arguments
        For each field to check the third argument, such as its unit.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    for field, argument in arguments.items():
        value = check(f"{type(instance).__name__}.{field}", getattr(instance, field), argument)
        object.__setattr__(instance, field, value)


def _real(name: str, value: Any, unit: str, rule: str, above: float) -> float:
    # A truth value is one of Python's real numbers, but not meant as one.
    if isinstance(value, bool) or not isinstance(value, Real):
        rule = "a number"
    elif above < float(value) < math.inf:
        return float(value)
    raise InputError(f"{name} must be {rule}{_in(unit)}, got {value!r}.")


def _in(unit: str) -> str:
    return f" ({unit})" if unit else ""


def real_array(name: str, value: npt.ArrayLike) -> Array:
    """Return a C-contiguous float64 copy of an array of real numbers.

    A read-only memory map of such numbers is returned itself: it stays on disk.

    Raises
    ------
    InputError
        If it is ragged, masked or not of real numbers, a path, or a table with its axis.
    """
    if isinstance(value, str | PathLike) and PurePath(value).suffix:
        raise InputError(f"{name} is the path {str(value)!r}: read the file, and pass its numbers.")
    columns = [str(column) for column in getattr(value, "columns", ())]
    if len(columns) > 1 and columns[0].lower() in ("time", "t", "z", "x"):
        raise InputError(
            f"{name} is a table with the columns {listed(columns)}: pass one column, such as "
            f"table[{columns[1]!r}]."
        )
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{name} is not a regular array: {error}") from error
    if array.dtype.kind not in "iuf":
        raise InputError(
            f"{name} must hold real numbers, but its dtype is {array.dtype}; convert it, for "
            f"example with np.asarray({name}, dtype=float)"
        )
    if np.ma.is_masked(value):
        raise InputError(f"{name} has masked values; fill them or leave out their cases")
    on_disk = isinstance(value, np.memmap) and not array.flags.writeable
    return np.array(value, dtype=np.float64, order="C", copy=not on_disk or None, subok=on_disk)


def check_values(
    name: str, array: AnyArray, wrong: npt.NDArray[np.bool_], rule: str, offset: int = 0
) -> None:
    """Raise if values of an array break a rule; report the first one and their number.

    Parameters
    ----------
    name : str
        Name of the array, for the message.
    array, wrong : array, array of bool
        The values, and whether each breaks the rule.
    rule : str
        The rule, such as ``"areas must be positive (cm²)"``.
    offset : int
        Added to the reported index, for an array that is a part of a longer one.

    Raises
    ------
    InputError
        If any value is wrong.
    """
    if not wrong.any():
        return
    first = tuple(int(i) for i in np.argwhere(wrong)[0])
    place = f"[{', '.join(map(str, (first[0] + offset, *first[1:])))}]" if first else ""
    total = int(np.count_nonzero(wrong))
    more = "" if total == 1 else f"; {total} values of {name} are wrong in this way"
    raise InputError(f"{name}{place} is {array[first]}: {rule}{more}")


def check_finite(name: str, array: AnyArray, offset: int = 0) -> None:
    """Raise if an array has values that are not finite; report the first one.

    The offset is that of :func:`check_values`.

    Raises
    ------
    InputError
        If any value is NaN or infinite.
    """
    check_values(name, array, ~np.isfinite(array), "all values must be finite", offset)


def finite_array(name: str, value: npt.ArrayLike) -> Array:
    """Return a C-contiguous float64 copy of an array of finite real numbers.

    Raises
    ------
    InputError
        If it is ragged, masked or not of real numbers, or a value is not finite.
    """
    array = real_array(name, value)
    check_finite(name, array)
    return array


def finite_vector(name: str, values: npt.ArrayLike) -> Array:
    """Return a float64 copy of a row of finite real numbers.

    Raises
    ------
    InputError
        If it has another number of axes, or :func:`finite_array` raises.
    """
    array = finite_array(name, values)
    if array.ndim != 1:
        raise InputError(f"{name} must have one axis, but its shape is {array.shape}")
    return array


def check_increasing(name: str, array: Array, unit: str = "") -> None:
    """Raise unless a row of numbers increases strictly; report the first that does not.

    Raises
    ------
    InputError
        If a value is not larger than the one before it.
    """
    wrong = ~(np.diff(array) > 0)
    check_values(name, array[1:], wrong, f"{name} must be strictly increasing{_in(unit)}", offset=1)


def check_shape(name: str, array: AnyArray, shape: tuple[int, ...], axes: str = "") -> None:
    """Raise unless an array has the given shape.

    Parameters
    ----------
    name : str
        Name of the array, for the message.
    array : array
        The array.
    shape : tuple of int
        The shape that it must have.
    axes : str
        Names of the axes, for the message: ``"case, time, z"``.

    Raises
    ------
    InputError
        If the shape is another one; axes in another order and a missing axis of cases are
        pointed out.
    """
    if array.shape == shape:
        return
    named = f"({axes}) = {shape}" if axes else f"{shape}"
    hint = _axes_hint(name, array.shape, shape, axes.split(", "))
    raise InputError(f"{name} must have the shape {named}, but its shape is {array.shape}{hint}")


def _axes_hint(name: str, found: tuple[int, ...], shape: tuple[int, ...], axes: list[str]) -> str:
    """Return a hint for a shape that lacks the cases or has its axes in another order."""
    if len(found) == len(shape) - 1 and axes[0] == "case":
        return f"; for a single case pass {name}[np.newaxis]"
    for order in permutations(range(len(shape))):
        if tuple(shape[axis] for axis in order) == found:
            if len(axes) < len(shape):
                return "; it looks transposed"
            named = ", ".join(axes[axis] for axis in order)
            back = tuple(order.index(axis) for axis in range(len(shape)))
            return f"; that looks like ({named}): pass np.transpose({name}, {back})"
    return ""


@contextlib.contextmanager
def naming(name: object) -> Iterator[None]:
    """Put a name before the messages of input errors.

    Parameters
    ----------
    name : str or Path
        Name of the file whose content the block checks.

    Raises
    ------
    InputError
        If the block raises one: ``"name: message"``.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def all_of(kind: type[_T], name: str, values: object) -> tuple[_T, ...]:
    """Return objects of one kind as a tuple.

    Raises
    ------
    InputError
        If one is of another kind, or they are not a sequence.
    """
    if not isinstance(values, Iterable):
        wanted = "sequence" if kind is object else f"sequence of {kind.__name__}"
        raise InputError(f"{name} must be a {wanted}, got {type(values).__name__}.")
    found = tuple(values)
    for i, value in enumerate(found):
        if not isinstance(value, kind):
            raise InputError(f"{name}[{i}] must be a {kind.__name__}, got {type(value).__name__}.")
    return found


def whole_seeds(seeds: Sequence[int]) -> list[int]:
    """Return random seeds as a list of ``int``.

    Raises
    ------
    InputError
        If the list is empty, or a seed is not a whole number ≥ 0, or is repeated.
    """
    found = [whole(f"seeds[{number}]", seed) for number, seed in enumerate(seeds)]
    if not found or len(set(found)) < len(found):
        raise InputError(f"Give at least one seed, and none twice; got {found}.")
    return found


def counted(n: int, noun: str) -> str:
    """Return a count with its noun, in the plural where needed: ``"2 geometries"``."""
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return f"{n} {noun if n == 1 else plural}"


def listed(values: Sequence[Any], most: int = 10, separator: str = ", ") -> str:
    """Return the first values as text for a message, and how many there are."""
    shown = [str(value) for value in values[:most]]
    more = [f"… ({len(values)} in all)"] if len(values) > most else []
    return separator.join(shown + more)
