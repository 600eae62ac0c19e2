"""One stage of the method in Julia: solution, loss, gradient and fit."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from pcnde_bridge._typing import Array
from pcnde_bridge._utils import interrupts
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.julia.runtime import Julia
from pcnde_bridge.engines.types import Fit, Objective, OnIteration, arrays_of

__all__ = ["JuliaStage"]

InputsT = TypeVar("InputsT")


class JuliaStage(Generic[InputsT]):
    """Julia implementation of :class:`pcnde_bridge.engines.protocol.Stage`."""

    def __init__(self, julia: Julia, name: str) -> None:
        self._julia = julia
        self._name = name

    def solve(self, parameters: Array, inputs: InputsT, grid: Grid, config: PCNDEConfig) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        where = grid.z, float(grid.period)
        result: Array = self._julia.call(
            "solve", self._name, parameters, arrays_of(inputs), *where, config
        )
        return result

    def loss_and_gradient(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> tuple[float, Array]:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        loss, gradient = self._compare(
            "loss_and_gradient", parameters, inputs, target, grid, config
        )
        return float(loss), gradient

    def losses(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        result: Array = self._compare("losses", parameters, inputs, target, grid, config)
        return result

    def objective(
        self, inputs: InputsT, target: Array, weight: Array, grid: Grid, config: PCNDEConfig
    ) -> Objective:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        chosen = weight > 0
        arrays = tuple(array[chosen] for array in arrays_of(inputs))
        data = arrays, target[chosen], weight[chosen], grid.z, float(grid.period), config
        identity = object()

        def evaluate(parameters: Array) -> tuple[float, Array]:
            # Julia stores the last problem itself: a reference in Python might be released by
            # another thread.
            if self._julia.problem is not identity:
                self._julia.problem = None
                self._julia.call("store_objective", self._name, *data)
                self._julia.problem = identity
            loss, gradient = self._julia.call("stored_loss_and_gradient", parameters)
            return float(loss), gradient

        return evaluate

    def fit(
        self,
        parameters: Array,
        inputs: InputsT,
        target: Array,
        grid: Grid,
        config: PCNDEConfig,
        iterations: int,
        on_iteration: OnIteration | None = None,
    ) -> Fit:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        with interrupts.watched() as raise_interrupt:

            def after_iteration(number: int, loss: float) -> None:
                # Called even without a callback: here Python notices a Ctrl-C.
                raise_interrupt()
                if on_iteration is not None:
                    on_iteration(int(number), float(loss))

            problem = parameters, inputs, target, grid, config
            fitted, losses, converged, message = self._compare(
                "fit", *problem, iterations, after_iteration
            )
        return Fit(fitted, losses, bool(converged), str(message))

    def _compare(
        self,
        function: str,
        parameters: Array,
        inputs: InputsT,
        target: Array,
        grid: Grid,
        config: PCNDEConfig,
        *more: Any,
    ) -> Any:
        """Call a function that compares the stage's result with a target."""
        data = arrays_of(inputs), target, grid.z, float(grid.period), config
        return self._julia.call(function, self._name, parameters, *data, *more)
