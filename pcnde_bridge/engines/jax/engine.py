"""JAX engine: runs wherever Python does, without further installation."""

from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import version
from typing import Any

import jax

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax import area, flow, physics_terms, pressure, temporal_flow
from pcnde_bridge.engines.jax.closures.engine import JaxClosures
from pcnde_bridge.engines.jax.fused_predict import predict
from pcnde_bridge.engines.jax.stage import (
    GridArrays,
    Inputs,
    JaxStage,
    Model,
    in_batches,
    on_device,
)
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import ModelInputs, Solution


def _flow(
    parameters: jax.Array, inputs: Inputs, weight: jax.Array, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    solve = physics_terms.solve if config.flow.terms else flow.solve
    return solve(parameters, inputs, weight, grid, config)


def _unweighted(formula: Callable[..., jax.Array]) -> Model:
    """Return the model of an equation whose cases do not influence each other."""
    return lambda parameters, inputs, _, *settings: formula(parameters, inputs, *settings)


class JaxEngine(Engine):
    """Engine that computes in this process, with JAX and diffrax."""

    name = "jax"

    def __init__(self) -> None:
        self.versions = {name: version(name) for name in ("jax", "jaxlib", "diffrax")}
        self.closures = JaxClosures()
        self.flow = JaxStage(
            _flow,
            ("flow", "physics"),
            integrates=True,
            loss_scale=lambda config, count: count if config.flow.loss == "mean" else 1.0,
            case_by_case=lambda config: config.flow.steps is None,
        )
        self.intermediate_area = JaxStage(_unweighted(area.intermediate), ("intermediate_area",))
        self.fourier_area = JaxStage(_unweighted(area.fourier), ("fourier_area",))
        pressure_settings = ("temporal_pressure", "spatial_pressure", "physics")
        self.temporal_pressure = JaxStage(_unweighted(pressure.temporal), pressure_settings)
        self.spatial_pressure = JaxStage(_unweighted(pressure.spatial), pressure_settings)
        self.temporal_flow = JaxStage(
            _unweighted(temporal_flow.solve), ("temporal_flow",), integrates=True
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a name: compiled functions cannot be pickled."""
        return jax_engine, ()

    def predict(self, parameters: Parameters, inputs: ModelInputs, config: PCNDEConfig) -> Solution:
        """See :class:`pcnde_bridge.engines.protocol.Engine`."""
        if config.flow.terms:
            return predict_by_stages(self, parameters, inputs, config)
        *arrays, grid = inputs
        with double_precision():
            vectors = jax.device_put(dict(parameters))
            compute = partial(predict, vectors, grid=on_device(grid), config=config)
            return Solution(*in_batches(compute, tuple(arrays)))


@cache
def jax_engine() -> JaxEngine:
    """Return the process's JAX engine."""
    return JaxEngine()
