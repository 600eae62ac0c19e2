"""The closures of the ``physics`` preset in Julia; ``julia/PCNDECore/src/closures`` computes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge.buffers import Buffers
from pcnde_bridge.closures.parameters import ClosureParameters
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.engines.base import Solution
from pcnde_bridge.engines.closures import Problem
from pcnde_bridge.grid import Grid

__all__ = ["JuliaClosures"]

Array = npt.NDArray[np.float64]


class JuliaClosures:
    """See :class:`pcnde_bridge.engines.closures.Closures`; ``call`` calls Julia."""

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call
        self._buffers = Buffers()

    def losses(
        self, flow: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See the protocol."""
        return self._problem("losses", (flow, area_undeformed), grid, config)

    def area(
        self, pressure: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See the protocol."""
        return self._problem("area", (pressure, area_undeformed), grid, config)

    def flow(
        self,
        others: ClosureParameters,
        inflow: Array,
        area_undeformed: Array,
        points: npt.NDArray[np.int64],
        grid: Grid,
        config: ClosureConfig,
    ) -> Problem:
        """See the protocol."""
        positions = points.astype(np.float64)  # as every array that Julia is given
        fixed = others.outlet, others.losses, others.wall, inflow, area_undeformed, positions
        return self._problem("flow", fixed, grid, config)

    def predict(
        self,
        parameters: ClosureParameters,
        shift: Array,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> Solution:
        """See the protocol."""
        shape = len(inflow), inflow.shape[1], grid.z.size
        flow, area, pressure = (self._buffers.empty(shape) for _ in range(3))
        vectors = (vector for _, vector in parameters)
        inputs = *vectors, shift, inflow, area_undeformed, grid.z
        # Named, as Julia uses their memory until it returns.
        arrays = [flow, area, pressure, *(np.ascontiguousarray(a, np.float64) for a in inputs)]
        self._call("predict_closures", config, float(grid.period), in_place=arrays)
        return Solution(flow, area, pressure)

    def _problem(
        self, name: str, inputs: tuple[Array, ...], grid: Grid, config: ClosureConfig
    ) -> Problem:
        def evaluate(parameters: Array) -> tuple[Array, Array]:
            # Nothing of Julia's is kept, which another thread might let go.
            value, jacobian = self._call(
                "closure", name, parameters, inputs, grid.z, float(grid.period), config
            )
            return value, jacobian

        return evaluate
