"""Every number of the method in one place: immutable, validated and serializable.

:data:`PAPER`, the default, follows the text of Csala, Mohan, Livescu and Arzani (2024).  The
named configurations are in :mod:`pcnde_bridge.config.presets`, the groups of settings in
:mod:`pcnde_bridge.config.settings`.  Units are CGS.
"""

from pcnde_bridge.config.presets import (
    FAST,
    PAPER,
    PHYSICS,
    PRESETS,
    PUBLISHED_CODE,
    config_from,
    nearest_preset,
    resolve_config,
    resolve_pcnde_config,
)
from pcnde_bridge.config.settings import ClosureConfig, Config, PCNDEConfig

__all__ = [
    "FAST",
    "PAPER",
    "PHYSICS",
    "PRESETS",
    "PUBLISHED_CODE",
    "ClosureConfig",
    "Config",
    "PCNDEConfig",
    "config_from",
    "nearest_preset",
    "resolve_config",
    "resolve_pcnde_config",
]
