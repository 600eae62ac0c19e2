"""Fast, accurate one-dimensional blood-flow models that learn from 3D simulation.

Physics-constrained coupled neural differential equations (PCNDE) after Csala,
Mohan, Livescu and Arzani (2024).  Units are CGS: cm, s, mL/s, dyn/cm².
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any

from pcnde_bridge._version import __version__

if TYPE_CHECKING:
    from pcnde_bridge.config import (
        FAST,
        PAPER,
        PHYSICS,
        PRESETS,
        PUBLISHED_CODE,
        ClosureConfig,
        PCNDEConfig,
    )
    from pcnde_bridge.data.cases import Cases, Split
    from pcnde_bridge.data.checks import UnitsWarning
    from pcnde_bridge.engines import select_engine
    from pcnde_bridge.errors import (
        DataNotFoundError,
        EngineError,
        EngineUnavailableError,
        FileError,
        InputError,
        MissingExtraError,
        PCNDEError,
        PCNDEWarning,
        SolveError,
        TaskError,
    )
    from pcnde_bridge.evaluation.cross_validation import cross_validate
    from pcnde_bridge.evaluation.sweep import sweep
    from pcnde_bridge.io.datasets import download_published, load_cases
    from pcnde_bridge.model.ensemble import Ensemble, load_model
    from pcnde_bridge.model.pcnde import PCNDE
    from pcnde_bridge.model.prediction import Prediction
    from pcnde_bridge.uncertainty.novelty import OutsideTrainingWarning

__all__ = [
    "FAST",
    "PAPER",
    "PCNDE",
    "PHYSICS",
    "PRESETS",
    "PUBLISHED_CODE",
    "Cases",
    "ClosureConfig",
    "DataNotFoundError",
    "EngineError",
    "EngineUnavailableError",
    "Ensemble",
    "FileError",
    "InputError",
    "MissingExtraError",
    "OutsideTrainingWarning",
    "PCNDEConfig",
    "PCNDEError",
    "PCNDEWarning",
    "Prediction",
    "SolveError",
    "Split",
    "TaskError",
    "UnitsWarning",
    "__version__",
    "cross_validate",
    "download_published",
    "load_cases",
    "load_model",
    "select_engine",
    "sweep",
]

_MODULES = {
    "config": ("FAST", "PAPER", "PHYSICS", "PRESETS", "PUBLISHED_CODE"),
    "config.settings": ("ClosureConfig", "PCNDEConfig"),
    "data.cases": ("Cases", "Split"),
    "data.checks": ("UnitsWarning",),
    "engines": ("select_engine",),
    "evaluation.cross_validation": ("cross_validate",),
    "evaluation.sweep": ("sweep",),
    "io.datasets": ("download_published", "load_cases"),
    "model.ensemble": ("Ensemble", "load_model"),
    "model.pcnde": ("PCNDE",),
    "model.prediction": ("Prediction",),
    "uncertainty.novelty": ("OutsideTrainingWarning",),
}
"""Modules of the public names; the others are errors."""

_HOMES = {name: module for module, names in _MODULES.items() for name in names}
_SUBPACKAGES = [m.name for m in iter_modules(__path__) if not m.name.startswith("_")]


def __getattr__(name: str) -> Any:
    """Import a public name or a subpackage on first use, so that the import is fast."""
    if name in _SUBPACKAGES:
        return import_module(f"pcnde_bridge.{name}")
    if name not in __all__:
        raise AttributeError(f"module 'pcnde_bridge' has no attribute {name!r}")
    module = import_module(f"pcnde_bridge.{_HOMES.get(name, 'errors')}")
    return globals().setdefault(name, getattr(module, name))


def __dir__() -> list[str]:
    return sorted({*__all__, *_SUBPACKAGES})
