"""All coupling passes and the pressure in one compiled function.

The flow is Q = Q_in + Σ_k G_k(z)·V_k(t), with V the last layer's bias and
weights and G = (z − z₀, H): see :mod:`pcnde_bridge.engines.jax.flow`.  Both area
equations are linear and act on z through G alone and on t through V alone, so

    S = s₀(z) + Σ_k c_k(z)·B_k(t),   c = −a·∂G/∂z,   B = Fourier integral of V.

The passes therefore need no array over time and space; only the result does.
It is what the five stages give one after the other, to round-off (tested).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.jax.area import flow_slope, fourier_integral
from pcnde_bridge.engines.jax.flow import solve_hidden, take_apart
from pcnde_bridge.engines.jax.pressure import spatial, temporal_mean
from pcnde_bridge.engines.jax.separable import Separable


class _Pass(NamedTuple):
    """What one coupling pass leaves to the next, in space: G, s₀, c, and whether all is solved."""

    in_space: jax.Array
    steady: jax.Array
    wave: jax.Array
    solved: jax.Array


@partial(jax.jit, static_argnames="config")
def predict(
    parameters: dict[str, jax.Array],
    inflow: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    period: jax.Array,
    config: PCNDEConfig,
) -> tuple[jax.Array, jax.Array, jax.Array | None, jax.Array]:
    """Predict flow, area and pressure.

    Parameters
    ----------
    parameters : dict of arrays
        By stage.
    inflow : array of shape (case, time)
        Q_in, mL/s.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    z, period
        The grid, cm and s.
    config : PCNDEConfig
        All settings.

    Returns
    -------
    flow, area, pressure : array of shape (case, time, z)
        mL/s, cm², and dyn/cm² or None without pressure stages.
    solved : array of shape (case,)
        Whether the momentum equation came to its end, in every pass.
    """
    n_cases, n_times = inflow.shape
    network = take_apart(parameters["flow"], n_times, config)
    a_hat, b_hat = jnp.split(parameters["intermediate_area"], 2)
    a, b = jnp.split(parameters["fourier_area"], 2)
    in_time = jnp.concatenate([network.last_bias[None], network.last])

    analysis, synthesis = fourier_integral(n_times, config.fourier_area)
    fourier_in_time = period * in_time @ analysis.T @ synthesis.T
    fourier_in_time = fourier_in_time - fourier_in_time[:, :1]
    weights, elapsed = _until_anchor(n_times, config)
    integral_in_time = period * in_time @ weights

    @jax.vmap
    def one_pass(q: jax.Array, from_area: jax.Array) -> tuple[jax.Array, jax.Array]:
        hidden, solved = solve_hidden(network, q[None], from_area[None], jnp.ones(1), z, config)
        return hidden[0], solved[0]

    area_to_layer = network.from_area.sum(axis=0)
    wave_to_layer = fourier_in_time @ network.from_area
    distance = jnp.broadcast_to(z - z[0], (n_cases, 1, z.shape[0]))

    def couple(_: int, before: _Pass) -> _Pass:
        from_area = before.steady[:, :, None] * area_to_layer
        from_area = from_area + jnp.einsum("nkz,kh->nzh", before.wave, wave_to_layer)
        if config.flow.steps is None:
            hidden, solved = one_pass(inflow, from_area)
        else:  # no step control, through which the cases would influence each other
            alike = jnp.ones(n_cases)
            hidden, solved = solve_hidden(network, inflow, from_area, alike, z, config)
        in_space = jnp.concatenate([distance, jnp.moveaxis(hidden, 2, 1)], axis=1)
        slope = flow_slope(in_space, z)
        anchor = (
            area_undeformed
            - a_hat * jnp.einsum("k,nkz->nz", integral_in_time, slope)
            + b_hat * (period * elapsed)
        )
        return _Pass(in_space, anchor + b, -a * slope, before.solved & solved)

    nothing = jnp.zeros((n_cases, in_time.shape[0], z.shape[0]))
    first = _Pass(nothing, area_undeformed, nothing, jnp.ones(n_cases, dtype=bool))
    in_space, steady, wave, solved = jax.lax.fori_loop(0, config.coupling_passes, couple, first)
    flow = Separable(inflow[:, :, None], in_time, in_space)
    area = Separable(steady[:, None], fourier_in_time, wave)
    if parameters["temporal_pressure"].size == 0:
        return flow.values(), area.values(), None, solved
    mean = temporal_mean(parameters["temporal_pressure"], flow, area, area_undeformed, config)
    q = flow.values()
    pressure = spatial(parameters["spatial_pressure"], mean, q, area_undeformed, z, config)
    return q, area.values(), pressure * config.physics.reference_pressure, solved


def _until_anchor(n_times: int, config: PCNDEConfig) -> tuple[np.ndarray, float]:
    """Weights of the trapezoidal rule from the start to the anchor, and its time, in periods."""
    cycles = config.intermediate_area.cycles
    last = {
        "undeformed": 0,
        "last_cycle": (cycles - 1) * n_times,
        "last_time_point": cycles * n_times - 1,
    }[config.fourier_area.anchor]
    weights = np.zeros(n_times)
    for instant in range(last):
        weights[[instant % n_times, (instant + 1) % n_times]] += 0.5
    return weights / n_times, last / n_times
