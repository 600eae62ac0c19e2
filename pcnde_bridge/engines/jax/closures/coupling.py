r"""Flow, area and pressure of one case, coupled: a spatial differential equation for Q.

    ∂Q/∂z = −κ·(1 − g)·∂S/∂t,    Q(z₀, t) = Q_in(t),
    S     = π·(r_u + u_r[p])²,                           (wall)
    p     = p_d + 𝒵 Q(L) + losses[Q],                    (outlet, losses)

periodic in time.  Continuity with κ = 1 and g = 0 is the passive tube.  The learned g
(:mod:`~pcnde_bridge.engines.jax.closures.correction`) is a function of the response of
the passive linear tube, which follows from the inflow alone: the equation is linear in Q
up to the losses and the square in S.

The wall is linear in p and the losses are a sum of few products of functions of z and
of t, so that the integrals over z are done once for each vessel, exactly on its grid,
and only the outlet flow y = Q(L) is sought.  Each coupling pass takes all but the
largest, linear part from the pass before it and solves that part harmonic by harmonic:

    y·(1 + κ·V₀·iω·𝒵(ω)) = Q_in − κ·∂_t[V − V₀·P] + κ·g·∂_t V,

with the volume V(t) of the vessel, P = 𝒵y + p_d − p₀, and V₀·P the part of V that a
uniform pressure gives to first order.
"""

from __future__ import annotations

from functools import reduce
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge.config import CorrectionClosure, Physics
from pcnde_bridge.engines.jax.closures import losses
from pcnde_bridge.engines.jax.closures.correction import hidden_share, storage_factor
from pcnde_bridge.engines.jax.closures.quadrature import frequencies, from_inlet
from pcnde_bridge.engines.jax.closures.wall import displacement


class VesselModes(NamedTuple):
    """What of a vessel does not depend on the flow; k = 10 modes of the losses.

    Attributes
    ----------
    radius, uniform : array of shape (z,)
        r_u, cm, and the displacement under a pressure of 1 dyn/cm² everywhere.
    pressure, moved : array of shape (k, z)
        The losses' functions of z, and the displacements under them.
    volume : array of shape (2 + k, z)
        Volume before z that belongs to P, to P² and to the modes.
    volume_slope : array of shape (k, z)
        What the mean of P adds to the modes' volume.
    """

    radius: jax.Array
    uniform: jax.Array
    pressure: jax.Array
    moved: jax.Array
    volume: jax.Array
    volume_slope: jax.Array


class Coupled(NamedTuple):
    """The converged functions of time of one case.

    Attributes
    ----------
    outlet_pressure : array of shape (time,)
        P = p(L) − p₀, dyn/cm².
    mean_pressure : scalar
        The mean of P that the inflow gives.
    modes : array of shape (k, time)
        The losses' functions of time.
    volume : array of shape (2 + k, z)
        :attr:`VesselModes.volume` at this mean pressure.
    storage : array of shape (2 + k, time)
        −κ(1 − g)·∂_t of P, P² and the modes: Q = Q_in + Σ storage·volume.
    change : scalar
        Largest change of Q(L) in the last pass, mL/s.
    """

    outlet_pressure: jax.Array
    mean_pressure: jax.Array
    modes: jax.Array
    volume: jax.Array
    storage: jax.Array
    change: jax.Array


def vessel_modes(
    wall: jax.Array,
    loss: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    law: Literal["membrane", "local", "auto"],
    physics: Physics,
) -> VesselModes:
    """Integrate wall and losses along one vessel, S_u (z,)."""
    radius = jnp.sqrt(area_undeformed / jnp.pi)
    uniform = displacement(wall, jnp.ones((1, z.size)), area_undeformed, z, law)[0]
    first = from_inlet(2 * jnp.pi * radius * uniform, z)
    coefficients = losses.coefficients(loss, area_undeformed, z, physics)
    pressure = losses.modes_in_space(coefficients, first / first[-1], z)
    moved = displacement(wall, pressure, area_undeformed, z, law)
    second = from_inlet(jnp.pi * uniform**2, z)
    volume = jnp.concatenate(
        [jnp.stack([first, second]), from_inlet(2 * jnp.pi * radius * moved, z)]
    )
    slope = from_inlet(2 * jnp.pi * uniform * moved, z)
    return VesselModes(radius, uniform, pressure, moved, volume, slope)


def impedance(outlet: jax.Array, omega: jax.Array) -> jax.Array:
    """𝒵(ω) = R₁ + R₂/(1 + iωR₂C) of the outlet (R₁, R₂, C, p_d), dyn·s/cm⁵."""
    r1, r2, compliance, _ = outlet
    z: jax.Array = r1 + r2 / (1 + 1j * omega * r2 * compliance)
    return z


