"""JAX engine: runs wherever Python does, without further installation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax import (
    area,
    flow,
    fused_predict,
    physics_terms,
    pressure,
    temporal_flow,
)
from pcnde_bridge.engines.jax.closures.engine import JaxClosures
from pcnde_bridge.engines.jax.lbfgs import lbfgs_of_scipy
from pcnde_bridge.engines.jax.stage import (
    GridArrays,
    Inputs,
    JaxStage,
    Model,
    Result,
    in_batches,
    on_device,
)
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import ModelInputs, Solution


def _flow(
    parameters: jax.Array, inputs: Inputs, weight: jax.Array, grid: GridArrays, config: PCNDEConfig
) -> Result:
    solve = physics_terms.solve if config.flow.terms else flow.solve
    return solve(parameters, inputs, weight, grid, config)


def _explicit(
    formula: Callable[[jax.Array, Inputs, GridArrays, PCNDEConfig], jax.Array],
) -> Model:
    """Return the model of a formula, which has a result for all parameters."""

    def model(parameters: jax.Array, inputs: Inputs, _: jax.Array, *settings: Any) -> Result:
        return formula(parameters, inputs, *settings), jnp.asarray(True)

    return model


class JaxEngine(Engine):
    """Engine that computes in this process, with JAX and diffrax."""

    name = "jax"
    lbfgs = staticmethod(lbfgs_of_scipy)

    def __init__(self) -> None:
        self.versions = {name: version(name) for name in ("jax", "jaxlib", "diffrax")}
        self.closures = JaxClosures()
        self.flow = JaxStage(
            _flow,
            ("flow", "physics"),
            loss_scale=lambda config, count: count if config.flow.loss == "mean" else 1.0,
            case_by_case=lambda config: config.flow.steps is None,
        )
        self.intermediate_area = JaxStage(_explicit(area.intermediate), ("intermediate_area",))
        self.fourier_area = JaxStage(_explicit(area.fourier), ("fourier_area",))
        pressure_settings = ("temporal_pressure", "spatial_pressure", "physics")
        self.temporal_pressure = JaxStage(_explicit(pressure.temporal), pressure_settings)
        self.spatial_pressure = JaxStage(_explicit(pressure.spatial), pressure_settings)
        self.temporal_flow = JaxStage(temporal_flow.solve, ("temporal_flow",))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a name: compiled functions cannot be pickled."""
        return jax_engine, ()

    def predict(self, parameters: Parameters, inputs: ModelInputs, config: PCNDEConfig) -> Solution:
        """See :class:`pcnde_bridge.engines.protocol.Engine`."""
        if config.flow.terms:
            return predict_by_stages(self, parameters, inputs, config)
        *arrays, grid = inputs
        with double_precision():
            vectors = {stage: jnp.asarray(vector) for stage, vector in parameters}
            predict = partial(fused_predict.predict, vectors, grid=on_device(grid), config=config)
            predicted = in_batches(predict, tuple(arrays))
        return Solution(*predicted)


@cache
def jax_engine() -> JaxEngine:
    """Return the process's JAX engine."""
    return JaxEngine()
