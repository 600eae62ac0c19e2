r"""Coupling of flow, area and pressure: a spatial differential equation for Q of one case.

    ∂Q/∂z = −κ·(1 − g)·∂S/∂t,    Q(z₀, t) = Q_in(t),
    S     = π·(r_u + u_r[p])²,                           (wall)
    p     = p_d + 𝒵 Q(L) + losses[Q],                    (outlet, losses)

periodic in time.  With κ = 1 and g = 0 it is continuity.  The trained g
(:mod:`~pcnde_bridge.engines.jax.closures.correction`) is a function of the response of
the passive linear tube, which depends on the inflow alone: the equation with g = 0 and the
trained κ, without the losses and the square in S, is linear in Q.

The wall is linear in p, and the losses are a sum of a few products of functions of z and
of t.  The integrals over z are therefore computed once for each vessel, exactly on its grid,
and the only unknown is the outlet flow y = Q(L), or the stored inflow d = Q_in − y:

    e·d = κ·∂V/∂t,    e(t) = 1/(1 − g),

with the volume V(t) of the vessel, a function of P = 𝒵y + p_d − p₀ and of the losses.
Each coupling pass solves the part that is linear with constant coefficients, harmonic by
harmonic, for the remainder of the previous pass:

    (ē + κ·A(ω))·Δy = e·d − κ·∂V/∂t,

where A(ω) is ∂V/∂t of a small y about the mean flow and pressure, and ē is halfway between the
mean of e and the middle of its range, which needs fewer passes than either.
"""

from collections.abc import Callable
from functools import reduce
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge.config.settings import CorrectionClosure, Physics
from pcnde_bridge.engines.jax.closures import pressure_losses as losses
from pcnde_bridge.engines.jax.closures import wall_shear_stress
from pcnde_bridge.engines.jax.closures.correction import hidden_share, storage_factor
from pcnde_bridge.engines.jax.closures.integrals import from_inlet
from pcnde_bridge.engines.jax.closures.wall import displacement
from pcnde_bridge.engines.shared_terms import spectral_derivative

_Signals = tuple[jax.Array, ...]
"""Functions of time."""

