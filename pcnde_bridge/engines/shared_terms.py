"""Terms of the equations that training and engines share; they take NumPy and JAX arrays alike.

The argument ``xp`` is the module of the arrays: ``numpy`` or ``jax.numpy``.
"""

from typing import Any

import numpy as np

from pcnde_bridge.config.settings import PCNDEConfig, Physics
from pcnde_bridge.hemodynamics.pressure_losses import pressure_drop

STEEPNESS = 10.0
"""Factor in the argument of the spatial pressure's tanh, 1/cm."""


def pressure_scale(area_undeformed: Any, physics: Physics, xp: Any = np) -> Any:
    """Return E·h/(r₀·p_ref) of every case, (case,), from S_u (case, z), cm²."""
    radius = xp.sqrt(area_undeformed[:, 0] / xp.pi)
    stiffness = physics.young_modulus * physics.wall_thickness / radius
    return stiffness / physics.reference_pressure


def stenosis_drop(flow: Any, area_undeformed: Any, coefficient: Any, physics: Physics) -> Any:
    """Return Δp of Seeley and Young, dyn/cm².

    Parameters
    ----------
    flow : array
        Q, mL/s.
    area_undeformed : array of shape (..., z)
        S_u, cm²; the area of the healthy vessel is the first point's.  With its last axis of
        length one it must broadcast with the flow.
    coefficient : float or array
        K_t.
    physics : Physics
        Constants.
    """
    return pressure_drop(
        flow,
        area_undeformed[..., :1],
        area_undeformed.min(axis=-1, keepdims=True),
        physics.stenosis_length,
        density=physics.density,
        viscosity=physics.viscosity,
        turbulent_coefficient=coefficient,
    )


def network_drop(flow: Any, area_undeformed: Any, config: PCNDEConfig) -> Any:
    """Return Δp (case, time, z) as the pressure network's input, from Q and S_u (case, z)."""
    physics = config.physics
    drop = stenosis_drop(flow, area_undeformed[:, None], physics.turbulent_coefficient, physics)
    if config.temporal_pressure.pressure_drop_input == "normalized":
        drop = drop / physics.reference_pressure
    return drop


def network_inputs(
    flow: Any, area: Any, area_undeformed: Any, config: PCNDEConfig, xp: Any = np
) -> Any:
    """Return the pressure network's inputs S, S − S_u, Δp and Q at all points, (case, time, 4·z).

    Parameters
    ----------
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    area_undeformed : array of shape (case, z)
        S_u, cm².
    config : PCNDEConfig
        Constants, and the unit of Δp.
    """
    drop = network_drop(flow, area_undeformed, config)
    return xp.concatenate([area, area - area_undeformed[:, None], drop, flow], axis=2)


def flow_at_stenosis(flow: Any, z: Any, physics: Physics, xp: Any = np) -> Any:
    """Interpolate Q (case, time, z) linearly to the stenosis, (case, time)."""
    position = physics.stenosis_position
    after = xp.clip(xp.searchsorted(z, position), 1, z.shape[0] - 1)
    share = (position - z[after - 1]) / (z[after] - z[after - 1])
    return (1 - share) * flow[:, :, after - 1] + share * flow[:, :, after]


def step_profile(z: Any, config: PCNDEConfig, xp: Any = np) -> tuple[Any, Any]:
    """Return the height and the distance of the spatial pressure's step, both (z,).

    The step is σ(t, z) = height·tanh(STEEPNESS·b₂(t)·distance): constant up to L/3 and from
    2L/3.  The paper prints it with the height 0 up to L/3 and 1 behind; the continuous form
    has the height 1/2 everywhere.
    """
    start, third = z[0], (z[-1] - z[0]) / 3
    distance = xp.clip(z, start + third, start + 2 * third) - config.physics.stenosis_position
    if config.spatial_pressure.form == "printed":
        return xp.where(z <= start + third, 0.0, 1.0), distance
    return xp.full(z.shape, 0.5), distance


def harmonic_frequencies(n_times: int, period: Any, xp: Any = np) -> Any:
    """Return ω of the harmonics of a real periodic signal, rad/s, (n_times // 2 + 1,)."""
    return 2 * xp.pi * xp.arange(n_times // 2 + 1) / period


def spectral_derivative(n_times: int, period: Any, xp: Any = np) -> Any:
    """Return iω, rad/s, but 0 for the Nyquist harmonic, whose slope is 0 at the time points."""
    harmonic = xp.arange(n_times // 2 + 1)
    return xp.where(2 * harmonic == n_times, 0.0, 1j * harmonic_frequencies(n_times, period, xp))


def rate(signal: Any, period: Any, xp: Any = np) -> Any:
    """Return ∂f/∂t of a periodic signal (..., time), exact for its Fourier series."""
    n_times = signal.shape[-1]
    factor = spectral_derivative(n_times, period, xp)
    return xp.fft.irfft(factor * xp.fft.rfft(signal), n=n_times)
