"""One stage of the method in Julia: solution, loss, gradient and fit."""

from pcnde_bridge._typing import Array
from pcnde_bridge._utils import interrupts
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.julia.runtime import Julia
from pcnde_bridge.engines.protocol import Stage
from pcnde_bridge.engines.types import Fit, FitData, Objective, OnIteration, StageInputs, ignore


class JuliaStage(Stage):
    """Stage that calls PCNDECore's functions with the stage's name."""

    def __init__(self, julia: Julia, name: str) -> None:
        self._julia = julia
        self._name = name

    def solve(self, vector: Array, inputs: StageInputs, grid: Grid, config: PCNDEConfig) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        return self._julia.call("solve", self._name, vector, inputs, grid, config)

    def losses(self, vectors: Array, data: FitData) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        return self._julia.call("losses", self._name, vectors, *data)

    def objective(self, data: FitData, weight: Array) -> Objective:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        chosen = weight > 0
        inputs = tuple(array[chosen] for array in data.inputs)
        arrays = inputs, data.target[chosen], weight[chosen]
        identity = object()

        def evaluate(parameters: Array) -> tuple[float, Array]:
            # Julia stores the last problem itself: a reference in Python might be released by
            # another thread.
            if self._julia.problem is not identity:
                self._julia.problem = None
                self._julia.call("store_objective", self._name, *arrays, data.grid, data.config)
                self._julia.problem = identity
            loss, gradient = self._julia.call("stored_loss_and_gradient", parameters)
            return float(loss), gradient

        return evaluate

    def fit(
        self, start: Array, data: FitData, iterations: int, on_iteration: OnIteration = ignore
    ) -> Fit:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        with interrupts.watched() as raise_interrupt:

            def after_iteration(number: int, loss: float) -> None:
                # Called even without a callback: here Python notices a Ctrl-C.
                raise_interrupt()
                on_iteration(int(number), float(loss))

            problem = self._name, start, *data, iterations
            fitted, losses, converged, message = self._julia.call("fit", *problem, after_iteration)
        return Fit(fitted, losses, bool(converged), str(message))
