"""Fast, accurate one-dimensional blood-flow models that learn from 3D simulation.

Physics-constrained coupled neural differential equations (PCNDE) after Csala,
Mohan, Livescu and Arzani (2024).  Units are CGS: cm, s, mL/s, dyn/cm².
"""

from pcnde_bridge._version import __version__
from pcnde_bridge.case_checks import UnitsWarning
from pcnde_bridge.cases import Cases, Split
from pcnde_bridge.config import (
    FAST,
    PAPER,
    PHYSICS,
    PRESETS,
    PUBLISHED_CODE,
    ClosureConfig,
    PCNDEConfig,
)
from pcnde_bridge.cross_validation import cross_validate
from pcnde_bridge.datasets import download_published, load_cases
from pcnde_bridge.engines import select_engine
from pcnde_bridge.ensemble import Ensemble, load_model
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
from pcnde_bridge.model import PCNDE
from pcnde_bridge.novelty import OutsideTrainingWarning
from pcnde_bridge.prediction import Prediction
from pcnde_bridge.sweeps import sweep

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
