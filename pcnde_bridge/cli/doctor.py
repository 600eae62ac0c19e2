"""What is usable on this machine: engines, packages, data."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import NamedTuple

from pcnde_bridge.engines.julia.environment import julia_status
from pcnde_bridge.errors import PCNDEError
from pcnde_bridge.io.datasets import find_published


class Finding(NamedTuple):
    """One thing that was looked at.

    Attributes
    ----------
    what, found, advice : str
        What it is, what was found, and what to do if it is not good.
    good : bool
        Whether it can be used as it is.
    is_engine : bool
        Whether it is a computing engine.
    """

    what: str
    found: str
    advice: str = ""
    good: bool = True
    is_engine: bool = False


def examine() -> list[Finding]:
    """Look at everything, without starting an engine."""
    return [
        Finding("Python", f"{platform.python_version()} on {platform.machine()}"),
        _jax(),
        _julia(),
        _data(),
    ]


def _jax() -> Finding:
    missing = [name for name in ("jax", "diffrax") if find_spec(name) is None]
    if missing:
        return Finding(
            "engine jax",
            f"{' and '.join(missing)} missing",
            f"pip install {' '.join(missing)}",
            good=False,
            is_engine=True,
        )
    found = f"jax {_version('jax')}, diffrax {_version('diffrax')}"
    return Finding("engine jax", found, is_engine=True)


def _julia() -> Finding:
    status = julia_status()
    if not status.usable:
        return Finding("engine julia", "not usable", status.message, good=False, is_engine=True)
    packages = ", ".join(f"{name} {found}" for name, found in sorted(status.packages.items()))
    facts = [
        f"Julia {status.version or 'running'} ({status.executable}), from {status.source}",
        f"project {status.project}",
        packages,
        "precompiled" if status.precompiled else "not precompiled: the first start takes minutes",
        "offline" if status.offline else "online",
        f"threads {status.threads}, handles signals: {status.handle_signals}",
    ]
    found = "; ".join(fact for fact in facts if fact)
    return Finding("engine julia", found, status.warning, is_engine=True)


def _data() -> Finding:
    try:
        folder = find_published()
    except PCNDEError as error:
        return Finding("published data", str(error), "correct PCNDE_DATA", good=False)
    if folder is None:
        return Finding(
            "published data",
            "not on this machine",
            "pcnde download, or set PCNDE_DATA to the folder that holds data_3D",
            good=False,
        )
    return Finding("published data", str(folder))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
