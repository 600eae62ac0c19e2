"""Values, Jacobians and batched predictions of the closures."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, ComplexArray, IntArray
from pcnde_bridge._utils.jax_context import compiled, double_precision
from pcnde_bridge.config.settings import ClosureConfig, CorrectionClosure, WallClosure
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.buffers import Buffers
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.internal_points import internal_points
from pcnde_bridge.engines.jax.closures import pressure_losses as losses
from pcnde_bridge.engines.jax.closures import wall_shear_stress
from pcnde_bridge.engines.jax.closures.coupling import Coupled, VesselModes, couple, vessel_modes
from pcnde_bridge.engines.jax.closures.pressure_losses import DIRECTED
from pcnde_bridge.engines.jax.closures.wall import displacement
from pcnde_bridge.engines.jax.closures.wall_shear_stress import Terms
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.types import ModelInputs, Problem, Result, Solution
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.outlet import windkessel_response

_BATCH = 64
"""Cases in one batch: their functions of time and of z fit into the processor's cache."""

_STEP = 16
"""Step of the numbers of cases or vessels for which functions are compiled."""

_FEW = 8
"""Number of vessels beyond which the losses of a multiple of it are computed."""

_SETTLED = 1e-9
"""Expected change of the flow below which the passes end, relative to the largest inflow."""

_CONVERGED = 1e-4
"""Largest accepted change in the last coupling pass, relative to the largest inflow."""


