"""Physical and numerical settings of the 1D solver."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from pcnde_bridge._utils.validation import check_fields, finite, positive, whole
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.tube_laws import LinearWall, Wall

StenosisLoss = Literal["none", "paper", "effective_length"]


@dataclass(frozen=True)
class TubeSettings:
    """Checked settings of the 1D solver.

    The attributes are those of :class:`~pcnde_bridge.hemodynamics.solver.Tube1D`.

    Raises
    ------
    InputError
        If a setting is not usable.
    """

    wall: Wall = field(default_factory=LinearWall)
    stenosis_loss: StenosisLoss = "paper"
    turbulent_coefficient: float = 1.52
    density: float = 1.06
    viscosity: float = 0.04
    profile_exponent: float = 2.0
    momentum_correction: float | None = None
    n_times: int = 100
    steps: int = 500
    cycles: int = 3
    tolerance: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.wall, Wall):
            raise InputError(f"Tube1D.wall must be a wall law, got {self.wall!r}.")
        if self.stenosis_loss not in get_args(StenosisLoss):
            known = ", ".join(map(repr, get_args(StenosisLoss)))
            raise InputError(f"stenosis_loss must be one of {known}, got {self.stenosis_loss!r}.")
        check_fields(self, positive, density="g/cm³", profile_exponent="")
        check_fields(self, finite, viscosity="poise", turbulent_coefficient="")
        for name in ("viscosity", "turbulent_coefficient"):
            if (value := getattr(self, name)) < 0.0:
                raise InputError(f"Tube1D.{name} must not be negative, got {value!r}.")
        for name in ("momentum_correction", "tolerance"):
            if getattr(self, name) is not None:
                check_fields(self, positive, **{name: ""})
        check_fields(self, whole, n_times=4, steps=1, cycles=1)
        if self.steps % self.n_times:
            raise InputError(
                f"Tube1D.steps = {self.steps} is not a multiple of n_times = {self.n_times}, "
                "so that the recorded time points would fall between steps."
            )

    @property
    def convection(self) -> float:
        """Momentum correction α; by default that of the profile, (ζ + 2)/(ζ + 1)."""
        profile = 1.0 + 1.0 / (1.0 + self.profile_exponent)
        return profile if self.momentum_correction is None else self.momentum_correction
