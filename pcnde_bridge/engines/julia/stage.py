"""One stage of the method in Julia: solution, loss, gradient and fit."""

from __future__ import annotations

from pcnde_bridge._typing import Array
from pcnde_bridge._utils import interrupts
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.julia.runtime import Julia
from pcnde_bridge.engines.protocol import Stage
from pcnde_bridge.engines.types import Fit, Objective, OnIteration, StageInputs


class JuliaStage(Stage):
    """Stage that calls PCNDECore's functions with the stage's name."""

    def __init__(self, julia: Julia, name: str) -> None:
        self._julia = julia
        self._name = name

    def solve(
        self, parameters: Array, inputs: StageInputs, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        result: Array = self._julia.call("solve", self._name, parameters, inputs, grid, config)
        return result

    def losses(
        self, parameters: Array, inputs: StageInputs, target: Array, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        problem = self._name, parameters, inputs, target, grid, config
        result: Array = self._julia.call("losses", *problem)
        return result

    def objective(
        self, inputs: StageInputs, target: Array, weight: Array, grid: Grid, config: PCNDEConfig
    ) -> Objective:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        chosen = weight > 0
        arrays = tuple(array[chosen] for array in inputs)
        data = self._name, arrays, target[chosen], weight[chosen], grid, config
        identity = object()

        def evaluate(parameters: Array) -> tuple[float, Array]:
            # Julia stores the last problem itself: a reference in Python might be released by
            # another thread.
            if self._julia.problem is not identity:
                self._julia.problem = None
                self._julia.call("store_objective", *data)
                self._julia.problem = identity
            loss, gradient = self._julia.call("stored_loss_and_gradient", parameters)
            return float(loss), gradient

        return evaluate

    def fit(
        self,
        parameters: Array,
        inputs: StageInputs,
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

            problem = self._name, parameters, inputs, target, grid, config
            found = self._julia.call("fit", *problem, iterations, after_iteration)
        fitted, losses, converged, message = found
        return Fit(fitted, losses, bool(converged), str(message))
