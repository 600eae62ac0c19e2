"""Julia engine: Tsit5, Lux and Optim.jl's BFGS, called through juliacall.

Julia starts when a :class:`JuliaEngine` is created, not when this module is imported.
"""

from functools import cache
from typing import Any

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.julia.closures import JuliaClosures
from pcnde_bridge.engines.julia.runtime import running
from pcnde_bridge.engines.julia.stage import JuliaStage
from pcnde_bridge.engines.parameters import STAGES, Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import ModelInputs, Solution


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


class ReferenceEngine(JuliaEngine):
    """Engine whose flow stage the Julia libraries compute alone: the standard of the others.

    Lux evaluates the network, Tsit5 steps with its own controller, ForwardDiff differentiates
    the loss, and Optim's BFGS with a dense matrix minimizes it (``reference.jl``).  It has no
    physics terms, and a fit takes hundreds of times longer.  The other stages are those of
    :class:`JuliaEngine`.
    """

    name = "julia-reference"

    def __init__(self) -> None:
        super().__init__()
        self.flow = JuliaStage(self._julia, "reference_flow")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a name, as :class:`JuliaEngine` does."""
        return reference_engine, ()

    def predict(self, parameters: Parameters, inputs: ModelInputs, config: PCNDEConfig) -> Solution:
        """See :class:`pcnde_bridge.engines.protocol.Engine`."""
        return predict_by_stages(self, parameters, inputs, config)


@cache
def julia_engine() -> JuliaEngine:
    """Return the process's Julia engine."""
    return JuliaEngine()


@cache
def reference_engine() -> ReferenceEngine:
    """Return the process's reference engine."""
    return ReferenceEngine()
