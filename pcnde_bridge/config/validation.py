"""Validation and serialization shared by all groups of settings."""

import dataclasses
import json
import math
import numbers
import types
import typing
from collections.abc import Mapping
from typing import Any, Literal, Self

from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.errors import InputError

_CURRENT_NAMES = {
    "all_at_once": "full_batch",
    "batches": "minibatch",
    "known_flow_iterations": "collocation_iterations",
    "last_instant": "last_time_point",
    "normalised": "normalized",
    "optimiser": "optimizer",
    "wave_weight": "amplitude_exponent",
}
"""Settings and choices by the names that older files give them."""

_FORMER_SETTINGS = {"check_every", "patience", "starts", "validation"}
"""Settings of the training on all cases that older files have, and that no fit uses now."""


def current_names(settings: Any) -> Any:
    """Return settings read from a file with older names replaced by the current ones."""
    if isinstance(settings, Mapping):
        return {
            _CURRENT_NAMES.get(name, name): current_names(value)
            for name, value in settings.items()
            if name not in _FORMER_SETTINGS
        }
    return _CURRENT_NAMES.get(settings, settings) if isinstance(settings, str) else settings


def positive(default: Any) -> Any:
    """Return a dataclass field for a positive setting (None, where allowed, passes)."""
    return dataclasses.field(default=default, metadata={"rule": "positive"})


def signed(default: Any) -> Any:
    """Return a dataclass field for a setting that may be negative."""
    return dataclasses.field(default=default, metadata={"rule": "any number"})


def layer_widths(*default: int) -> Any:
    """Return a dataclass field for the widths of at least one hidden layer."""
    return dataclasses.field(default=default, metadata={"rule": "positive", "nonempty": True})


class Section(Displayed):
    """Group of settings: a frozen dataclass whose values are checked when it is created."""

    def __repr__(self) -> str:
        values = [(f, getattr(self, f.name)) for f in dataclasses.fields(self)]  # type: ignore[arg-type]
        changes = ", ".join(f"{f.name}={value!r}" for f, value in values if value != f.default)
        return f"{type(self).__name__}({changes})"

    def _rows(self) -> list[str]:
        return [f"{name}: {value}" for name, value in self.to_dict().items()]

    def __post_init__(self) -> None:
        hints = typing.get_type_hints(type(self))
        for f in dataclasses.fields(self):  # type: ignore[arg-type]
            where, value = f"{type(self).__name__}.{f.name}", getattr(self, f.name)
            if isinstance(f.default, Section) and isinstance(value, Mapping):
                value = f.default.replace(**value)
            checked = _checked(value, hints[f.name], where, f.metadata.get("rule", "at least 0"))
            object.__setattr__(self, f.name, checked)
            if f.metadata.get("nonempty", False) and not checked:
                raise InputError(f"{where} must not be empty.")

    def replace(self, /, **changes: Any) -> Self:
        """Return a copy with some settings changed.

        Parameters
        ----------
        **changes
            New values.  A group of settings can be given as a mapping of the
            settings to change in it: ``config.replace(flow={"epochs": 10})``.

        Raises
        ------
        InputError
            If a name is unknown or a value is not usable.
        """
        names = {f.name for f in dataclasses.fields(self)}  # type: ignore[arg-type]
        for name, value in changes.items():
            if name not in names:
                raise InputError(
                    f"{type(self).__name__} has no setting {name!r}; it has {sorted(names)}."
                )
            old = getattr(self, name)
            if isinstance(old, Section) and isinstance(value, Mapping):
                changes[name] = old.replace(**value)
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as nested plain dictionaries, ready for JSON."""
        return dataclasses.asdict(self)  # type: ignore[call-overload]


class Settings(Section):
    """Complete configuration, which can be read from and written to mappings and JSON."""

    def to_json(self) -> str:
        """Return the settings as a JSON text that :meth:`from_json` reads."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Self:
        """Return settings from nested mappings; omitted ones keep their defaults.

        Raises
        ------
        InputError
            If a name is unknown or a value is not usable.
        """
        if not isinstance(settings, Mapping):
            raise InputError(f"A configuration must be a mapping of groups, got {settings!r}.")
        return cls().replace(**current_names(settings))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return settings from a JSON text, the inverse of :meth:`to_json`.

        Raises
        ------
        InputError
            If the text is not JSON, a name is unknown or a value is not usable.
        """
        try:
            settings = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"The configuration is not JSON: {error}.") from error
        return cls.from_dict(settings)


def _checked(value: Any, hint: Any, where: str, rule: str) -> Any:
    """Return ``value`` as the annotated type, or raise an error that explains the mismatch."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        if value not in arguments:
            raise InputError(f"{where} must be one of {list(arguments)}, got {value!r}.")
        return value
    if origin in (types.UnionType, typing.Union):
        if value is None:
            return None
        (hint,) = (a for a in arguments if a is not type(None))
        return _checked(value, hint, where, rule)
    if origin is tuple:
        if isinstance(value, str) or not isinstance(value, list | tuple):
            raise InputError(f"{where} must be a sequence, got {value!r}.")
        return tuple(_checked(v, arguments[0], f"{where}[{i}]", rule) for i, v in enumerate(value))
    accepted = {int: numbers.Integral, float: numbers.Real}.get(hint, hint)
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        raise InputError(f"{where} must be {hint.__name__}, got {value!r}.")
    if accepted is hint:
        return value
    try:
        number = hint(value)  # from a number of another library, such as numpy
        is_finite = math.isfinite(number)
    except OverflowError:  # an integer beyond all floats
        is_finite = False
    if not is_finite:
        rule = "finite"
    elif rule == "any number" or number > 0 or (number == 0 and rule == "at least 0"):
        return number
    raise InputError(f"{where} must be {rule}, got {value!r}.")
