"""Julia engine: Tsit5, Lux and Optim.jl's BFGS, called through juliacall.

Julia starts when a :class:`JuliaEngine` is created, not when this module is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.julia.closures import JuliaClosures
from pcnde_bridge.engines.julia.runtime import running
from pcnde_bridge.engines.julia.stage import JuliaStage
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Closures, Stage
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import (
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    Objective,
    Solution,
    SpatialPressureInputs,
    TemporalFlowInputs,
    TemporalPressureInputs,
)

__all__ = ["JuliaEngine", "julia_engine"]


class JuliaEngine:
    """Julia implementation of :class:`pcnde_bridge.engines.protocol.Engine`.

    The first one starts Julia, once per process.

    Raises
    ------
    EngineUnavailableError
        If Julia cannot be started; the message says what is missing.
    """

    name = "julia"

    def __init__(self) -> None:
        self._julia = julia = running()
        self.versions: Mapping[str, str] = julia.versions
        self.closures: Closures = JuliaClosures(julia.call)
        self.flow: Stage[FlowInputs] = JuliaStage(julia, "flow")
        self.intermediate_area: Stage[IntermediateAreaInputs] = JuliaStage(
            julia, "intermediate_area"
        )
        self.fourier_area: Stage[FourierAreaInputs] = JuliaStage(julia, "fourier_area")
        self.temporal_pressure: Stage[TemporalPressureInputs] = JuliaStage(
            julia, "temporal_pressure"
        )
        self.spatial_pressure: Stage[SpatialPressureInputs] = JuliaStage(julia, "spatial_pressure")
        self.temporal_flow: Stage[TemporalFlowInputs] = JuliaStage(julia, "temporal_flow")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a name: Julia's functions cannot be pickled."""
        return julia_engine, ()

    def predict(
        self,
        parameters: Parameters,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        config: PCNDEConfig,
    ) -> Solution:
        """See :class:`pcnde_bridge.engines.protocol.Engine`."""
        if config.flow.terms:
            return predict_by_stages(self, parameters, inflow, area_undeformed, grid, config)
        vectors = tuple(vector for _, vector in parameters)
        cases = inflow, area_undeformed
        where = grid.z, float(grid.period)
        passes = config.coupling_passes
        return Solution(*self._julia.call("predict", vectors, *cases, *where, passes, config))

    def lbfgs(
        self,
        objective: Objective,
        start: Array,
        memory: int,
        iterations: int,
        on_iteration: Callable[[Array, float], None],
    ) -> None:
        """Run Optim's ``LBFGS``; see :class:`pcnde_bridge.engines.protocol.Engine`."""

        def evaluate(x: Any, result: Any) -> None:
            array = result.to_numpy(copy=False)
            array[0], array[1:] = objective(x.to_numpy())

        def after_iteration(x: Any, loss: float) -> None:
            on_iteration(x.to_numpy(), float(loss))

        self._julia.call("lbfgs", evaluate, start, memory, iterations, after_iteration)


@cache
def julia_engine() -> JuliaEngine:
    """Return the process's Julia engine."""
    return JuliaEngine()
