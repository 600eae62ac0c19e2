"""Findings of ``pcnde doctor``: engines and data on this machine."""

import platform
from importlib.metadata import version
from typing import NamedTuple

from pcnde_bridge.engines.julia.environment import julia_status
from pcnde_bridge.engines.julia.runtime import load_error
from pcnde_bridge.errors import PCNDEError
from pcnde_bridge.io.datasets import find_published


class Finding(NamedTuple):
    """Result of one check.

    Attributes
    ----------
    what, found, advice : str
        Subject, result, and suggested fix.
    good : bool
        Whether it is usable as it is.
    """

    what: str
    found: str
    advice: str = ""
    good: bool = True


def examine(load: bool = False) -> list[Finding]:
    """Check everything; engines are not started in this process.

    Parameters
    ----------
    load : bool
        Whether to load Julia's packages in another process even if they are not precompiled,
        which takes minutes; precompiled packages are always loaded.
    """
    python = Finding("Python", f"{platform.python_version()} on {platform.machine()}")
    jax = Finding("engine jax", f"jax {version('jax')}, diffrax {version('diffrax')}")
    return [python, jax, _julia(load), _data()]


def _julia(load: bool) -> Finding:
    status = julia_status()
    if not status.usable:
        return Finding("engine julia", "not usable", status.message, good=False)
    facts = [
        f"Julia {status.version or 'running'} ({status.executable}), from {status.source}",
        f"project {status.project}",
        ", ".join(f"{name} {found}" for name, found in sorted(status.packages.items())),
        "precompiled" if status.precompiled else "not precompiled: the first start takes minutes",
        "offline" if status.offline else "online",
        f"threads {status.threads}, handles signals: {status.handle_signals}",
    ]
    found, advice = "; ".join(fact for fact in facts if fact), status.warning
    if status.source != "running" and (load or status.precompiled):
        if error := load_error(timeout=None if load else 120):
            return Finding("engine julia", f"does not load; {found}", error, good=False)
    elif not status.precompiled:
        advice = advice or "pcnde doctor --load compiles the packages now and reports errors"
    return Finding("engine julia", found, advice)


def _data() -> Finding:
    advice = "pcnde download, or set PCNDE_DATA to the folder that holds data_3D"
    try:
        folder = find_published()
    except PCNDEError as error:
        return Finding("published data", str(error), "correct PCNDE_DATA", good=False)
    if folder is None:
        return Finding("published data", "not on this machine", advice, good=False)
    return Finding("published data", str(folder))