_Pass = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""Harmonics of Q(L), bounds of the last two changes of Q(L), and number of passes."""


class VesselModes(NamedTuple):
    """Functions of z of one vessel, which sum up to flow, area, pressure and wall shear stress.

    They are the factors of the functions of time of :class:`Coupled`, with k = 18 modes of the
    losses.

    Attributes
    ----------
    flow : array of shape (3 + k, z)
        1, and the volume before z for P, for P² and for the modes.
    area : array of shape (3 + k, z)
        Area for P², for 1, for P and for the modes: (r_u + u_r)² without the products of modes.
    pressure : array of shape (2 + k, z)
        p₀, 1 and the losses' functions of z.
    shear : array of shape (k, z)
        Wall shear stress for the modes.
    flow_slope, area_slope : array of shape (k, z)
        Increase of the modes' rows of flow and area with the mean of P.
    reference_flow : scalar
        Q₀ of the losses, mL/s.
    """

    flow: jax.Array
    area: jax.Array
    pressure: jax.Array
    shear: jax.Array
    flow_slope: jax.Array
    area_slope: jax.Array
    reference_flow: jax.Array


class Coupled(NamedTuple):
    """Converged functions of time of one case; k as in :class:`VesselModes`.

    Attributes
    ----------
    flow : array of shape (3 + k, time)
        Factors of the flow: Q_in, and −κ(1 − g)·∂_t of P = p(L) − p₀, of P² and of the modes.
    area : array of shape (3 + k, time)
        Factors of the area: P², 1, P and the modes; all but the first are those of the pressure.
    mean_pressure : scalar
        Mean of P for the mean inflow.
    change : scalar
        Upper bound of the change of Q(L) in the last pass, mL/s.
    reverses : scalar
        Whether flow reverses anywhere; otherwise the last eight modes are zero.
    """

    flow: jax.Array
    area: jax.Array
    mean_pressure: jax.Array
    change: jax.Array
    reverses: jax.Array


def vessel_modes(
    wall: jax.Array,
    loss: jax.Array,
    shear: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    law: Literal["membrane", "local", "auto"],
    physics: Physics,
) -> tuple[VesselModes, wall_shear_stress.Terms]:
    """Integrate wall and losses along one vessel, S_u (z,), with the terms of its shear."""
    radius = jnp.sqrt(area_undeformed / jnp.pi)
    uniform = displacement(wall, jnp.ones((1, z.size)), area_undeformed, z, law)[0]
    per_pressure = 2 * jnp.pi * radius * uniform
    first = from_inlet(per_pressure, z)
    coefficients, marched = losses.coefficients(loss, area_undeformed, z, physics)
    share = first / first[-1]
    pressure = losses.modes_in_space(coefficients, share, z)
    terms = wall_shear_stress.terms(marched, physics)
    moved = displacement(wall, pressure, area_undeformed, z, law)
    square = jnp.pi * uniform**2
    one = jnp.ones_like(z)
    area = 2 * jnp.pi * radius * moved
    slope = 2 * jnp.pi * uniform * moved
    modes = VesselModes(
        jnp.stack([one, first, from_inlet(square, z), *from_inlet(area, z)]),
        jnp.stack([square, area_undeformed, per_pressure, *area]),
        jnp.stack([wall[-1] * one, one, *pressure]),
        wall_shear_stress.modes_in_space(shear, terms, share),
        from_inlet(slope, z),
        slope,
        coefficients.reference_flow,
    )
    return modes, terms


def couple(
    outlet: jax.Array,
    wall: jax.Array,
    correction: jax.Array,
    shift: jax.Array,
    inflow: jax.Array,
    flow: jax.Array,
    flow_slope: jax.Array,
    reference_flow: jax.Array,
    period: jax.Array,
    settings: CorrectionClosure,
    tolerance: float | None = None,
) -> Coupled:
    """Find the outlet flow, and with it all functions of time.

    Parameters
    ----------
    outlet : array of shape (2, harmonic)
        𝒵, dyn·s/cm⁵, and harmonics of p_d, dyn/cm².
    wall, correction : arrays
        Parameters.
    shift : scalar
        See :func:`~pcnde_bridge.engines.jax.closures.correction.hidden_share`.
    inflow : array of shape (time,)
        Q_in, mL/s.
    flow, flow_slope : array of shape (3 + k,) and (k,)
        :class:`VesselModes` of this case at the outlet.
    reference_flow : scalar
        Q₀ of the losses, mL/s.
    period : scalar
        s.
    settings : CorrectionClosure
        Hidden layers of the correction, and number of coupling passes.
    tolerance : float, optional
        The passes end once the next change of Q(L), if it shrinks as the last one did, is
        smaller, relative to the largest inflow.  By default all are run, as derivatives require.
    """
    n_times = inflow.shape[0]
    i_omega = spectral_derivative(n_times, period, jnp)
    with_rates = jnp.stack([jnp.ones_like(i_omega), i_omega, i_omega**2])
    with_rate = outlet[0] * with_rates[:2]
    # P is relative to the wall's reference pressure.
    source = with_rates[:2] * outlet[1].at[0].add(-n_times * wall[-1])
    kappa = storage_factor(correction)
    inflow_harmonics = jnp.fft.rfft(inflow)
    mean_flow = jnp.mean(inflow)

    def signals(harmonics: jax.Array) -> jax.Array:
        return jnp.fft.irfft(harmonics, n=n_times)

    mean_pressure = outlet[0, 0].real * mean_flow + source[0, 0].real / n_times
    total = jnp.concatenate([flow[1:3], flow[3:] + mean_pressure * flow_slope])
    filling = kappa * total[0]
    passive = (inflow_harmonics - filling * source[1]) / (1 + filling * with_rate[1])
    passive_rate = with_rate[1] * passive + source[1]
    passive_flow, passive_rate = signals(jnp.stack([passive, passive_rate]))
    g = hidden_share(correction, passive_rate, passive_flow, shift, settings.hidden)
    shown = 1 / (1 - g)
    linear = _linear_filling(
        total, with_rate[1], i_omega, mean_flow / reference_flow, reference_flow, mean_pressure
    )
    middle = (jnp.max(shown) + jnp.min(shown)) / 2
    solve = 1 / ((jnp.mean(shown) + middle) / 2 + kappa * linear)

    def state(harmonics: jax.Array) -> tuple[_Signals, _Signals, _Signals]:
        """Return d with its rates, P and the modes, and ∂/∂t of P, P² and the modes."""
        found = signals(
            jnp.concatenate(
                [with_rates * (inflow_harmonics - harmonics), with_rate * harmonics + source]
            )
        )
        stored, (p, p_rate) = tuple(found[:3]), tuple(found[3:])
        modes, mode_rates = losses.modes_in_time(tuple(inflow_signals), stored, reference_flow)
        return stored, (p, *modes), (p_rate, 2 * p * p_rate, *mode_rates)

    def one_pass(harmonics: jax.Array) -> jax.Array:
        stored, _, rates = state(harmonics)
        filling = reduce(jnp.add, (v * r for v, r in zip(total, rates, strict=True)))
        return solve * jnp.fft.rfft(shown * stored[0] - kappa * filling)

    inflow_signals = signals(with_rates * inflow_harmonics).at[0].set(inflow)
    settled = None if tolerance is None else tolerance * jnp.max(jnp.abs(inflow))
    harmonics, change = _iterate(one_pass, passive, n_times, settings.passes, settled)
    stored, (p, *modes), rates = state(harmonics)
    return Coupled(
        jnp.concatenate([inflow[None], -kappa * (1 - g) * jnp.stack(rates)]),
        jnp.stack([p**2, jnp.ones_like(p), p, *modes]),
        mean_pressure,
        change,
        ~jnp.all(losses.goes_forward(inflow_signals[0], stored[0])),
    )


def _linear_filling(
    total: jax.Array,
    pressure_rate: jax.Array,
    i_omega: jax.Array,
    mean_flow: jax.Array,
    reference_flow: jax.Array,
    mean_pressure: jax.Array,
) -> jax.Array:
    """Return A(ω) from the volumes of P, P² and the modes, and from iω·𝒵(ω).

    ``mean_flow`` is relative to the reference flow.
    """
    stored, modes = total[3], total[4:].reshape(2, losses.DIRECTED)
    size, forward = jnp.abs(mean_flow), mean_flow >= 0
    # The modes that contain −y: d, f'(q)·d, q·d and ∂d/∂t.
    directed = jnp.where(forward, modes[0], -modes[1])
    slope = losses.rational_slope(size)
    linear = (directed[1] + slope * directed[3] + size * directed[5]) / reference_flow
    return pressure_rate * (total[0] + 2 * mean_pressure * total[1]) - i_omega * (
        linear + i_omega * stored
    )


def _iterate(
    one_pass: Callable[[jax.Array], jax.Array],
    passive: jax.Array,
    n_times: int,
    passes: int,
    settled: jax.Array | None,
) -> tuple[jax.Array, jax.Array]:
    """Run coupling passes from the passive tube: harmonics of Q(L), bound of the last change.

    ``settled`` is the change, mL/s, below which the passes end; without it all are run.
    """
    # All harmonics but the mean and the Nyquist harmonic occur twice.
    share = jnp.where(2 * jnp.arange(passive.size) % n_times == 0, 1, 2) / n_times

    def advance(before: _Pass) -> _Pass:
        harmonics, last_change, _, number = before
        change = one_pass(harmonics)
        # No signal exceeds the sum of its harmonics' amplitudes.
        largest = jnp.sum(share * jnp.abs(change))
        return harmonics + change, largest, last_change, number + 1

    # An array of the case, with a derivative: constants would be traced once more for each.
    zero = 0 * jnp.abs(passive[0])
    first = passive, zero, zero, jnp.zeros((), dtype=int)
    if settled is None:
        last = jax.lax.fori_loop(0, passes, lambda _, before: advance(before), first)
        return last[0], last[1]

    def continues(last: _Pass) -> jax.Array:
        _, change, before, number = last
        unsettled: jax.Array = change**2 > settled * jnp.maximum(change, before)
        return (number < passes) & ((number == 0) | unsettled)

    last = jax.lax.while_loop(continues, advance, first)
    return last[0], last[1]
