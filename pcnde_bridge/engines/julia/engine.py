"""Julia engine: Tsit5, Lux and Optim.jl's BFGS, called through juliacall.

Julia starts when a :class:`JuliaEngine` is created, not when this module is imported.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.julia.closures import JuliaClosures
from pcnde_bridge.engines.julia.runtime import running
from pcnde_bridge.engines.julia.stage import JuliaStage
from pcnde_bridge.engines.parameters import STAGES, Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import ModelInputs, Objective, OnIterate, Solution


class JuliaEngine(Engine):
    """Engine that calls PCNDECore.

    The first one starts Julia, once per process.

    Raises
    ------
    EngineUnavailableError
        If Julia cannot be started; the message says what is missing.
    """

    name = "julia"

    def __init__(self) -> None:
        self._julia = running()
        self.versions = self._julia.versions
        self.closures = JuliaClosures(self._julia.call)
        for stage in (*STAGES, "temporal_flow"):
            setattr(self, stage, JuliaStage(self._julia, stage))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a name: Julia's functions cannot be pickled."""
        return julia_engine, ()

    def predict(self, parameters: Parameters, inputs: ModelInputs, config: PCNDEConfig) -> Solution:
        """See :class:`pcnde_bridge.engines.protocol.Engine`."""
        if config.flow.terms:
            return predict_by_stages(self, parameters, inputs, config)
        vectors, passes = tuple(dict(parameters).values()), config.coupling_passes
        return Solution(*self._julia.call("predict", vectors, *inputs, passes, config))

    def lbfgs(
        self, objective: Objective, start: Array, memory: int, iterations: int, accept: OnIterate
    ) -> None:
        """Run Optim's ``LBFGS``."""

        def evaluate(x: Any, result: Any) -> None:
            array = result.to_numpy(copy=False)
            array[0], array[1:] = objective(x.to_numpy())

        def after_iteration(x: Any, loss: float) -> None:
            accept(x.to_numpy(), float(loss))

        self._julia.call("lbfgs", evaluate, start, memory, iterations, after_iteration)


@cache
def julia_engine() -> JuliaEngine:
    """Return the process's Julia engine."""
    return JuliaEngine()
