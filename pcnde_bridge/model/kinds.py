"""The two kinds of model: ``staged`` (the paper's networks) and ``closures`` (preset ``physics``).

:class:`~pcnde_bridge.PCNDE` is one class for both; this module contains all their differences.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import check_finite, check_increasing, check_shape, positive
from pcnde_bridge.config import ClosureConfig, Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid, check_grid, check_resolution
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import ModelInputs, Solution
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.hemodynamics.outlet import check_outlet
from pcnde_bridge.model.inputs import Inputs
from pcnde_bridge.training.closure_training import ClosureTraining
from pcnde_bridge.training.procedure import Procedure
from pcnde_bridge.training.trainer import staged_training
from pcnde_bridge.uncertainty.sampling import SampledModel, Uncertainty, sample

AnyParameters = Parameters | ClosureParameters
Samples = dict[str, Array]
"""Samples by variable, each of shape (sample, case, time, z)."""


@dataclass(frozen=True)
class Kind:
    """Kind of model.

    Attributes
    ----------
    any_grid : bool
        Whether predictions may be on another grid than that of the training cases.
    parameters : type
        Class of the trained parameters.
    procedure : callable
        Returns the training procedure for cases, settings and an engine.
    predict : callable
        Takes engine, settings, parameters, inputs and uncertainty; returns the solution, and
        samples if the inputs have random numbers.
    """

    any_grid: bool
    parameters: type[Any]
    procedure: Callable[[Cases, Any, Engine], Procedure[Any]]
    predict: Callable[..., tuple[Solution, Samples | None]]

    def check_grid(self, trained: Grid, other: Grid, where: str = "model.grid") -> None:
        """Raise InputError unless a model trained on one grid predicts on the other one.

        ``where`` names the holder of the training grid in the message.
        """
        if self.any_grid:
            check_resolution(other.time.size, other.z.size)
        else:
            check_grid(trained, other, where)

    def check_outlet(self, outlet: object) -> None:
        """Raise InputError unless the argument is an outlet and models of the kind take one."""
        check_outlet(outlet)
        if self.parameters is not ClosureParameters:
            raise InputError(
                "The networks of this model learn the outlet: only the preset 'physics' takes one."
            )

    def check(
        self, config: Config, parameters: Any, grid: Grid, uncertainty: Uncertainty | None
    ) -> None:
        """Raise if the parts of a model do not fit together.

        Raises
        ------
        InputError
            If a vector or the grid is not usable, or the parameters belong to another kind.
        """
        for name, axis in (("time", grid.time), ("z", grid.z)):
            check_shape(name, axis, (axis.size,))
            check_finite(name, axis)
            check_increasing(name, axis)
        positive("period", grid.period, "s")
        if not isinstance(parameters, self.parameters):
            wrong = f"{type(parameters).__name__} do not belong to {type(config).__name__}"
            raise InputError(f"{wrong}: give {self.parameters.__name__}.")
        # The parameters of the closures do not depend on the grid.
        parameters.check(config, *(() if self.any_grid else (grid.time.size, grid.z.size)))
        if uncertainty is not None:
            uncertainty.check(parameters.refitted.size)


def _predict_staged(
    engine: Engine, config: Any, parameters: Any, inputs: Inputs, _: Uncertainty | None = None
) -> tuple[Solution, None]:
    given = ModelInputs(inputs.inflow, inputs.area_undeformed, inputs.grid)
    solution = engine.predict(parameters, given, config)
    for name, values in solution._asdict().items():
        if values is None:
            continue
        with np.errstate(all="ignore"):
            finite = np.isfinite(values.sum(axis=(1, 2)))  # faster than all values by themselves
        if not finite.all():
            raise SolveError(
                f"The predicted {name} of case {np.argmin(finite)} is not finite "
                f"({np.count_nonzero(~finite)} of {len(finite)} cases). Check the units of inflow "
                "and area (mL/s, cm²); the model may not extrapolate so far.",
                np.flatnonzero(~finite),
            )
    return solution, None


def _predict_closures(
    engine: Engine, config: Any, parameters: Any, inputs: Inputs, spread: Uncertainty | None = None
) -> tuple[Solution, Samples | None]:
    given, outlet = ModelInputs(inputs.inflow, inputs.area_undeformed, inputs.grid), inputs.outlet
    mean = engine.closures.predict(parameters, np.zeros(len(inputs)), given, config, outlet)
    if spread is None or inputs.random is None:
        return mean, None
    model = SampledModel(engine.closures, parameters, config)
    return mean, sample(model, spread, mean, given, inputs.random, outlet)


_STAGED = Kind(False, Parameters, staged_training, _predict_staged)
_CLOSURES = Kind(True, ClosureParameters, ClosureTraining, _predict_closures)


def kind_of(config: Config) -> Kind:
    """Return the kind of model that a configuration describes."""
    return _CLOSURES if isinstance(config, ClosureConfig) else _STAGED
