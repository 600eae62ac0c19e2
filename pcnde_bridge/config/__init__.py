"""Every number of the method in one place: immutable, validated and serializable.

:data:`PAPER`, the default, follows the text of Csala, Mohan, Livescu and Arzani (2024);
:data:`PRESETS` lists the other named configurations.  Units are CGS.
"""

from pcnde_bridge.config.presets import (
    FAST,
    PAPER,
    PHYSICS,
    PRESETS,
    PUBLISHED_CODE,
    config_from,
    resolve_config,
    resolve_pcnde_config,
)
from pcnde_bridge.config.settings import (
    BFGS,
    Activation,
    ClosureConfig,
    Config,
    CorrectionClosure,
    FlowStage,
    FourierAreaStage,
    FullBatch,
    PCNDEConfig,
    Physics,
    Term,
    WallClosure,
)

__all__ = [
    "BFGS",
    "FAST",
    "PAPER",
    "PHYSICS",
    "PRESETS",
    "PUBLISHED_CODE",
    "Activation",
    "ClosureConfig",
    "Config",
    "CorrectionClosure",
    "FlowStage",
    "FourierAreaStage",
    "FullBatch",
    "PCNDEConfig",
    "Physics",
    "Term",
    "WallClosure",
    "config_from",
    "resolve_config",
    "resolve_pcnde_config",
]
