"""The two kinds of model: ``staged`` (the paper's networks) and ``closures`` (preset ``physics``).

:class:`~pcnde_bridge.PCNDE` is one class for both; this module contains all their differences.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import check_finite, check_increasing, check_shape, positive
from pcnde_bridge.config import ClosureConfig, Config, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid, check_grid, check_resolution
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import Solution
from pcnde_bridge.model.inputs import Inputs
from pcnde_bridge.training.closure_training import ClosureTraining
from pcnde_bridge.training.procedure import Procedure
from pcnde_bridge.training.trainer import staged_training
from pcnde_bridge.uncertainty.sampling import Uncertainty, sample

AnyParameters = Parameters | ClosureParameters


class Kind(ABC):
    """Interface of a kind of model; its methods expect configuration and parameters of the kind.

    Attributes
    ----------
    any_grid : bool
        Whether predictions may be on another grid than that of the training cases.
    """

    any_grid: ClassVar[bool]
    _parameters: ClassVar[type[AnyParameters]]

    @abstractmethod
    def procedure(self, cases: Cases, config: Any, engine: Engine) -> Procedure[Any]:
        """Return the training procedure for cases and settings."""

    @abstractmethod
    def predict(
        self,
        engine: Engine,
        config: Any,
        parameters: Any,
        inputs: Inputs,
        uncertainty: Uncertainty | None = None,
    ) -> tuple[Solution, dict[str, Array] | None]:
        """Predict flow, area and pressure.

        Returns
        -------
        Solution
            Arrays of shape (case, time, z).
        dict of arrays of shape (sample, case, time, z), or None
            Samples by variable, if the inputs have random numbers.
        """

    @abstractmethod
    def check_grid(self, trained: Grid, other: Grid, where: str = "model.grid") -> None:
        """Raise InputError unless a model trained on one grid predicts on the other one.

        ``where`` names the holder of the training grid in the message.
        """

    def read_parameters(self, arrays: Mapping[str, Array]) -> AnyParameters:
        """Read the parameters from the arrays of a model file; raise KeyError if one is missing."""
        return self._parameters(**{f.name: arrays[f.name] for f in fields(self._parameters)})

    def check(
        self, config: Config, parameters: Any, grid: Grid, uncertainty: Uncertainty | None
    ) -> None:
        """Raise if the parts of a model do not fit together.

        Raises
        ------
        InputError
            If a vector or the grid is not usable; the message names it.
        TypeError
            If the parameters belong to the other kind of model.
        """
        for name, axis in (("time", grid.time), ("z", grid.z)):
            check_shape(name, axis, (axis.size,))
            check_finite(name, axis)
            check_increasing(name, axis)
        positive("period", grid.period, "s")
        if not isinstance(parameters, self._parameters):
            raise TypeError(f"{type(parameters).__name__} do not go with {type(config).__name__}")
        self._check_vectors(config, parameters, grid, uncertainty)

    @abstractmethod
    def _check_vectors(
        self, config: Any, parameters: Any, grid: Grid, uncertainty: Uncertainty | None
    ) -> None: ...


class _Staged(Kind):
    any_grid = False
    _parameters = Parameters

    def procedure(self, cases: Cases, config: PCNDEConfig, engine: Engine) -> Procedure[Any]:
        return staged_training(cases, config, engine)

    def predict(
        self, engine: Engine, config: Any, parameters: Any, inputs: Inputs, *_: Any
    ) -> tuple[Solution, None]:
        arrays = inputs.inflow, inputs.area_undeformed, inputs.grid
        return engine.predict(parameters, *arrays, config), None

    def check_grid(self, trained: Grid, other: Grid, where: str = "model.grid") -> None:
        check_grid(trained, other, where)

    def _check_vectors(self, config: Any, parameters: Parameters, grid: Grid, _: Any) -> None:
        parameters.check(config, grid.time.size, grid.z.size)


class _Closures(Kind):
    any_grid = True
    _parameters = ClosureParameters

    def procedure(self, cases: Cases, config: ClosureConfig, engine: Engine) -> Procedure[Any]:
        return ClosureTraining(cases, config, engine)

    def predict(
        self,
        engine: Engine,
        config: Any,
        parameters: Any,
        inputs: Inputs,
        uncertainty: Uncertainty | None = None,
    ) -> tuple[Solution, dict[str, Array] | None]:
        arrays = inputs.inflow, inputs.area_undeformed, inputs.grid, config
        mean = engine.closures.predict(parameters, np.zeros(len(inputs)), *arrays)
        if uncertainty is None or inputs.random is None:
            return mean, None
        model = engine.closures, parameters, uncertainty, mean
        return mean, sample(*model, *arrays, inputs.random)

    def check_grid(self, trained: Grid, other: Grid, where: str = "model.grid") -> None:
        check_resolution(other.time.size, other.z.size)

    def _check_vectors(
        self, config: Any, parameters: Any, grid: Grid, uncertainty: Uncertainty | None
    ) -> None:
        parameters.check(config)
        if uncertainty is not None:
            uncertainty.check(parameters.correction.size)


_STAGED, _CLOSURES = _Staged(), _Closures()


def kind_of(config: Config) -> Kind:
    """Return the kind of model that a configuration describes."""
    return _CLOSURES if isinstance(config, ClosureConfig) else _STAGED


def solve(engine: Engine, config: Config, parameters: AnyParameters, inputs: Inputs) -> Solution:
    """Predict flow, area and pressure with a model of either kind."""
    return kind_of(config).predict(engine, config, parameters, inputs)[0]