class JaxClosures(Closures):
    """Closures in JAX; see :mod:`pcnde_bridge.engines.jax.closures.coupling`."""

    def __init__(self) -> None:
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
        (modes, _), which = _vessels_of(others, area_undeformed, grid, config)
        at = [*points, -1]  # the outlet's flow is the unknown of the coupling
        vessels = modes.flow[which][..., at], modes.flow_slope[which][..., at]
        cases = *vessels, modes.reference_flow[which], inflow, _outlets(others, inputs, outlet)
        return _problem(_flow, cases, (others.wall, grid.period), config)

    def _problem(
        self, name: str, data: tuple[Any, ...], grid: Grid, config: ClosureConfig
    ) -> Problem:
        """See :class:`pcnde_bridge.engines.protocol.Closures`."""
        if name == "area":
            return _problem(_area, data, (grid.z,), config)
        *parameters, flow, flow_rate, area_undeformed = data
        distinct, which = np.unique(area_undeformed, axis=0, return_inverse=True)
        which = which.ravel()  # NumPy 2.0.0 returns a column
        if name == "losses":
            # Few numbers of vessels are compiled: even ones, and multiples of _FEW beyond it.
            step = _FEW if len(distinct) > _FEW else 2
            distinct = _padded(distinct, -(-len(distinct) // step) * step)
            return _problem(_losses, (which, flow, flow_rate), (distinct, grid.z), config)
        own_points = config.replace(losses={"spacing": None})
        (modes, terms), which = _vessels_of(parameters[0], area_undeformed, grid, own_points)
        vessels = jax.tree.map(lambda array: array[which], (terms, modes.reference_flow))
        return _problem(_wall_shear_stress, (*vessels, flow, flow_rate), (), config)

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
        settings, count = _relevant(config), len(inflow)
        outlets = _outlets(parameters, inputs, outlet)
        shape = *inflow.shape, grid.z.size
        result = Solution(*(self._buffers.empty(shape) for _ in range(4)))
        (vessels, _), which = _vessels_of(parameters, area_undeformed, grid, config)

        def compute(start: int) -> Array:
            rows = slice(start, start + _BATCH)
            batch: VesselModes = jax.tree.map(lambda modes: modes[which[rows]], vessels)
            at_outlet = batch.flow[:, :, -1], batch.flow_slope[:, :, -1]
            cases = outlets[rows], shift[rows], inflow[rows], *at_outlet, batch.reference_flow
            coupled = _couple_batch(parameters, cases, grid.period, settings)
            _write_fields(coupled, batch, *(field[rows] for field in result if field is not None))
            return np.asarray(coupled.change)

        changes = np.concatenate(_in_batches(compute, count))
        settled = changes <= _CONVERGED * np.abs(inflow).max(axis=1)
        if not settled.all():
            raise SolveError(
                f"Flow, area and pressure of case {np.argmin(settled)} do not settle in "
                f"{config.correction.passes} coupling passes. Check the units of inflow and area "
                "(mL/s, cm²); a stronger waveform or a longer vessel needs more passes "
                "(correction.passes).",
                np.flatnonzero(~settled),
            )
        return result


def _in_batches(compute: Callable[[int], Result], count: int) -> list[Result]:
    """Call a function with the first index of each batch, in threads; return all results."""
    starts = range(0, count, _BATCH)
    if len(starts) == 1:
        return [compute(0)]
    # One thread more than processors, because one usually waits for JAX.
    with ThreadPoolExecutor(max_workers=(os.cpu_count() or 1) + 1) as pool:
        return list(pool.map(compute, starts))


def _outlets(
    parameters: ClosureParameters, inputs: ModelInputs, outlet: ComplexArray | None
) -> ComplexArray:
    """Return the response of the outlet of each case, (case, 2, harmonic)."""
    found = parameters.outlet_response(inputs.grid) if outlet is None else outlet
    return np.broadcast_to(found, (len(inputs.inflow), *found.shape[1:]))


def _vessels_of(
    parameters: ClosureParameters, area_undeformed: Array, grid: Grid, config: ClosureConfig
) -> tuple[tuple[VesselModes, Terms], IntArray]:
    """Return the distinct vessels, and which of them each case has: waveforms share vessels."""
    vessel_of = [s.tobytes() for s in area_undeformed]
    distinct = sorted(set(vessel_of))
    row = {vessel: number for number, vessel in enumerate(distinct)}
    which = np.array([row[vessel] for vessel in vessel_of])
    vectors = parameters.wall, parameters.losses, parameters.wall_shear_stress
    key = *(vector.tobytes() for vector in vectors), b"".join(distinct), grid.z.tobytes()
    return _distinct_vessels(*key, config.losses.spacing, _relevant(config)), which


@lru_cache(maxsize=8)  # the members of a sampled model have different losses
def _distinct_vessels(
    wall: bytes,
    loss: bytes,
    shear: bytes,
    area_undeformed: bytes,
    z: bytes,
    spacing: float | None,
    config: ClosureConfig,
) -> tuple[VesselModes, Terms]:
    """Integrate along vessels; consecutive predictions often have the same ones."""
    given, *vectors = map(np.frombuffer, (z, wall, loss, shear))
    points = internal_points(given, spacing)
    areas = points.area(np.frombuffer(area_undeformed).reshape(-1, given.size))

    def at_given(values: Any) -> Array:
        values = np.asarray(values)
        return points.at_given(values) if values.ndim > 1 else values

    def integrate(start: int) -> tuple[VesselModes, Terms]:
        batch = areas[start : start + _BATCH]
        with double_precision():
            s_u = _padded(batch, _rounded(len(batch)))
            modes, terms = _vessels(*vectors, s_u, points.z, config=config)
            # Only models without internal points use the terms.
            return jax.tree.map(at_given, modes), jax.tree.map(np.asarray, terms)

    return jax.tree.map(lambda *a: np.concatenate(a), *_in_batches(integrate, len(areas)))


def _couple_batch(
    parameters: ClosureParameters, cases: tuple[Any, ...], period: float, config: ClosureConfig
) -> Coupled:
    """Couple a batch of cases; see :func:`_couple`."""
    vectors = parameters.wall, parameters.correction
    padded = tuple(_padded(array) for array in cases)
    with double_precision():
        found = _couple(vectors, padded, period, config=config)
        coupled: Coupled = jax.tree.map(lambda array: np.asarray(array)[: len(cases[0])], found)
    return coupled


def _write_fields(
    coupled: Coupled, vessels: VesselModes, flow: Array, area: Array, pressure: Array, shear: Array
) -> None:
    """Write the sums of products of functions of time and of z into (case, time, z).

    NumPy's matrix product, one per case, writes directly into the output.
    """
    # The last modes are zero without reversed flow.
    rows = vessels.flow.shape[1] - (0 if np.any(coupled.reverses) else DIRECTED)
    mean = coupled.mean_pressure[:, None, None]
    of_flow, of_area = (a[:, :rows].transpose(0, 2, 1) for a in (coupled.flow, coupled.area))
    for in_time, in_z, slope, out in (
        (of_flow, vessels.flow, vessels.flow_slope, flow),
        (of_area, vessels.area, vessels.area_slope, area),
    ):
        in_z[:, 3:] += mean * slope
        np.matmul(in_time, in_z[:, :rows], out=out)
    np.matmul(of_area[:, :, 1:], vessels.pressure[:, : rows - 1], out=pressure)
    np.matmul(of_area[:, :, 3:], vessels.shear[:, : rows - 3], out=shear)
    np.abs(shear, out=shear)


def _padded(cases: Any, size: int = _BATCH) -> Array:
    """Repeat the last of several cases up to a size, to limit the number of compilations."""
    missing = 0 if len(cases) == 1 else size - len(cases)
    return np.concatenate([cases, np.repeat(cases[-1:], missing, axis=0)])


def _rounded(count: int) -> int:
    """Return the number of cases, or vessels, that is compiled for ``count``."""
    return -(-count // _STEP) * _STEP


@cache
def _relevant(config: ClosureConfig) -> ClosureConfig:
    """Reset the settings that the equations ignore, so that they trigger no compilation."""
    correction = config.correction
    return ClosureConfig(
        physics=config.physics,
        wall=WallClosure(law=config.wall.law),
        correction=CorrectionClosure(hidden=correction.hidden, passes=correction.passes),
    )


def _each_case(function: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """Return the function of all cases for that of one case."""

    def all_cases(parameters: jax.Array, cases: Any, *settings: Any) -> jax.Array:
        return jax.vmap(lambda *case: function(parameters, case, *settings))(*cases)

    return all_cases


def _losses(parameters: jax.Array, cases: Any, fixed: Any, config: ClosureConfig) -> jax.Array:
    (which, *flows), (areas, z) = cases, fixed
    vessels, _ = losses.coefficients(parameters, areas, z, config.physics)
    of_cases = jax.tree.map(lambda array: array[which], vessels)
    return jax.vmap(partial(losses.drop, z=z))(of_cases, *flows)


@_each_case
def _area(parameters: jax.Array, case: Any, fixed: Any, config: ClosureConfig) -> jax.Array:
    (pressure, s), (z,) = case, fixed
    moved = displacement(parameters, pressure - parameters[-1], s, z, config.wall.law)
    return jnp.pi * (jnp.sqrt(s / jnp.pi) + moved) ** 2


@_each_case
def _flow(parameters: jax.Array, case: Any, fixed: Any, config: ClosureConfig) -> jax.Array:
    (flow, slope, reference_flow, inflow, outlet), (wall, period) = case, fixed
    at_outlet = flow[:, -1], slope[:, -1], reference_flow
    given = outlet, wall, parameters, jnp.zeros(()), inflow, *at_outlet, period
    coupled = couple(*given, config.correction)
    return (coupled.flow.T @ flow.at[3:].add(coupled.mean_pressure * slope))[:, :-1]


@_each_case
def _wall_shear_stress(
    parameters: jax.Array, case: Any, fixed: Any, config: ClosureConfig
) -> jax.Array:
    return wall_shear_stress.stress(parameters, *case)


@compiled("config")
def _vessels(
    wall: jax.Array,
    loss: jax.Array,
    shear: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    config: ClosureConfig,
) -> tuple[VesselModes, Terms]:
    def one(s: jax.Array) -> tuple[VesselModes, Terms]:
        return vessel_modes(wall, loss, shear, s, z, config.wall.law, config.physics)

    return jax.vmap(one)(area_undeformed)


def solve_one(
    parameters: Mapping[str, Any],
    inflow: jax.Array,
    area_undeformed: jax.Array,
    grid: Grid,
    config: ClosureConfig,
) -> Solution:
    """Predict a case by differentiable operations alone: all coupling passes are run.

    Parameters
    ----------
    parameters : mapping of str to array
        Vectors of :class:`~pcnde_bridge.engines.closure_parameters.ClosureParameters`; the
        outlet may be a response (2, harmonic).
    inflow, area_undeformed : array of shape (time,) and (z,)
        Q_in, mL/s, and S_u, cm².
    grid : Grid
        Grid of inputs and results.
    config : ClosureConfig
        Settings of the model.
    """
    outlet, wall, correction = (parameters[n] for n in ("outlet", "wall", "correction"))
    outlet = jnp.asarray(outlet)
    if outlet.ndim == 1:
        outlet = windkessel_response(outlet, inflow.size, grid.period, jnp)
    loss, shear = parameters["losses"], parameters["wall_shear_stress"]
    law, physics = config.wall.law, config.physics
    points = internal_points(grid.z, config.losses.spacing)
    area = jnp.exp(jnp.log(area_undeformed) @ points.inward)
    vessel, _ = vessel_modes(wall, loss, shear, area, jnp.asarray(points.z), law, physics)
    vessel = jax.tree.map(lambda values: points.at_given(values) if values.ndim else values, vessel)
    at_outlet = vessel.flow[:, -1], vessel.flow_slope[:, -1], vessel.reference_flow
    case = jnp.zeros(()), inflow, *at_outlet, jnp.asarray(grid.period)
    found = couple(outlet, wall, correction, *case, config.correction)
    fields: tuple[Any, ...] = (
        found.flow.T @ vessel.flow.at[3:].add(found.mean_pressure * vessel.flow_slope),
        found.area.T @ vessel.area.at[3:].add(found.mean_pressure * vessel.area_slope),
        found.area[1:].T @ vessel.pressure,
        jnp.abs(found.area[3:].T @ vessel.shear),
    )
    return Solution(*fields)


@compiled("function", "config")
def _value_and_jacobian(
    function: Callable[..., jax.Array],
    parameters: jax.Array,
    cases: Any,
    fixed: Any,
    config: ClosureConfig,
) -> tuple[jax.Array, jax.Array]:
    def values(x: jax.Array) -> jax.Array:
        return function(x, cases, fixed, config)

    def push(tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(values, (parameters,), (tangent,))

    return jax.vmap(push, out_axes=(None, -1))(jnp.eye(parameters.size))


def _problem(
    function: Callable[..., jax.Array],
    cases: tuple[Any, ...],
    fixed: tuple[Any, ...],
    config: ClosureConfig,
) -> Problem:
    """Transfer the data once; compile once for each shape, of which there are few."""
    count = len(jax.tree.leaves(cases)[0])
    padded = jax.tree.map(partial(_padded, size=_rounded(count)), cases)
    with double_precision():
        on_device = jax.device_put((padded, fixed))
    settings = _relevant(config)

    def evaluate(parameters: Array) -> tuple[Array, Array]:
        with double_precision():
            value, jacobian = _value_and_jacobian(function, parameters, *on_device, config=settings)
            return np.asarray(value)[:count], np.asarray(jacobian)[:count]

    return evaluate


_Case = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]
"""Shift and inflow, the vessel's modes at its end and their slopes, and the reference flow."""


@compiled("config")
def _couple(
    vectors: tuple[Any, ...], cases: tuple[Any, ...], period: Any, config: ClosureConfig
) -> Coupled:
    """Couple cases: their outlets, and the arrays of :data:`_Case`."""
    wall, correction = vectors
    settings = period, config.correction, _SETTLED

    def one(outlet: jax.Array, *case: *_Case) -> Coupled:
        return couple(outlet, wall, correction, *case, *settings)

    return jax.vmap(one)(*cases)
