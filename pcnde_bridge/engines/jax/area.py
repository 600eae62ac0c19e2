"""Continuity equation: intermediate area and periodic Fourier area.

Both are linear in their corrections: S = known + a(z)·f(t, z) + b(z)·g(t).
"""

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge.config.settings import FourierAreaStage, PCNDEConfig
from pcnde_bridge.engines.jax.stage import GridArrays, Inputs


def flow_slope(flow: jax.Array, z: jax.Array) -> jax.Array:
    """Return ∂Q/∂z by second-order differences, central inside, one-sided at both ends.

    Parameters
    ----------
    flow : array of shape (..., z)
        Q, mL/s, or a linear function of it.
    z : array of shape (z,)
        Points, cm; the spacing may vary.
    """
    spacing = z[1:] - z[:-1]
    left, right = spacing[:-1], spacing[1:]
    slopes = (flow[..., 1:] - flow[..., :-1]) / spacing
    inside = (right * slopes[..., :-1] + left * slopes[..., 1:]) / (left + right)
    # The parabola through three points has the mean slope of its end and middle in between.
    first = 2 * slopes[..., :1] - inside[..., :1]
    last = 2 * slopes[..., -1:] - inside[..., -1:]
    return jnp.concatenate([first, inside, last], axis=-1)


def intermediate(
    parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Integrate ∂Ŝ/∂t = −â ∂Q/∂z + b̂ from S_u over all cycles.

    Q is linear between its time points, so steps of Tsit5 (or of any Runge–Kutta
    method of order two or more) between them, as in the published code, are the
    trapezoidal rule up to round-off.

    Parameters
    ----------
    parameters : array of shape (2·z,)
        â, b̂.
    inputs : tuple of arrays
        See :class:`~pcnde_bridge.engines.protocol.Engine`.
    grid : tuple
        Points, cm, and period, s.
    config : PCNDEConfig
        Settings with the number of cycles.

    Returns
    -------
    array of shape (case, cycles·time, z)
        Ŝ, cm².
    """
    (flow, area_undeformed), (z, period) = inputs, grid
    n_times, cycles = flow.shape[1], config.intermediate_area.cycles
    a, b = jnp.split(parameters, 2)
    step = period / n_times
    slope = flow_slope(flow, z)
    trapezoids = step * (slope + jnp.roll(slope, -1, axis=1)) / 2
    until = jnp.cumsum(trapezoids, axis=1)
    one_cycle = jnp.concatenate([jnp.zeros_like(until[:, :1]), until[:, :-1]], axis=1)
    per_cycle = until[:, -1:]
    integral = jnp.concatenate([one_cycle + k * per_cycle for k in range(cycles)], axis=1)
    elapsed = step * jnp.arange(cycles * n_times)
    return area_undeformed[:, None] - a * integral + b * elapsed[:, None]


def fourier(
    parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
) -> jax.Array:
    """Return the periodic S with S_n = −a/(iω_n) ∂Q_n/∂z and S₀ = Ŝ(t=0) − Σ S_n + b.

    Parameters
    ----------
    parameters : array of shape (2·z,)
        a, b.
    inputs : tuple of arrays
        See :class:`~pcnde_bridge.engines.protocol.Engine`.
    grid : tuple
        Points, cm, and period, s.
    config : PCNDEConfig
        Number of terms, and the published code's variants.

    Returns
    -------
    array of shape (case, time, z)
        S, cm².
    """
    (flow, initial_area), (z, period) = inputs, grid
    a, b = jnp.split(parameters, 2)
    analysis, synthesis = fourier_integral(flow.shape[1], config.fourier_area)
    coefficients = jnp.einsum("kt,ntz->nkz", analysis, flow)
    integral = period * jnp.einsum("tk,nkz->ntz", synthesis, flow_slope(coefficients, z))
    # S − S₀ is zero at the first time point, where S is the anchor plus b.
    return initial_area[:, None] - a * (integral - integral[:, :1]) + b


def fourier_integral(n_times: int, stage: FourierAreaStage) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices that integrate a periodic signal in time by its Fourier series.

    Returns
    -------
    analysis : array of shape (2·(terms − 1), time)
        Maps the signal to the cosine and sine parts of its harmonics.
    synthesis : array of shape (time, 2·(terms − 1))
        Maps these to the integral of the signal without its mean, divided by the period.
    """
    harmonics = np.arange(1, stage.terms)[:, None]
    angle = 2 * np.pi * harmonics * np.arange(n_times) / n_times
    analysis = np.concatenate([np.cos(angle), np.sin(angle)]) / n_times
    divisor = 2 * np.pi * (harmonics + (1 if stage.frequency == "next" else 0))
    sides = 2 if stage.sides == "two" else 1
    # Q_n = c − i·s, so the real part of Q_n·exp(iωt)/(iω) is (c·sin ωt − s·cos ωt)/ω.
    synthesis = sides * np.concatenate([np.sin(angle) / divisor, -np.cos(angle) / divisor])
    return analysis, synthesis.T
