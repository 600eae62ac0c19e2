"""Named configurations, and how one is found by its name, its file or its settings."""

import types
from collections.abc import Mapping
from typing import Any

from pcnde_bridge.config.settings import ClosureConfig, Config, PCNDEConfig
from pcnde_bridge.config.validation import current_names
from pcnde_bridge.errors import InputError

PAPER = PCNDEConfig()
"""Settings of the paper's text."""

PUBLISHED_CODE = PAPER.replace(
    flow={"loss": "sum"},
    fourier_area={"frequency": "next", "sides": "one", "restart": True},
    temporal_pressure={"activation": "gelu"},
)
"""Settings of the authors' published code and weights, where they differ from the text."""

FAST = PAPER.replace(training="full_batch", flow={"steps": 12})
"""The paper's equations and parameters, trained on all cases together within seconds.

Twelve equal steps solve the momentum equation as accurately as the adaptive steps do."""

PHYSICS = ClosureConfig()
"""Physics-based closures, see :mod:`pcnde_bridge.engines.jax.closures`."""

PRESETS: Mapping[str, Config] = types.MappingProxyType(
    {"paper": PAPER, "published-code": PUBLISHED_CODE, "fast": FAST, "physics": PHYSICS}
)
"""The named configurations that ``--preset`` and ``PCNDE.fit(config=…)`` accept."""


def config_from(settings: Any) -> Config:
    """Return the configuration stored in a file, which may have been written by an older version.

    Parameters
    ----------
    settings : mapping
        Result of ``to_dict``; only a :class:`ClosureConfig` has a group ``outlet``.

    Raises
    ------
    InputError
        If a name is unknown or a value is not usable.
    """
    match settings := current_names(settings):
        case {"outlet": _}:
            return ClosureConfig.from_dict(settings)
        case {"training": "full_batch", "full_batch": {**group}}:
            # Before this setting was introduced, all cases had the same weight.
            settings = {**settings, "full_batch": {"amplitude_exponent": 0.0, **group}}
    return PCNDEConfig.from_dict(settings)


def resolve_config(config: Config | str) -> Config:
    """Return a configuration given as an object or by the name of its preset.

    Raises
    ------
    InputError
        If there is no preset of that name.
    """
    if isinstance(config, Config):
        return config
    if isinstance(config, str) and config in PRESETS:
        return PRESETS[config]
    advice = " Change a preset by FAST.replace(...)." if isinstance(config, Mapping) else ""
    raise InputError(f"Unknown preset {config!r}; the presets are {sorted(PRESETS)}.{advice}")


def resolve_pcnde_config(config: Config | str) -> PCNDEConfig:
    """Return a configuration of the paper's equations, given as an object or by its preset.

    Raises
    ------
    InputError
        If there is no preset of that name, or it has other equations.
    """
    found = resolve_config(config)
    if not isinstance(found, PCNDEConfig):
        raise InputError(
            "This study needs the paper's equations: give a PCNDEConfig or its preset ('paper', "
            "'published-code', 'fast'), not the preset 'physics'."
        )
    return found


def nearest_preset(config: Config) -> tuple[str, dict[str, Any]]:
    """Return the preset with the fewest settings that differ, and these settings.

    Examples
    --------
    >>> from pcnde_bridge.config import FAST, nearest_preset
    >>> nearest_preset(FAST.replace(flow={"steps": 24}))
    ('fast', {'flow.steps': 24})
    """
    mine = _flat(config)
    differences = {
        name: {key: value for key, value in mine.items() if theirs[key] != value}
        for name, preset in PRESETS.items()
        if type(preset) is type(config)
        for theirs in [_flat(preset)]
    }
    name = min(differences, key=lambda name: len(differences[name]))
    return name, differences[name]


def _flat(config: Config) -> dict[str, Any]:
    """Return the settings by names such as ``flow.epochs``."""
    found: dict[str, Any] = {}
    for name, value in config.to_dict().items():
        group = isinstance(value, dict)
        found |= {f"{name}.{k}": v for k, v in value.items()} if group else {name: value}
    return found
