r"""Pressure difference between a point and the outlet, from the momentum of the flow.

The momentum balance of the cross-section, with a free jet behind every narrowing, is

    −∂p/∂z = c_f·8πμ/S_u²·Q  +  c_i·ρ/S_u·∂Q/∂t  +  c_m·ρ/S_u·Q²·∂(1/A_j)/∂z.

The area A_j(z) that carries the flow is S_u where the vessel narrows or widens
slowly.  Where it widens faster the flow separates, and the jet's radius grows by the
spread s per unit length (about 0.1 for a free turbulent jet) until it fills
the vessel again:

    √(A_j(z)/π) = min over z' ≤ z of √(S_u(z')/π) + s·(z − z').

For a sudden expansion this is the Borda–Carnot loss; the pressure drop that is not
recovered has the form of Seeley and Young's turbulent term.  The positions of stenoses follow
from S_u; there may be none, or several.  In a straight vessel A_j = S_u is constant and the
third term is zero.  Where the flow fills a vessel that narrows and widens again its integral is
zero: the pressure is recovered.  For reversed flow the jet has the opposite direction.

With the flow Q = q − ξ(z)·d, where q(t) is the inflow, d(t) = q − Q(L) the flow stored by the
wall and ξ(z) the share of the storage before z, the pressure is a sum of a few
products of a function of z and a function of t.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge.config.settings import Physics
from pcnde_bridge.engines.jax.closures.integrals import summed_from_inlet, to_outlet
from pcnde_bridge.engines.shared_terms import rate

_Signals = tuple[jax.Array, ...]
"""Functions of time."""

REVERSED = 3
"""Number of the last modes, which are zero without reversed flow."""


class Coefficients(NamedTuple):
    """Coefficients of the three terms, per length.

    Attributes
    ----------
    friction, inertia : array of shape (z,)
        Factors of Q and ∂Q/∂t.
    jet, jet_back : array of shape (z − 1,)
        Factors of Q², integrated over each interval, for Q > 0 and for Q < 0.
    """

    friction: jax.Array
    inertia: jax.Array
    jet: jax.Array
    jet_back: jax.Array


def coefficients(
    parameters: jax.Array, area_undeformed: jax.Array, z: jax.Array, physics: Physics
) -> Coefficients:
    """Compute the coefficients of the three terms.

    Parameters
    ----------
    parameters : array of shape (4,)
        c_f, c_i, c_m and the spread s.
    area_undeformed : array of shape (z,)
        S_u, cm².
    z : array of shape (z,)
        Points, cm.
    physics : Physics
        ρ and μ.
    """
    friction, inertia, convection, spread = parameters
    steps = jnp.diff(z)
    # With this mean the intervals with A_j = S_u add up to the change of 1/(2·S_u²) exactly.
    between = (1 / area_undeformed[1:] + 1 / area_undeformed[:-1]) / 2

    def jet(area: jax.Array, dz: jax.Array) -> Any:
        return convection * (physics.density * jnp.diff(1 / jet_area(area, dz, spread)))

    return Coefficients(
        friction * 8 * jnp.pi * physics.viscosity / area_undeformed**2,
        inertia * physics.density / area_undeformed,
        jet(area_undeformed, steps) * between,
        -jet(area_undeformed[::-1], steps[::-1])[::-1] * between,
    )


def jet_area(area_undeformed: jax.Array, steps: jax.Array, spread: jax.Array) -> jax.Array:
    """Return A_j (z,), cm², of a flow in the direction of z; ``steps`` (z − 1,) in cm.

    It is the smallest of all jets that could start upstream.
    """
    reach = spread * summed_from_inlet(steps)
    begins = jnp.sqrt(area_undeformed / jnp.pi) - reach
    narrowest = jax.lax.cummin(begins)
    # Exactly S_u where the flow fills the vessel: a straight vessel has no jet at all.
    return jnp.where(narrowest == begins, area_undeformed, jnp.pi * (reach + narrowest) ** 2)


def drop(
    parameters: jax.Array,
    flow: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    period: jax.Array,
    physics: Physics,
) -> jax.Array:
    """Return p − p(L), (time, z), of a given flow Q (time, z)."""
    c = coefficients(parameters, area_undeformed, z, physics)
    middle = (flow[:, 1:] + flow[:, :-1]) / 2
    jets = jnp.where(middle > 0, c.jet, c.jet_back) * middle**2
    summed = summed_from_inlet(jets)
    smooth = c.friction * flow + c.inertia * rate(flow.T, period, jnp).T
    return to_outlet(smooth, z) + summed[:, -1:] - summed


def modes_in_space(c: Coefficients, share: jax.Array, z: jax.Array) -> jax.Array:
    """Return the functions of z, (10, z), for :func:`modes_in_time`; ``share`` (z,) is ξ."""
    between = (share[1:] + share[:-1]) / 2
    smooth = (c.friction, -c.friction * share, c.inertia, -c.inertia * share)
    jets = tuple(
        summed_from_inlet(b * factor)
        for b in (c.jet, c.jet_back)
        for factor in (jnp.ones_like(between), -2 * between, between**2)
    )
    return jnp.stack([*(to_outlet(f, z) for f in smooth), *(j[-1] - j for j in jets)])


def modes_in_time(inflow: _Signals, stored: _Signals) -> tuple[_Signals, _Signals]:
    """Return the functions of time, ten of (time,), and their rates.

    They are q, d, ∂q/∂t, ∂d/∂t, then q², q·d, d² where the flow is forward, then the
    same where it is reversed.  The direction is that of q − d/2, in the middle of the
    storage: where directions differ along the vessel, the flow and the jet's term are nearly
    zero.

    Parameters
    ----------
    inflow, stored : three arrays of shape (time,)
        q and d with their first and second rates.
    """
    q, q1, q2 = inflow
    d, d1, d2 = stored
    linear, linear_rates = (q, d, q1, d1), (q1, d1, q2, d2)
    squares = q * q, q * d, d * d
    square_rates = 2 * q * q1, q1 * d + q * d1, 2 * d * d1
    forward = goes_forward(q, d).astype(q.dtype)
    back = 1 - forward

    def directed(products: _Signals) -> _Signals:
        return *(forward * p for p in products), *(back * p for p in products)

    return (*linear, *directed(squares)), (*linear_rates, *directed(square_rates))


def goes_forward(flow: jax.Array, stored: jax.Array) -> jax.Array:
    """Return whether the flow in the middle of the storage, q − d/2, is not reversed."""
    return flow - stored / 2 >= 0
