"""Provenance: how a model was trained, so that the fit can be reproduced."""

import platform
import re
import shlex
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pcnde_bridge._version import __version__
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import InputError

_version_of = cache(version)  # it reads a file
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")  # terminals may interpret them


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and not _CONTROL.search(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int)


def _are_labels(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(key, list) and len(key) == 2 and all(map(_is_whole, key)) for key in value
    )


def _are_versions(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, [*value, *value.values()]))


_TEXT = "text without control characters"
_SCHEMA: dict[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(("seed", "cases"), (_is_whole, "a whole number")),
    "cases_labels": (_are_labels, "a list of pairs (geometry, waveform)"),
    "versions": (_are_versions, f"an object of {_TEXT}"),
    "seconds": (lambda value: isinstance(value, int | float), "a number"),
    **dict.fromkeys(
        ("cases_fingerprint", "engine", "platform", "command", "trained", "source"),
        (_is_text, _TEXT),
    ),
}


def provenance(cases: Cases, engine: Engine, seed: int) -> dict[str, Any]:
    """Collect the facts of a fit that starts now.

    Parameters
    ----------
    cases : Cases
        Training cases; their number, labels (geometry and waveform) and fingerprint are
        stored.
    engine : Engine
        Compute engine; its name and the versions of its packages are stored.
    seed : int
        Random seed of the fit.

    Returns
    -------
    dict
        Facts that JSON can store.
    """
    keys = cases.labels[["geometry", "waveform"]].to_numpy()
    return {
        "seed": seed,
        "cases": len(cases),
        "cases_labels": [[int(value) for value in key] for key in keys],
        "cases_fingerprint": cases.fingerprint(),
        "engine": engine.name,
        "versions": {
            "pcnde_bridge": __version__,
            "python": platform.python_version(),
            **{name: _version_of(name) for name in ("numpy", "pandas", "scipy")},
            **engine.versions,
        },
        "platform": platform.platform(),
        "command": _CONTROL.sub("?", shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])),
        "trained": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def provenance_from(facts: Any) -> dict[str, Any]:
    """Return the provenance that a file states, after checking it.

    Parameters
    ----------
    facts : dict
        Result of :func:`provenance`, read from JSON.  Facts may be missing; unknown ones are
        retained.

    Raises
    ------
    InputError
        If it is not a dictionary, or a known fact has the wrong type or control characters.
    """
    if not isinstance(facts, dict):
        raise InputError(f"provenance must be an object, got {facts!r:.80}")
    for name, (valid, rule) in _SCHEMA.items():
        if name in facts and not valid(facts[name]):
            raise InputError(f"provenance.{name} must be {rule}, got {facts[name]!r:.80}")
    return dict(facts)
