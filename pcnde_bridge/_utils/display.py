"""Short representations of objects: one line of text, and a table in notebooks."""

from collections.abc import Sequence
from dataclasses import fields
from html import escape
from importlib import import_module
from reprlib import Repr
from typing import Any

_SHORT = Repr()
_SHORT.maxother = _SHORT.maxstring = 60


class Displayed:
    """Object with a short ``repr`` and a table in notebooks, both of its facts."""

    def _facts(self) -> Sequence[str]:
        """Return what identifies the object: by default the fields, arrays by their shape."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        return [
            f"{name} {getattr(value, 'shape', None) or _SHORT.repr(value)}"
            for name, value in values.items()
            if value is not None
        ]

    def _rows(self) -> Sequence[str]:
        """Return the rows of the table: by default the facts."""
        return self._facts()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(self._facts())})"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><td>{escape(row)}</td></tr>" for row in self._rows())
        return f"<table><tr><th>{type(self).__name__}</th></tr>{rows}</table>"


def draw(name: str, *arguments: Any) -> Any:
    """Return a figure by a function of the higher subpackage plots, imported at this moment."""
    return getattr(import_module("pcnde_bridge.plots"), name)(*arguments)
