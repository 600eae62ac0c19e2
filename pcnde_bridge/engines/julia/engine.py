"""The Julia engine: Tsit5, Lux and Optim.jl's BFGS over juliacall.

Julia starts when a :class:`JuliaEngine` is made, not when this module is imported.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.julia.closures import JuliaClosures
from pcnde_bridge.engines.julia.project import julia_sources
from pcnde_bridge.engines.julia.runtime import running
from pcnde_bridge.engines.julia.stage import JuliaStage
from pcnde_bridge.engines.julia.status import (
    JuliaStatus,
    julia_settings_file,
    julia_status,
)
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import (
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    Objective,
    OnAccepted,
    Solution,
    SpatialPressureInputs,
    TemporalFlowInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.engines.staged import predict_by_stages

__all__ = ["JuliaEngine", "JuliaStatus", "julia_settings_file", "julia_sources", "julia_status"]


class JuliaEngine:
    """The five stages in Julia; see :class:`pcnde_bridge.engines.protocol.Engine`.

    Making one starts Julia, once per process.

    Raises
    ------
    EngineUnavailableError
        If Julia cannot be started; the message says what is missing.
    """

    name = "julia"

    def __init__(self) -> None:
        self._julia = running()
        self.closures = JuliaClosures(self._julia.call)
        self.flow: JuliaStage[FlowInputs] = JuliaStage(self._julia, "flow")
        self.intermediate_area: JuliaStage[IntermediateAreaInputs] = JuliaStage(
            self._julia, "intermediate_area"
        )
        self.fourier_area: JuliaStage[FourierAreaInputs] = JuliaStage(self._julia, "fourier_area")
        self.temporal_pressure: JuliaStage[TemporalPressureInputs] = JuliaStage(
            self._julia, "temporal_pressure"
        )
        self.spatial_pressure: JuliaStage[SpatialPressureInputs] = JuliaStage(
            self._julia, "spatial_pressure"
        )
        self.temporal_flow: JuliaStage[TemporalFlowInputs] = JuliaStage(
            self._julia, "temporal_flow"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to another process as a name: Julia's functions cannot."""
        return select_engine, (self.name,)

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
        flow, area, pressure = self._julia.call(
            "predict",
            tuple(vector for _, vector in parameters),
            inflow,
            area_undeformed,
            grid.z,
            float(grid.period),
            config.coupling_passes,
            config,
        )
        return Solution(flow, area, pressure)

    def lbfgs(
        self, objective: Objective, start: Array, memory: int, iterations: int, after: OnAccepted
    ) -> None:
        """Optim's ``LBFGS``; see :class:`pcnde_bridge.engines.protocol.Engine`."""

        def evaluate(x: Any, found: Any) -> None:
            room = found.to_numpy(copy=False)
            room[0], room[1:] = objective(x.to_numpy())

        def accepted(x: Any, loss: float) -> None:
            after(x.to_numpy(), float(loss))

        with contextlib.suppress(StopIteration):
            self._julia.call("lbfgs", evaluate, start, memory, iterations, accepted)

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of Julia and the packages that compute."""
        return self._julia.versions()
