"""One stage in Julia: solved, compared with a target, fitted."""

from __future__ import annotations

import dataclasses
from dataclasses import fields
from typing import Any, Generic, TypeVar

from pcnde_bridge._typing import Array
from pcnde_bridge._utils import interrupts
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.julia.runtime import Julia
from pcnde_bridge.engines.protocol import (
    Fit,
    Objective,
    OnIteration,
)

__all__ = ["JuliaStage"]

InputsT = TypeVar("InputsT")


class JuliaStage(Generic[InputsT]):
    """One stage; see :class:`pcnde_bridge.engines.protocol.Stage`."""

    def __init__(self, julia: Julia, name: str) -> None:
        self._julia = julia
        self._name = name

    def solve(self, parameters: Array, inputs: InputsT, grid: Grid, config: PCNDEConfig) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        result: Array = self._julia.call(
            "solve", self._name, parameters, _arrays(inputs), grid.z, float(grid.period), config
        )
        return result

    def loss_and_gradient(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> tuple[float, Array]:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        args = parameters, inputs, target, grid, config
        loss, gradient = self._compare("loss_and_gradient", *args)
        return float(loss), gradient

    def losses(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        result: Array = self._compare("losses", parameters, inputs, target, grid, config)
        return result

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
        """Call what compares the stage's result with a target."""
        where = grid.z, float(grid.period)
        arrays = _arrays(inputs)
        return self._julia.call(
            function, self._name, parameters, arrays, target, *where, config, *more
        )

    def objective(
        self, inputs: InputsT, target: Array, weight: Array, grid: Grid, config: PCNDEConfig
    ) -> Objective:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        chosen = weight > 0
        chosen_inputs = dataclasses.replace(
            inputs,  # type: ignore[type-var]
            **{f.name: getattr(inputs, f.name)[chosen] for f in fields(inputs)},  # type: ignore[arg-type]
        )
        given = _arrays(chosen_inputs), target[chosen], weight[chosen]
        ours = object()

        def evaluate(parameters: Array) -> tuple[float, Array]:
            # Julia keeps the last problem itself: Python's hold on one might be let go by
            # another thread.
            if self._julia.held is not ours:
                self._julia.held = None
                period = float(grid.period)
                self._julia.call("hold", self._name, *given, grid.z, period, config)
                self._julia.held = ours
            loss, gradient = self._julia.call("held_loss_and_gradient", parameters)
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
        with interrupts.kept() as look:

            def after_iteration(number: int, loss: float) -> None:
                # Called even if nobody listens: here Python notices a Ctrl-C.
                look()
                if on_iteration is not None:
                    on_iteration(int(number), float(loss))

            args = parameters, inputs, target, grid, config
            fitted, losses, converged, message = self._compare(
                "fit", *args, iterations, after_iteration
            )
        return Fit(fitted, losses, bool(converged), str(message))


def _arrays(inputs: Any) -> tuple[Array, ...]:
    return tuple(getattr(inputs, f.name) for f in fields(inputs))
