"""JAX engine: runs wherever Python does, without further installation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
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
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs, JaxStage, Model, Result, in_batches
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Closures, Stage
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import (
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    Solution,
    SpatialPressureInputs,
    TemporalFlowInputs,
    TemporalPressureInputs,
)

__all__ = ["JaxEngine", "jax_engine"]


def _flow(
    parameters: jax.Array, inputs: Inputs, weight: jax.Array, grid: GridArrays, config: PCNDEConfig
) -> Result:
    inflow, s = inputs
    if config.flow.terms:
        return physics_terms.solve(parameters, inflow, s, weight, grid, config)
    return flow.solve(parameters, inflow, s, weight, grid[0], config)


def _temporal_flow(
    parameters: jax.Array, inputs: Inputs, weight: jax.Array, grid: GridArrays, config: PCNDEConfig
) -> Result:
    inflow, initial_flow = inputs
    return temporal_flow.solve(parameters, inflow, initial_flow, grid[1], config)


def _explicit(formula: Callable[..., jax.Array]) -> Model:
    """Return the model of a formula, which has a result for all parameters.

    The formula takes the parameters, the inputs, the points, the period and the configuration.
    """

    def model(
        parameters: jax.Array,
        inputs: Inputs,
        weight: jax.Array,
        grid: GridArrays,
        config: PCNDEConfig,
    ) -> Result:
        return formula(parameters, *inputs, *grid, config), jnp.asarray(True)

    return model


class JaxEngine:
    """JAX implementation of :class:`pcnde_bridge.engines.protocol.Engine`."""

    name = "jax"
    lbfgs = staticmethod(lbfgs_of_scipy)

    def __init__(self) -> None:
        self.versions: Mapping[str, str] = {
            name: version(name) for name in ("jax", "jaxlib", "diffrax")
        }
        self.closures: Closures = JaxClosures()
        self.flow: Stage[FlowInputs] = JaxStage(
            _flow,
            ("flow", "physics"),
            loss_scale=lambda config, count: count if config.flow.loss == "mean" else 1.0,
            case_by_case=lambda config: config.flow.steps is None,
        )
        self.intermediate_area: Stage[IntermediateAreaInputs] = JaxStage(
            _explicit(area.intermediate), ("intermediate_area",), compared=area.last_cycle
        )
        self.fourier_area: Stage[FourierAreaInputs] = JaxStage(
            _explicit(area.fourier), ("fourier_area",)
        )
        self.temporal_pressure: Stage[TemporalPressureInputs] = JaxStage(
            _explicit(pressure.temporal), ("temporal_pressure", "physics")
        )
        self.spatial_pressure: Stage[SpatialPressureInputs] = JaxStage(
            _explicit(pressure.spatial), ("spatial_pressure", "physics")
        )
        self.temporal_flow: Stage[TemporalFlowInputs] = JaxStage(_temporal_flow, ("temporal_flow",))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a name: compiled functions cannot be pickled."""
        return jax_engine, ()

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
        with double_precision():
            vectors = {stage: jnp.asarray(vector) for stage, vector in parameters}
            z, period = jnp.asarray(grid.z), jnp.asarray(grid.period)

            def compute(batch: Inputs) -> tuple[Inputs, jax.Array]:
                q, s, p, solved = fused_predict.predict(vectors, *batch, z, period, config=config)
                return ((q, s) if p is None else (q, s, p)), solved

            flow_, area_, *pressure_ = in_batches(compute, (inflow, area_undeformed))
        return Solution(flow_, area_, pressure_[0] if pressure_ else None)


@cache
def jax_engine() -> JaxEngine:
    """Return the process's JAX engine."""
    return JaxEngine()
