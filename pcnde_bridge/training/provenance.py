"""Provenance: how a model was trained, so that the fit can be reproduced."""

from __future__ import annotations

import platform
import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from pcnde_bridge._version import __version__
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine


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
            **{name: version_of(name) for name in ("numpy", "pandas", "scipy")},
            **engine.versions,
        },
        "platform": platform.platform(),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "trained": datetime.now(UTC).isoformat(timespec="seconds"),
    }