def couple(
    outlet: jax.Array,
    wall: jax.Array,
    correction: jax.Array,
    shift: jax.Array,
    vessel: VesselModes,
    inflow: jax.Array,
    period: jax.Array,
    settings: CorrectionClosure,
) -> Coupled:
    """Find the outlet flow, and all functions of time with it.

    Parameters
    ----------
    outlet, wall, correction : arrays
        Parameters.
    shift : scalar
        See :func:`~pcnde_bridge.engines.jax.closures.correction.hidden_share`.
    vessel : VesselModes
        Of this case.
    inflow : array of shape (time,)
        Q_in, mL/s.
    period : scalar
        s.
    settings : CorrectionClosure
        Hidden layers of the correction and number of coupling passes.
    """
    n_times = inflow.shape[0]
    omega = frequencies(n_times, period)
    z_outlet = impedance(outlet, omega)
    kappa = storage_factor(correction)
    inflow_harmonics = jnp.fft.rfft(inflow)

    def signal(harmonics: jax.Array) -> jax.Array:
        return jnp.fft.irfft(harmonics, n=n_times)

    def with_rates(harmonics: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        first = 1j * omega * harmonics
        return signal(harmonics), signal(first), signal(1j * omega * first)

    offset = outlet[3] - wall[-1]
    mean_pressure = z_outlet[0].real * jnp.mean(inflow) + offset
    volume = vessel.volume.at[2:].add(mean_pressure * vessel.volume_slope)
    total = volume[:, -1]
    solve = 1 / (1 + kappa * total[0] * 1j * omega * z_outlet)

    passive = solve * inflow_harmonics
    passive_rate = signal(1j * omega * z_outlet * passive)
    g = hidden_share(correction, passive_rate, signal(passive), shift, settings.hidden)

    def state(harmonics: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """P, the losses' functions of time, and the rates of P, P² and those."""
        stored = with_rates(inflow_harmonics - harmonics)
        modes, mode_rates = losses.modes_in_time(inflow_with_rates, stored)
        pressure = signal(z_outlet * harmonics) + offset
        pressure_rate = signal(1j * omega * z_outlet * harmonics)
        first = jnp.stack([pressure_rate, 2 * pressure * pressure_rate])
        return pressure, modes, jnp.concatenate([first, mode_rates])

    def one_pass(_: int, harmonics: jax.Array) -> jax.Array:
        rates = state(harmonics)[2]
        rest = total[1:] @ rates[1:]
        hidden = g * (total[0] * rates[0] + rest)
        after: jax.Array = solve * (inflow_harmonics - kappa * jnp.fft.rfft(rest - hidden))
        return after

    inflow_with_rates = with_rates(inflow_harmonics)
    before = jax.lax.fori_loop(0, settings.passes - 1, one_pass, passive)
    harmonics = one_pass(0, before)
    change = jnp.max(jnp.abs(signal(harmonics - before)))
    pressure, modes, rates = state(harmonics)
    storage = -kappa * (1 - g) * rates
    return Coupled(pressure, mean_pressure, modes, volume, storage, change)


def fields(
    coupled: Coupled,
    vessel: VesselModes,
    wall: jax.Array,
    inflow: jax.Array,
    reverses: bool = True,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Flow (mL/s), area (cm²) and pressure (dyn/cm²) of one case, each (time, z).

    The area keeps of the square (r_u + u_r)² what the volume keeps: all of the
    uniform pressure's displacement, and of the losses' the product with the rest
    at its mean pressure.  Where no flow ``reverses``, the last modes are zero.
    """
    modes = slice(None if reverses else -losses.N_SQUARES)
    p = coupled.outlet_pressure
    mean_radius = vessel.radius + vessel.uniform * coupled.mean_pressure
    squared = (vessel.radius + vessel.uniform * p[:, None]) ** 2
    area = jnp.pi * (
        squared + _products(coupled.modes[modes], 2 * mean_radius * vessel.moved[modes])
    )
    flow = inflow[:, None] + _products(coupled.storage[modes], coupled.volume[modes])
    pressure = (p + wall[-1])[:, None] + _products(coupled.modes[modes], vessel.pressure[modes])
    return flow, area, pressure


def _products(in_time: jax.Array, in_space: jax.Array) -> jax.Array:
    """Σ_k T_k(t)·Z_k(z), (time, z): few terms, which one fused loop adds up."""
    terms = (t[:, None] * z for t, z in zip(in_time, in_space, strict=True))
    total: jax.Array = reduce(jnp.add, terms)
    return total
