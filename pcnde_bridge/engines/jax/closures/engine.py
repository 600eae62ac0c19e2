"""The closures of the ``physics`` preset in JAX: wall, losses, correction, and all coupled."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import (
    ClosureConfig,
    CorrectionClosure,
    WallClosure,
)
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.buffers import Buffers
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.jax.closures import pressure_losses as losses
from pcnde_bridge.engines.jax.closures.coupling import (
    VesselModes,
    couple,
    vessel_modes,
)
from pcnde_bridge.engines.jax.closures.pressure_losses import REVERSED
from pcnde_bridge.engines.jax.closures.wall import displacement
from pcnde_bridge.engines.types import Problem, Solution
from pcnde_bridge.errors import SolveError

__all__ = ["JaxClosures"]

_BATCH = 64
"""Cases computed together: their functions of time and of z stay in the processor's cache."""

_BLOCK = 4096
"""Cases whose vessels are kept at a time."""

_SETTLED = 1e-9
"""No more coupling pass that would change the flow by less, relative to the largest inflow."""

_SCALARS = 3
"""Numbers of a coupled case that are not signals; see :func:`_couple`."""

_CONVERGED = 1e-4
"""Largest change of the last coupling pass, relative to the largest inflow."""


class JaxClosures:
    """JAX implementation of :class:`pcnde_bridge.engines.protocol.Closures`."""

    def __init__(self) -> None:
        # The vessels of the last batch, with what they were computed from.
        self._vessels: tuple[tuple[ClosureConfig | bytes, ...], VesselModes] | None = None
        self._buffers = Buffers()

    def losses(
        self, flow: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See the protocol."""
        return _problem(_losses, (flow, area_undeformed), (grid.z, grid.period), config)

    def area(
        self, pressure: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See the protocol."""
        return _problem(_area, (pressure, area_undeformed), (grid.z,), config)

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
        with double_precision():
            vessels = _vessels(
                others.wall, others.losses, area_undeformed, grid.z, config=_relevant(config)
            )
        fixed = others.outlet, others.wall, points, grid.period
        return _problem(_flow, (vessels, inflow), fixed, config)

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
        settings, count = _relevant(config), len(inflow)
        shape = count, inflow.shape[1], grid.z.size
        result = Solution(*(self._buffers.empty(shape) for _ in range(3)))
        cases = shift, inflow
        for start in range(0, count, _BLOCK):
            block = slice(start, min(start + _BLOCK, count))
            vessels, which = self._vessels_of(parameters, area_undeformed[block], grid, settings)

            def compute(
                first: int,
                vessels: VesselModes = vessels,
                which: npt.NDArray[np.int64] = which,
                block: slice = block,
            ) -> None:
                rows = slice(first, min(first + _BATCH, block.stop))
                chosen = which[rows.start - block.start : rows.stop - block.start]
                mine = tuple(a[rows] for a in cases)
                _predict_batch(parameters, vessels, chosen, mine, rows, grid, settings, result)

            batches = range(block.start, block.stop, _BATCH)
            if len(batches) == 1:
                compute(block.start)
                continue
            # One thread more than processors, as one usually waits for JAX.
            with ThreadPoolExecutor(max_workers=(os.cpu_count() or 1) + 1) as pool:
                # Asking for the results raises what a batch raised.
                list(pool.map(compute, batches))
        return result

    def _vessels_of(
        self,
        parameters: ClosureParameters,
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> tuple[VesselModes, npt.NDArray[np.int64]]:
        """Integrate along each different vessel; return the modes and each case's vessel.

        Many waveforms usually share few vessels, and one call's are often the next one's.
        """
        names = [s.tobytes() for s in area_undeformed]
        first = {name: case for case, name in enumerate(names)}
        # In an order that is not the cases', so that a set of vessels is known again.
        place = {name: row for row, name in enumerate(sorted(first))}
        which = np.array([place[name] for name in names])
        fixed = grid.z, parameters.wall, parameters.losses
        key = config, *(a.tobytes() for a in fixed), *place
        if self._vessels is not None and self._vessels[0] == key:
            return self._vessels[1], which
        different = area_undeformed[[first[name] for name in place]]
        parts = []
        with double_precision():
            for start in range(0, len(different), _BATCH):
                s_u = _filled_up(different[start : start + _BATCH])
                modes = _vessels(parameters.wall, parameters.losses, s_u, grid.z, config=config)
                parts.append(jax.tree.map(np.asarray, modes))
        vessels: VesselModes = jax.tree.map(lambda *a: np.concatenate(a), *parts)
        self._vessels = key, vessels
        return vessels, which


def _predict_batch(
    parameters: ClosureParameters,
    vessels: VesselModes,
    which: npt.NDArray[np.int64],
    cases: tuple[Array, ...],
    rows: slice,
    grid: Grid,
    config: ClosureConfig,
    result: Solution,
) -> None:
    """Predict few cases, and write them into their rows of the result."""
    size = len(which)
    shift, inflow = cases
    given: tuple[Array, ...] = (
        np.asarray(vessels.flow)[which, :, -1],
        np.asarray(vessels.flow_slope)[which, :, -1],
        shift[:, None],
        inflow,
        np.full((size, 1), grid.period),
    )
    sizes = tuple(a.shape[1] for a in given[:-1])
    filled = _filled_up(np.concatenate(given, axis=1))
    with double_precision():
        found = _couple(_on_device(parameters), filled, sizes, config)
        numbers = np.asarray(found)[:size]
    signals = numbers[:, :-_SCALARS].reshape(size, 2, -1, grid.time.size)
    mean_pressure, reverses, settled = numbers[:, -_SCALARS:].T
    failed = np.flatnonzero(settled == 0)
    if failed.size:
        raise SolveError(
            f"Flow, area and pressure of case {rows.start + failed[0]} do not settle in "
            f"{config.correction.passes} coupling passes. Check the units of inflow and area "
            "(mL/s, cm²); a stiffer wave or a longer vessel needs more passes "
            "(correction.passes)."
        )
    # Modes of reversed flow, the last, are zero where there is none.
    if not reverses.any():
        signals = signals[:, :, :-REVERSED]
    _fields(signals, mean_pressure, vessels, which, *(v[rows] for v in result if v is not None))


def _fields(
    signals: Array,
    mean_pressure: Array,
    vessels: VesselModes,
    which: npt.NDArray[np.int64],
    flow: Array,
    area: Array,
    pressure: Array,
) -> None:
    """Write the sums of products of functions of time and of z into (case, time, z).

    A matrix product for each case: NumPy's writes its result at once where it belongs.
    """
    of_flow, of_area = signals.transpose(1, 0, 3, 2)
    rows = signals.shape[2]
    mean = mean_pressure[:, None, None]
    in_z = vessels.flow[which, :rows]
    in_z[:, 3:] += mean * vessels.flow_slope[which, : rows - 3]
    np.matmul(of_flow, in_z, out=flow)
    in_z = vessels.area[which, :rows]
    in_z[:, 3:] += mean * vessels.area_slope[which, : rows - 3]
    np.matmul(of_area, in_z, out=area)
    np.matmul(of_area[:, :, 1:], vessels.pressure[which, : rows - 1], out=pressure)


@lru_cache(maxsize=16)
def _on_device(parameters: ClosureParameters) -> tuple[jax.Array, ...]:
    """Hand over what :func:`_couple` needs of one model's parameters, once."""
    with double_precision():
        return tuple(map(jnp.asarray, (parameters.outlet, parameters.wall, parameters.correction)))


def _filled_up(cases: Array) -> Array:
    """Repeat the last case up to one of two sizes, so that little is compiled."""
    count = len(cases)
    size = 1 if count == 1 else _BATCH
    return np.concatenate([cases, np.repeat(cases[-1:], size - count, axis=0)])


@cache
def _relevant(config: ClosureConfig) -> ClosureConfig:
    """Keep the settings that the equations need: a change of others compiles nothing again."""
    correction = config.correction
    return ClosureConfig(
        physics=config.physics,
        wall=WallClosure(law=config.wall.law),
        correction=CorrectionClosure(hidden=correction.hidden, passes=correction.passes),
    )


def _losses(parameters: jax.Array, cases: Any, fixed: Any, config: ClosureConfig) -> jax.Array:
    z, period = fixed

    def one(flow: jax.Array, s: jax.Array) -> jax.Array:
        return losses.drop(parameters, flow, s, z, period, config.physics)

    return jax.vmap(one)(*cases)


def _area(parameters: jax.Array, cases: Any, fixed: Any, config: ClosureConfig) -> jax.Array:
    (z,) = fixed

    def one(pressure: jax.Array, s: jax.Array) -> jax.Array:
        moved = displacement(parameters, pressure - parameters[-1], s, z, config.wall.law)
        return jnp.pi * (jnp.sqrt(s / jnp.pi) + moved) ** 2

    return jax.vmap(one)(*cases)


def _flow(parameters: jax.Array, cases: Any, fixed: Any, config: ClosureConfig) -> jax.Array:
    outlet, wall, points, period = fixed

    def one(vessel: VesselModes, inflow: jax.Array) -> jax.Array:
        vectors = outlet, wall, parameters
        at_outlet = vessel.flow[:, -1], vessel.flow_slope[:, -1]
        coupled = couple(*vectors, jnp.zeros(()), *at_outlet, inflow, period, config.correction)
        in_z = vessel.flow.at[3:].add(coupled.mean_pressure * vessel.flow_slope)
        return coupled.flow.T @ in_z[:, points]

    return jax.vmap(one)(*cases)


@partial(jax.jit, static_argnames="config")
def _vessels(
    wall: jax.Array,
    loss: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    config: ClosureConfig,
) -> VesselModes:
    def one(s: jax.Array) -> VesselModes:
        return vessel_modes(wall, loss, s, z, config.wall.law, config.physics)

    return jax.vmap(one)(area_undeformed)


@partial(jax.jit, static_argnames=("function", "config"))
def _value_and_jacobian(
    function: Callable[..., jax.Array],
    parameters: jax.Array,
    cases: Any,
    fixed: Any,
    config: ClosureConfig,
) -> tuple[jax.Array, jax.Array]:
    value, push = jax.linearize(lambda x: function(x, cases, fixed, config), parameters)
    return value, jax.vmap(push, out_axes=-1)(jnp.eye(parameters.size))


def _problem(
    function: Callable[..., jax.Array],
    cases: tuple[Any, ...],
    fixed: tuple[Any, ...],
    config: ClosureConfig,
) -> Problem:
    """Hand the data over once; compile once for each shape."""
    with double_precision():
        on_device = jax.tree.map(jnp.asarray, (cases, fixed))
    settings = _relevant(config)

    def evaluate(parameters: Array) -> tuple[Array, Array]:
        with double_precision():
            value, jacobian = _value_and_jacobian(
                function, jnp.asarray(parameters), *on_device, config=settings
            )
            return np.asarray(value), np.asarray(jacobian)

    return evaluate


@partial(jax.jit, static_argnums=(2, 3))
def _couple(
    vectors: tuple[jax.Array, ...],
    given: jax.Array,
    sizes: tuple[int, ...],
    config: ClosureConfig,
) -> jax.Array:
    """Couple all cases, (case, number): signals of flow and area, then the scalars.

    The scalars are the mean of P, whether some flow goes back, and whether the case settled.
    Of each case are given, side by side: the vessel's modes at the outlet and their slopes,
    the shift, the inflow, so many numbers as ``sizes`` says, and the period.  One array each
    way: every other that JAX takes or hands back costs some 10 to 20 µs.
    """
    outlet, wall, correction = vectors

    def one(numbers: jax.Array, period: jax.Array) -> jax.Array:
        flow, flow_slope, shift, inflow = jnp.split(numbers, list(itertools.accumulate(sizes))[:-1])
        vessel = flow, flow_slope
        coupled = couple(
            outlet, wall, correction, shift[0], *vessel, inflow, period, config.correction, _SETTLED
        )
        settled = coupled.change <= _CONVERGED * jnp.max(jnp.abs(inflow))
        scalars = jnp.stack([coupled.mean_pressure, coupled.reverses, settled])
        return jnp.concatenate([coupled.flow.ravel(), coupled.area.ravel(), scalars])

    return jax.vmap(one, (0, None))(given[:, :-1], given[0, -1])
