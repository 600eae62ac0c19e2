"""Closures of the ``physics`` preset in Julia (``julia/PCNDECore/src/closures``)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, ComplexArray
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.buffers import Buffers
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.internal_points import internal_points
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.types import ModelInputs, Problem, Solution


class JuliaClosures(Closures):
    """Closures that call PCNDECore's functions.

    Parameters
    ----------
    call : callable
        Calls one of PCNDECore's functions (:meth:`~pcnde_bridge.engines.julia.runtime.Julia.call`).
    """

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call
        self._buffers = Buffers()

    def flow(
        self,
        others: ClosureParameters,
        inputs: ModelInputs,
        points: npt.NDArray[np.int64],
        config: ClosureConfig,
        outlet: ComplexArray | None = None,
    ) -> Problem:
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
        inflow, area_undeformed, grid = inputs
        inside = internal_points(grid.z, config.losses.spacing)
        at_end = _parts(others.outlet_response(grid) if outlet is None else outlet)
        fixed = at_end, others.losses, others.wall, inflow, inside.area(area_undeformed)
        on_inside = replace(grid, z=inside.z)
        return self._problem("flow", (*fixed, inside.outward, points), on_inside, config)

    def predict(
        self,
        parameters: ClosureParameters,
        shift: Array,
        inputs: ModelInputs,
        config: ClosureConfig,
        outlet: ComplexArray | None = None,
    ) -> Solution:
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
        inflow, area_undeformed, grid = inputs
        shape = *inflow.shape, grid.z.size
        result = Solution(*(self._buffers.empty(shape) for _ in range(4)))
        inside = internal_points(grid.z, config.losses.spacing)
        vessels = inside.area(area_undeformed), inside.z, inside.outward
        at_end = _parts(parameters.outlet_response(grid) if outlet is None else outlet)
        vectors = dict(parameters) | {"outlet": at_end}
        given = *vectors.values(), shift, inflow, *vessels
        # Referenced here, because Julia uses their memory until it returns.
        outputs = [field for field in result if field is not None]
        arrays = [*outputs, *(np.ascontiguousarray(a, np.float64) for a in given)]
        self._call("predict_closures", config, float(grid.period), in_place=arrays)
        return result

    def _problem(
        self, name: str, data: tuple[Any, ...], grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
        given = [a.losses if isinstance(a, ClosureParameters) else a for a in data]
        inputs = [np.ascontiguousarray(a, np.float64) for a in (*given, grid.z)]
        if name == "flow":
            *_, inflow, _, _, points = data
            shape = *inflow.shape, len(points)
        else:
            shape = next(array.shape for array in inputs if array.ndim == 3)

        def evaluate(parameters: Array) -> tuple[Array, Array]:
            value, jacobian = np.empty(shape), np.empty((*shape, parameters.size))
            arrays = value, jacobian, np.ascontiguousarray(parameters, np.float64), *inputs
            self._call("closure!", name, config, float(grid.period), in_place=arrays)
            return value, jacobian

        return evaluate


def _parts(outlet: ComplexArray) -> Array:
    """Return real and imaginary part of each harmonic, (case, 2, 2·harmonic)."""
    return np.ascontiguousarray(outlet).view(np.float64)
