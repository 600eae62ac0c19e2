"""Values, Jacobians and batched predictions of the closures."""

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
from pcnde_bridge.config import ClosureConfig, CorrectionClosure, WallClosure
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.buffers import Buffers
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.jax.closures import pressure_losses as losses
from pcnde_bridge.engines.jax.closures.coupling import VesselModes, couple, vessel_modes
from pcnde_bridge.engines.jax.closures.pressure_losses import REVERSED
from pcnde_bridge.engines.jax.closures.wall import displacement
from pcnde_bridge.engines.types import Problem, Solution
from pcnde_bridge.errors import SolveError

__all__ = ["JaxClosures"]

_BATCH = 64
"""Cases in one batch: their functions of time and of z fit into the processor's cache."""

_SETTLED = 1e-9
"""Expected change of the flow below which the passes end, relative to the largest inflow."""

_SCALARS = 3
"""Number of scalars of a coupled case; see :func:`_couple`."""

_CONVERGED = 1e-4
"""Largest accepted change in the last coupling pass, relative to the largest inflow."""


class JaxClosures:
    """JAX implementation of :class:`pcnde_bridge.engines.protocol.Closures`."""

    def __init__(self) -> None:
        # The vessels of the last prediction, with the arguments of their computation.
        self._vessels: tuple[tuple[ClosureConfig | bytes, ...], VesselModes] | None = None
        self._buffers = Buffers()

    def losses(
        self, flow: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
        return _problem(_losses, (flow, area_undeformed), (grid.z, grid.period), config)

    def area(
        self, pressure: Array, area_undeformed: Array, grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
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
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
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
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
        settings, count = _relevant(config), len(inflow)
        shape = count, inflow.shape[1], grid.z.size
        result = Solution(*(self._buffers.empty(shape) for _ in range(3)))
        vessels, which = self._vessels_of(parameters, area_undeformed, grid, settings)

        def compute(start: int) -> None:
            rows = slice(start, start + _BATCH)
            cases = shift[rows], inflow[rows]
            _predict_batch(parameters, vessels, which[rows], cases, rows, grid, settings, result)

        if count <= _BATCH:
            compute(0)
        else:
            # One thread more than processors, because one usually waits for JAX.
            with ThreadPoolExecutor(max_workers=(os.cpu_count() or 1) + 1) as pool:
                # Reading the results raises the exception of a batch.
                list(pool.map(compute, range(0, count, _BATCH)))
        return result

    def _vessels_of(
        self,
        parameters: ClosureParameters,
        area_undeformed: Array,
        grid: Grid,
        config: ClosureConfig,
    ) -> tuple[VesselModes, npt.NDArray[np.int64]]:
        """Integrate along each distinct vessel; return the modes and each case's vessel.

        Many waveforms usually share few vessels, and consecutive calls often have the same ones.
        """
        names = [s.tobytes() for s in area_undeformed]
        first = {name: case for case, name in enumerate(names)}
        # Sorted, so that a set of vessels is recognized in any order of the cases.
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
                s_u = _padded(different[start : start + _BATCH])
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
    """Predict a batch of cases, and write it into its rows of the result."""
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
    padded = _padded(np.concatenate(given, axis=1))
    with double_precision():
        found = _couple(_on_device(parameters), padded, sizes, config)
        numbers = np.asarray(found)[:size]
    signals = numbers[:, :-_SCALARS].reshape(size, 2, -1, grid.time.size)
    mean_pressure, reverses, settled = numbers[:, -_SCALARS:].T
    failed = np.flatnonzero(settled == 0)
    if failed.size:
        raise SolveError(
            f"Flow, area and pressure of case {rows.start + failed[0]} do not settle in "
            f"{config.correction.passes} coupling passes. Check the units of inflow and area "
            "(mL/s, cm²); a stronger waveform or a longer vessel needs more passes "
            "(correction.passes)."
        )
    # The last modes are zero without reversed flow.
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

    NumPy's matrix product, one per case, writes directly into the output.
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
    """Transfer the parameters that :func:`_couple` needs, once for each model."""
    with double_precision():
        return tuple(map(jnp.asarray, (parameters.outlet, parameters.wall, parameters.correction)))


def _padded(cases: Array) -> Array:
    """Repeat the last case up to one of two sizes, to limit the number of compilations."""
    count = len(cases)
    size = 1 if count == 1 else _BATCH
    return np.concatenate([cases, np.repeat(cases[-1:], size - count, axis=0)])


@cache
def _relevant(config: ClosureConfig) -> ClosureConfig:
    """Reset the settings that the equations ignore, so that they trigger no compilation."""
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
    """Transfer the data once; compile once for each shape."""
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
    vectors: tuple[jax.Array, ...], given: jax.Array, sizes: tuple[int, ...], config: ClosureConfig
) -> jax.Array:
    """Couple all cases, (case, number): signals of flow and area, then the scalars.

    The scalars are the mean of P, whether flow reverses anywhere, and whether the case settled.
    The input has a row for each case: the vessel's modes at the outlet and their slopes,
    the shift and the inflow, with the lengths ``sizes``, and the period.  A single array in
    each direction is used because every further array of a call costs 10 to 20 µs.
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
