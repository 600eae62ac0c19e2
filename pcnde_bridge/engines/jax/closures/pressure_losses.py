r"""Pressure difference between a point and the outlet, from the momentum of the flow.

A boundary layer develops through every narrowing, and a jet behind it
(:mod:`~pcnde_bridge.engines.jax.closures.boundary_layer`).  Along an interval Δz the pressure of a
steady flow Q falls by

    c_c·ρ/2·Δ(U²) + φ·Δz,    U = Q/(S_u·m(d)),    where the flow fills a narrowing vessel,
    c_j·ρ·Q²/S_u·Δ(1/A_j) + φ·Δz                  elsewhere,

with the friction

    φ = f·c_f·4μU·d⁶/r_u² + (1 − f)·c_s·8πμQ/S_u²,    f = β·A_j/S_u,

which in a straight vessel is c_f times Poiseuille's.  The two lines are weighted with the share n
of the interval in which the vessel narrows, times f⁸, and the rest: nothing jumps where
the flow separates, and the drop does not depend on the position of the points.  For
a sudden expansion the second line is the loss of Borda and Carnot, and the pressure drop that is
not recovered has the form of Seeley and Young's turbulent term.  For reversed flow the vessel
is mirrored.

The drop is computed at three Reynolds numbers, and interpolated by

    D(z, Q) = D₁(z)·x + D₂(z)·x²/(1 + x) + D₃(z)·x²,    x = |Q|/Q₀,

where Q₀ has a Reynolds number of 60.  An unsteady flow adds c_i·ρ/S_u·∂Q/∂t per length, and the
lag of the jet, whose fluid left the throat earlier:

    −2λ·ρ/S_u·∂Q/∂t·Δ[(1/A_j − β/S_u)·∫A_j dz],

integrated from the beginning of each jet, at the second Reynolds number.

With the flow Q = q − ξ(z)·d, where q(t) is the inflow, d(t) = q − Q(L) the flow stored by the
wall and ξ(z) the share of the storage before z, the pressure is a sum of products of a function of
z and a function of t.  In the second term of D only the first order in d is included, and in the
jet's lag ∂Q/∂t is that of the inflow.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge.config.settings import Physics
from pcnde_bridge.engines.jax.closures.boundary_layer import along_vessel, mean_speed
from pcnde_bridge.engines.jax.closures.integrals import summed_from_inlet, to_outlet

_Signals = tuple[jax.Array, ...]
"""Functions of time."""

_REYNOLDS = 60.0
"""Reynolds number 2Q/(πνr) of Q₀; πr² is the mean of the inlet and outlet areas."""

_FLOWS = np.array([0.5, 2.0, 8.0])
"""Flows at which the steady drop is computed, over Q₀."""

_TO_FACTORS = np.linalg.inv(np.stack([_FLOWS, _FLOWS**2 / (1 + _FLOWS), _FLOWS**2], axis=1))
"""Matrix (3, 3) from the drops at these flows to D₁, D₂, D₃."""

_FILLED_POWER = 8
"""Power of the filled share that weights the acceleration of the core."""

_STRAIGHT = 1e-3
"""Slope r/S_u·dS_u/dz below which a vessel counts as straight."""

_FACTORS, _NUMBERS, _POWERS = np.array(
    [
        (0, 1, 0),
        (0, -1, 1),
        (1, 1, 0),
        (1, -1, 1),
        (2, 1, 0),
        (2, -2, 1),
        (2, 1, 2),
        (3, 1, 0),
    ]
).T
"""Modes of one direction in space: a factor of :class:`Coefficients`, a number, a power of ξ."""

DIRECTED = len(_FACTORS)
"""Number of modes of one direction; the last ones are zero without reversed flow."""


class Coefficients(NamedTuple):
    """Coefficients of the pressure losses of a vessel, or of several.

    Attributes
    ----------
    reference_flow : array of shape (...)
        Q₀, mL/s.
    inertia : array of shape (..., z)
        Factor of ∂Q/∂t, per length.
    forward, back : array of shape (..., 4, z − 1)
        D₁, D₂, D₃ and the factor of ∂Q/∂t of the jet's lag, integrated over each interval, for
        Q > 0 and, with the sign of a drop in the direction of z, for Q < 0.
    """

    reference_flow: jax.Array
    inertia: jax.Array
    forward: jax.Array
    back: jax.Array


class Marched(NamedTuple):
    """Layer and jet in the direction of z, and in the mirrored vessel.

    Attributes
    ----------
    area, z : arrays of shape (..., 2, 1, z) and (2, 1, z)
        S_u, cm², and the points, cm.
    flow : array of shape (..., 1, 3, 1)
        Flows Q at which the steady drop is computed, mL/s.
    layer, jet : arrays of shape (..., 2, 3, z)
        d, and S_u/(β·A_j), which is 1 where the flow fills the vessel.
    """

    area: jax.Array
    z: jax.Array
    flow: jax.Array
    layer: jax.Array
    jet: jax.Array


class _Parameters(NamedTuple):
    """Parameters of the losses in the order of their vector."""

    friction: jax.Array
    inertia: jax.Array
    core: jax.Array
    layer_growth: jax.Array
    jet_momentum: jax.Array
    jet_recovery: jax.Array
    jet_friction: jax.Array
    jet_spread: jax.Array
    jet_viscous_spread: jax.Array
    jet_lag: jax.Array


def coefficients(
    parameters: jax.Array, area_undeformed: jax.Array, z: jax.Array, physics: Physics
) -> tuple[Coefficients, Marched]:
    """Compute the coefficients of one vessel, or of several.

    Parameters
    ----------
    parameters : array of shape (10,)
        c_f, c_i, c_c, c_g, β, c_j, c_s, s, s_ν and λ.
    area_undeformed : array of shape (..., z)
        S_u, cm².
    z : array of shape (z,)
        Points, cm.
    physics : Physics
        ρ and μ.
    """
    p = _Parameters(*parameters)
    kinematic = jnp.pi * physics.viscosity / physics.density
    radius = jnp.sqrt((area_undeformed[..., 0] + area_undeformed[..., -1]) / (2 * jnp.pi))
    reference = _REYNOLDS / 2 * kinematic * radius
    area = jnp.stack([area_undeformed, area_undeformed[..., ::-1]], axis=-2)
    both = area, jnp.stack([z, z[-1] - z[::-1]])
    drops, marched = _directed(p, *both, reference[..., None, None] * _FLOWS, physics)
    inertia = p.inertia * physics.density / area_undeformed
    forward, back = drops[..., 0, :, :], -drops[..., 1, :, ::-1]
    return Coefficients(reference, inertia, forward, back), marched


def _directed(
    p: _Parameters, area: jax.Array, z: jax.Array, flow: jax.Array, physics: Physics
) -> tuple[jax.Array, Marched]:
    """Return the drops of flows in the direction of z over each interval, (..., 4, z − 1)."""
    density, viscosity = physics.density, physics.viscosity
    layer, jet, volume = along_vessel(
        area,
        z,
        jnp.pi * viscosity / density / flow,
        p.layer_growth,
        p.jet_momentum,
        p.jet_spread,
        p.jet_viscous_spread,
    )
    area, z, flow = area[..., None, :], z[..., None, :], flow[..., None]
    steps = jnp.diff(z)
    core = flow / (area * mean_speed(layer))
    attached = p.friction * 4 * jnp.pi * viscosity * core * layer**6 / area
    separated = p.jet_friction * 8 * jnp.pi * viscosity * flow / area**2
    filled = p.jet_momentum * jet / area
    friction = _middle(filled * attached + (1 - filled) * separated) * steps
    # With this mean the intervals that the flow fills add up to the change of 1/(2·S_u²) exactly.
    per_area = density * _middle(1 / area)
    accelerated = p.core * density / 2 * jnp.diff(core**2)
    mixed = p.jet_recovery * flow**2 * per_area * jnp.diff(1 / jet)
    narrows = _narrowing_share(area, z) * _middle(filled) ** _FILLED_POWER
    factors = to_factors(narrows * accelerated + (1 - narrows) * mixed + friction)
    lag = (1 / jet - p.jet_momentum / area) * volume
    # The lag is computed at the second flow.
    lagging = -2 * p.jet_lag * (per_area * jnp.diff(lag))[..., 1:2, :]
    drops = jnp.concatenate([factors, lagging], axis=-2)
    return drops, Marched(area, z, flow, layer, area / (p.jet_momentum * jet))


def _narrowing_share(area: jax.Array, z: jax.Array) -> jax.Array:
    """Return n, the share of each interval, (..., z − 1), in which the vessel narrows."""
    slope = (area[..., 2:] - area[..., :-2]) / (z[..., 2:] - z[..., :-2])
    slope = jnp.pad(slope, [(0, 0)] * (slope.ndim - 1) + [(1, 1)])
    falls, rises = (2 * _middle(jnp.maximum(sign * slope, 0)) for sign in (-1, 1))
    straight = _STRAIGHT * _middle(jnp.sqrt(jnp.pi * area))
    steep = falls + rises
    return falls * steep / (steep**2 + straight**2)


def to_factors(of_flows: jax.Array) -> jax.Array:
    """Return the factors of :func:`steady` from values at the three flows, (..., 3, z)."""
    return jnp.matmul(_TO_FACTORS, of_flows)


def _middle(values: jax.Array) -> jax.Array:
    """Return the mean of neighboring points, (..., z − 1)."""
    return (values[..., 1:] + values[..., :-1]) / 2


def steady(flow: jax.Array) -> _Signals:
    """Return x, x²/(1 + x) and x² of x = |Q|/Q₀."""
    return flow, flow**2 / (1 + flow), flow**2


def drop(c: Coefficients, flow: jax.Array, flow_rate: jax.Array, z: jax.Array) -> jax.Array:
    """Return p − p(L), (time, z), of a given flow Q and its rate, both (time, z)."""
    x = _middle(flow) / c.reference_flow
    functions = jnp.stack([*steady(jnp.abs(x)), jnp.sign(x) * _middle(flow_rate)])
    factors = jnp.where(x > 0, c.forward[:, None], c.back[:, None])
    inertia = _middle(c.inertia * flow_rate) * jnp.diff(z)
    summed = summed_from_inlet(jnp.sum(factors * functions, axis=0) + inertia)
    return summed[:, -1:] - summed


def modes_in_space(c: Coefficients, share: jax.Array, z: jax.Array) -> jax.Array:
    """Return the functions of z, (18, z), for :func:`modes_in_time`; ``share`` (z,) is ξ."""
    inertia = (to_outlet(f, z) for f in (c.inertia, -c.inertia * share))
    directed = summed_from_inlet(directed_modes(c.forward, c.back, _middle(share)))
    return jnp.stack([*inertia, *(directed[:, -1:] - directed)])


def directed_modes(forward: jax.Array, back: jax.Array, share: jax.Array) -> jax.Array:
    """Return the functions of z of both directions, (16, z), from the factors (4, z) of each."""
    powers = jnp.stack([jnp.ones_like(share), share, share**2])
    products = _NUMBERS[:, None] * powers[_POWERS]
    return jnp.concatenate([forward[_FACTORS] * products, back[_FACTORS] * products])


def modes_in_time(
    inflow: _Signals, stored: _Signals, reference_flow: jax.Array
) -> tuple[_Signals, _Signals]:
    """Return the functions of time, 18 of (time,), and their rates.

    They are ∂q/∂t, ∂d/∂t, then for forward flow, with q and d over Q₀ and f = q²/(1 + q),
    q, d, f, f'(q)·d, q², q·d, d² and ∂q/∂t, then the same of −q and −d where the flow is reversed.
    The direction is that of q − d/2, in the middle of the storage: where directions differ along
    the vessel, the flow and these terms are nearly zero.

    Parameters
    ----------
    inflow, stored : three arrays of shape (time,)
        q and d, mL/s, with their first and second rates.
    reference_flow : scalar
        Q₀, mL/s.
    """
    forward = goes_forward(inflow[0], stored[0]).astype(inflow[0].dtype)
    sign = 2 * forward - 1
    q, q1 = (sign * s / reference_flow for s in inflow[:2])
    d, d1 = (sign * s / reference_flow for s in stored[:2])
    # Where the directions differ along the vessel, q may have the other sign.
    size = jnp.maximum(q, 0)
    f, slope, bend = size**2 / (1 + size), rational_slope(size), 2 / (1 + size) ** 3
    values = q, d, f, slope * d, q * q, q * d, d * d, sign * inflow[1]
    rates = (
        q1,
        d1,
        slope * q1,
        bend * q1 * d + slope * d1,
        2 * q * q1,
        q1 * d + q * d1,
        2 * d * d1,
        sign * inflow[2],
    )

    def directed(signals: _Signals) -> _Signals:
        return *(forward * s for s in signals), *((1 - forward) * s for s in signals)

    return (inflow[1], stored[1], *directed(values)), (inflow[2], stored[2], *directed(rates))


def rational_slope(flow: jax.Array) -> jax.Array:
    """Return the derivative of x²/(1 + x) at x ≥ 0."""
    return flow * (2 + flow) / (1 + flow) ** 2


def goes_forward(flow: jax.Array, stored: jax.Array) -> jax.Array:
    """Return whether the flow in the middle of the storage, q − d/2, is not reversed."""
    return flow - stored / 2 >= 0
