"""Trained parameters of the closures.

========================  ============================================================
``outlet``                R₁, R₂ (dyn·s/cm⁵), C (cm⁵/dyn), p_d (dyn/cm²); without effect
                          where another outlet is given
``losses``                c_f, c_i, c_c, c_g, β, c_j, c_s, s, s_ν, λ: see
                          :mod:`pcnde_bridge.engines.jax.closures.pressure_losses`
``wall_shear_stress``     c₀ to c₈: see
                          :mod:`pcnde_bridge.engines.jax.closures.wall_shear_stress`
``wall``                  membrane: K (dyn/cm), ν, shear ratio, support (1/cm²), p₀;
                          tube law: K (dyn/cm²), exponent m, p₀ (dyn/cm²)
``correction``            κ, ceiling c, scale of ∂p/∂t (dyn/cm²/s), scale of Q (mL/s), then the
                          network, layer by layer: weights (in × out, row by row), bias
========================  ============================================================
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pcnde_bridge._typing import Array, ComplexArray
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.parameters import ParameterVectors, network_size
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.outlet import Outlet, windkessel_response

CLOSURES = ("outlet", "losses", "wall", "wall_shear_stress", "correction")
"""Names of the closures, in the order in which they are fitted."""

REFITTED = ("losses", "wall_shear_stress", "correction")
"""Closures that each member of the ensemble has of its own."""

CORRECTION_SCALARS = 4
"""Count of numbers before the network's weights: κ, the ceiling and two scales."""

WALL_SHEAR_STRESS = np.array([0.64, 0.066, 0.11, 0.19, 0.35, 0.098, 0.65, 1.39, 0.73])
"""Parameters of the wall shear stress without measured values: those of the 81 training cases of
the paper's split of the published data."""


def sizes(config: ClosureConfig) -> dict[str, int]:
    """Return the length of every closure's vector.

    Raises
    ------
    InputError
        If the law is still 'auto'.
    """
    if config.wall.law == "auto":
        raise InputError("wall.law is 'auto': use the configuration of a fitted model.")
    widths = (2, *config.correction.hidden, 1)
    return {
        "outlet": 4,
        "losses": 10,
        "wall": 5 if config.wall.law == "membrane" else 3,
        "wall_shear_stress": WALL_SHEAR_STRESS.size,
        "correction": CORRECTION_SCALARS + network_size(widths),
    }


@dataclass(frozen=True, eq=False, repr=False)
class ClosureParameters(ParameterVectors):
    """All parameters of the ``physics`` preset, one flat read-only vector per closure.

    Attributes
    ----------
    outlet, losses, wall, correction, wall_shear_stress : arrays
        Read-only vectors; this module's docstring describes their layout.
    """

    outlet: Array
    losses: Array
    wall: Array
    correction: Array
    wall_shear_stress: Array = field(default_factory=lambda: WALL_SHEAR_STRESS)

    @property
    def refitted(self) -> Array:
        """The closures that a member of the ensemble has of its own, one after the other."""
        return np.concatenate([getattr(self, name) for name in REFITTED])

    def with_member(self, refitted: Array) -> ClosureParameters:
        """Return the parameters with another member's :attr:`refitted`."""
        ends = np.cumsum([getattr(self, name).size for name in REFITTED])[:-1]
        return self.replace(**dict(zip(REFITTED, np.split(refitted, ends), strict=True)))

    @property
    def has_pressure(self) -> bool:
        """Whether the model predicts the pressure: always."""
        return True

    def outlet_response(self, grid: Grid) -> ComplexArray:
        """Return the response of the trained outlet, (1, 2, harmonic)."""
        return np.asarray(windkessel_response(self.outlet, grid.time.size, grid.period))[None]

    def respond(self, outlet: Outlet, inputs: ModelInputs, config: ClosureConfig) -> ComplexArray:
        """Return the response of an outlet of these cases, (case, 2, harmonic).

        A reflection refers to the wall at the vessel's end; a membrane is not clamped there.

        Raises
        ------
        InputError
            If the outlet is not usable.
        """
        first, last = (np.sqrt(inputs.area_undeformed[:, end] / np.pi) for end in (0, -1))
        if config.wall.law == "membrane":
            softness = last / self.wall[0]
        else:
            softness = (last / first) ** self.wall[1] / self.wall[0]
        # ρ·c/S = √(ρ/(S·dS/dp)) with dS/dp = 2·S·softness.
        impedance = np.sqrt(config.physics.density / (2.0 * softness)) / (np.pi * last**2)
        return outlet.response(len(last), inputs.grid.time, inputs.grid.period, impedance)

    def check(self, config: ClosureConfig) -> None:
        """Raise if a vector does not fit the configuration, or is not finite.

        Raises
        ------
        InputError
            With the closure, and the actual and the necessary length.
        """
        self.check_sizes(sizes(config), "this configuration")
