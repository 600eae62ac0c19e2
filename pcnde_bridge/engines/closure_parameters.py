"""The learnable numbers of the closures.

========================  ============================================================
``outlet``                R₁, R₂ (dyn·s/cm⁵), C (cm⁵/dyn), p_d (dyn/cm²)
``losses``                c_f, c_i, c_m, jet spread
``wall``                  membrane: K (dyn/cm), ν, shear ratio, support (1/cm²), p₀;
                          tube law: K (dyn/cm²), exponent m, p₀ (dyn/cm²)
``correction``            κ, ceiling c, scale of ∂p/∂t (dyn/cm²/s), scale of Q (mL/s), then the
                          network, layer by layer: weights (in × out, row by row), bias
========================  ============================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.engines.parameters import network_size
from pcnde_bridge.errors import InputError

CLOSURES = ("outlet", "losses", "wall", "correction")
"""Names of the closures, in the order in which they are fitted."""

CORRECTION_SCALARS = 4
"""Numbers before the network's weights: κ, the ceiling and two scales."""


def sizes(config: ClosureConfig) -> dict[str, int]:
    """Length of every closure's vector; the wall's law must be decided.

    Raises
    ------
    InputError
        If the law is still 'auto'.
    """
    if config.wall.law == "auto":
        raise InputError("wall.law is 'auto': a fitted model's configuration says which it took.")
    widths = (2, *config.correction.hidden, 1)
    return {
        "outlet": 4,
        "losses": 4,
        "wall": 5 if config.wall.law == "membrane" else 3,
        "correction": CORRECTION_SCALARS + network_size(widths),
    }


@dataclass(frozen=True, eq=False)
class ClosureParameters:
    """One flat vector for each closure, laid out as this module's text says.

    Attributes
    ----------
    outlet, losses, wall, correction : arrays
        Read-only vectors.
    """

    outlet: Array
    losses: Array
    wall: Array
    correction: Array

    def __post_init__(self) -> None:
        for f in fields(self):
            vector = np.array(getattr(self, f.name), dtype=np.float64)
            vector.flags.writeable = False
            object.__setattr__(self, f.name, vector)

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        return ((name, getattr(self, name)) for name in CLOSURES)

    def replace(self, **vectors: Array) -> ClosureParameters:
        """Copy with some closures' vectors changed."""
        return ClosureParameters(**{**dict(self), **vectors})

    def check(self, config: ClosureConfig) -> None:
        """Raise if a vector's length does not fit the configuration.

        Raises
        ------
        InputError
            Naming the closure, the shape found and the length needed.
        """
        for name, needed in sizes(config).items():
            found = getattr(self, name)
            if found.shape != (needed,) or not np.isfinite(found).all():
                raise InputError(
                    f"The {name} parameters must be {needed} finite numbers for this "
                    f"configuration, got shape {found.shape}."
                )
