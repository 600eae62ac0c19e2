"""The embedded engine: JAX and diffrax, wherever Python runs."""

from __future__ import annotations

from collections.abc import Mapping
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
    physics_terms,
    pressure,
    temporal_flow,
)
from pcnde_bridge.engines.jax import (
    fused_predict as inference,
)
from pcnde_bridge.engines.jax.closures.engine import JaxClosures
from pcnde_bridge.engines.jax.lbfgs import lbfgs_of_scipy
from pcnde_bridge.engines.jax.stage import JaxStage, in_batches
from pcnde_bridge.engines.parameters import Parameters
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

__all__ = ["JaxEngine"]

_Inputs = tuple[jax.Array, ...]
_Grid = tuple[jax.Array, jax.Array]
_Result = tuple[jax.Array, jax.Array]


def _solved() -> jax.Array:
    """Say that an explicit formula always has a result."""
    return jnp.asarray(True)


def _flow(
    parameters: jax.Array, inputs: _Inputs, weight: jax.Array, grid: _Grid, config: PCNDEConfig
) -> _Result:
    inflow, s = inputs
    if config.flow.terms:
        return physics_terms.solve(parameters, inflow, s, weight, grid, config)
    return flow.solve(parameters, inflow, s, weight, grid[0], config)


def _intermediate_area(
    parameters: jax.Array, inputs: _Inputs, weight: jax.Array, grid: _Grid, config: PCNDEConfig
) -> _Result:
    q, s_u = inputs
    return area.intermediate(parameters, q, s_u, grid[0], grid[1], config), _solved()


def _fourier_area(
    parameters: jax.Array, inputs: _Inputs, weight: jax.Array, grid: _Grid, config: PCNDEConfig
) -> _Result:
    q, initial_area = inputs
    return area.fourier(parameters, q, initial_area, grid[0], grid[1], config), _solved()


def _temporal_pressure(
    parameters: jax.Array, inputs: _Inputs, weight: jax.Array, grid: _Grid, config: PCNDEConfig
) -> _Result:
    q, s, s_u = inputs
    return pressure.temporal(parameters, q, s, s_u, config), _solved()


def _spatial_pressure(
    parameters: jax.Array, inputs: _Inputs, weight: jax.Array, grid: _Grid, config: PCNDEConfig
) -> _Result:
    first_stage, q, s_u = inputs
    mean = jnp.mean(first_stage, axis=2)
    return pressure.spatial(parameters, mean, q, s_u, grid[0], config), _solved()


def _temporal_flow(
    parameters: jax.Array, inputs: _Inputs, weight: jax.Array, grid: _Grid, config: PCNDEConfig
) -> _Result:
    inflow, initial_flow = inputs
    return temporal_flow.solve(parameters, inflow, initial_flow, grid[1], config)


class JaxEngine:
    """The five stages in JAX; see :class:`pcnde_bridge.engines.protocol.Engine`."""

    name = "jax"
    lbfgs = staticmethod(lbfgs_of_scipy)

    def __init__(self) -> None:
        self.closures = JaxClosures()
        self.flow: JaxStage[FlowInputs] = JaxStage(
            _flow,
            ("flow", "physics"),
            loss_scale=lambda config, count: count if config.flow.loss == "mean" else 1.0,
            each_on_its_own=lambda config: config.flow.steps is None,
        )
        self.intermediate_area: JaxStage[IntermediateAreaInputs] = JaxStage(
            _intermediate_area, ("intermediate_area",), compared=area.last_cycle
        )
        self.fourier_area: JaxStage[FourierAreaInputs] = JaxStage(_fourier_area, ("fourier_area",))
        self.temporal_pressure: JaxStage[TemporalPressureInputs] = JaxStage(
            _temporal_pressure, ("temporal_pressure", "physics")
        )
        self.spatial_pressure: JaxStage[SpatialPressureInputs] = JaxStage(
            _spatial_pressure, ("spatial_pressure", "physics")
        )
        self.temporal_flow: JaxStage[TemporalFlowInputs] = JaxStage(
            _temporal_flow, ("temporal_flow",)
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to another process as a name: compiled functions cannot."""
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

            def compute(part: _Inputs) -> tuple[_Inputs, jax.Array]:
                q, s, p, solved = inference.predict(vectors, *part, z, period, config=config)
                return ((q, s) if p is None else (q, s, p)), solved

            flow_, area_, *pressure_ = in_batches(compute, (inflow, area_undeformed))
        return Solution(flow_, area_, pressure_[0] if pressure_ else None)

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of the packages that compute."""
        return {name: version(name) for name in ("jax", "jaxlib", "diffrax")}


@cache
def jax_engine() -> JaxEngine:
    """Return the process's JAX engine."""
    return JaxEngine()
