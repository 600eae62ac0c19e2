"""Coupling passes and pressure in one compiled function.

The flow is Q = Q_in + Σ_k G_k(z)·V_k(t), where V are the bias and weights of the last layer
and G = (z − z₀, H); see :mod:`pcnde_bridge.engines.jax.flow`.  Both area
equations are linear; they act on z through G alone and on t through V alone, so

    S = s₀(z) + Σ_k c_k(z)·B_k(t),   c = −a·∂G/∂z,   B = Fourier integral of V.

The coupling passes therefore need no array over time and space; only the result does.
The result equals that of the five stages in turn up to round-off (tested).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge._utils.jax_context import compiled
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.area import flow_slope, fourier_integral
from pcnde_bridge.engines.jax.flow import FlowNetwork, solve_hidden, split_network
from pcnde_bridge.engines.jax.pressure import spatial_from_mean, temporal_mean
from pcnde_bridge.engines.jax.separable import Separable
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs
from pcnde_bridge.engines.staged import anchor


class _InTime(NamedTuple):
    """Functions of time: V, (k, time), and their integrals.

    Attributes
    ----------
    flow : array of shape (k, time)
        V.
    area : array of shape (k, time)
        B, the Fourier integral of V, zero at the first time point.
    until_anchor : array of shape (k,)
        ∫V dt from the start to the anchor of the Fourier area.
    elapsed : scalar
        Time from the start to the anchor, s.
    """

    flow: jax.Array
    area: jax.Array
    until_anchor: jax.Array
    elapsed: jax.Array


class _InSpace(NamedTuple):
    """Functions of z after a coupling pass: G, s₀ and c; not finite in cases that diverge."""

    flow: jax.Array
    steady: jax.Array
    area: jax.Array


@compiled("config")
def predict(
    parameters: dict[str, jax.Array], inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> Inputs:
    """Predict flow, area and pressure.

    Parameters
    ----------
    parameters : dict of arrays
        Parameter vectors by stage.
    inputs : tuple of arrays
        Q_in (case, time), mL/s, and S_u (case, z), cm².
    grid : tuple
        Points, cm, and period, s.
    config : PCNDEConfig
        All settings.

    Returns
    -------
    tuple of arrays of shape (case, time, z)
        Flow, mL/s, area, cm², and pressure, dyn/cm², unless there are no pressure stages; not
        finite where the momentum equation was not integrated to the end in every pass.
    """
    (inflow, area_undeformed), (z, _) = inputs, grid
    in_time, in_space = _couple(parameters, inputs, grid, config)
    flow = Separable(inflow[:, :, None], in_time.flow, in_space.flow)
    area = Separable(in_space.steady[:, None], in_time.area, in_space.area)
    if parameters["temporal_pressure"].size == 0:
        return flow.values(), area.values()
    network_inputs = flow, area, area_undeformed
    mean = temporal_mean(parameters["temporal_pressure"], network_inputs, config)
    q = flow.values()
    means = mean, q, area_undeformed
    pressure = spatial_from_mean(parameters["spatial_pressure"], means, z, config)
    return q, area.values(), pressure * config.physics.reference_pressure


def _functions_of_time(
    network: FlowNetwork, n_times: int, period: jax.Array, config: PCNDEConfig
) -> _InTime:
    flow = jnp.concatenate([network.last_bias[None], network.last])
    analysis, synthesis = fourier_integral(n_times, config.fourier_area)
    area = period * flow @ analysis.T @ synthesis.T
    weights, elapsed = _until_anchor(n_times, config)
    return _InTime(flow, area - area[:, :1], period * flow @ weights, period * elapsed)


def _couple(
    parameters: dict[str, jax.Array], inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> tuple[_InTime, _InSpace]:
    """Run all coupling passes."""
    (inflow, area_undeformed), (z, period) = inputs, grid
    n_cases, n_times = inflow.shape
    network = split_network(parameters["flow"], n_times, config)
    in_time = _functions_of_time(network, n_times, period, config)
    a_hat, b_hat = jnp.split(parameters["intermediate_area"], 2)
    a, b = jnp.split(parameters["fourier_area"], 2)
    area_to_layer = network.from_area.sum(axis=0)
    wave_to_layer = in_time.area @ network.from_area
    distance = jnp.broadcast_to(z - z[0], (n_cases, 1, z.shape[0]))

    @jax.vmap
    def solve_one(q: jax.Array, from_area: jax.Array) -> jax.Array:
        return solve_hidden(network, (q[None], from_area[None]), jnp.ones(1), z, config)[0]

    def one_pass(_: int, before: _InSpace) -> _InSpace:
        from_area = before.steady[:, :, None] * area_to_layer
        from_area = from_area + jnp.einsum("nkz,kh->nzh", before.area, wave_to_layer)
        if config.flow.steps is None:
            hidden = solve_one(inflow, from_area)
        else:  # without step control the cases do not influence each other
            hidden = solve_hidden(network, (inflow, from_area), jnp.ones(n_cases), z, config)
        flow = jnp.concatenate([distance, jnp.moveaxis(hidden, 2, 1)], axis=1)
        slope = flow_slope(flow, z)
        initial = (
            area_undeformed
            - a_hat * jnp.einsum("k,nkz->nz", in_time.until_anchor, slope)
            + b_hat * in_time.elapsed
        )
        return _InSpace(flow, initial + b, -a * slope)

    zero = jnp.zeros((n_cases, in_time.flow.shape[0], z.shape[0]))
    first = _InSpace(zero, area_undeformed, zero)
    return in_time, jax.lax.fori_loop(0, config.coupling_passes, one_pass, first)


def _until_anchor(n_times: int, config: PCNDEConfig) -> tuple[np.ndarray, float]:
    """Return the trapezoidal rule's weights from the start to the anchor, and the time between.

    Both are in periods.
    """
    last = anchor(n_times, config)
    weights = np.zeros(n_times)
    for number in range(last):
        weights[[number % n_times, (number + 1) % n_times]] += 0.5
    return weights / n_times, last / n_times
