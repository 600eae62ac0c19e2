r"""Wall shear stress of the flow whose pressure losses are known, from the same layer and jet.

Poiseuille's wall shear stress of a steady flow Q is multiplied by

    1 + c₁·b·R(Λ₁) + c₂·R(Λ₂) + c₃·b·R(Λ₃) − c₄·d·R(Λ₄) + c₅·R(−Λ₅) − c₆·d·tanh(Λ₁⁻/20)
      − c₇·l − c₈·j,

where R(x) = x/√(x + 0.3) for x > 0, else 0, is almost √x, with the core's speed U and the layer's
thickness δ = d·r_u
(:mod:`~pcnde_bridge.engines.jax.closures.boundary_layer`), and

- the layer's shear over Poiseuille's, b = U_e/(2·d·Q/S_u), where U_e = U − 0.6·r_u²·U''/8 is the
  speed at its edge: streamlines that bend into the throat are faster near the wall;
- the pressure gradient in the layer, Λ = δ²·U_e'/ν, which is Pohlhausen's parameter: b·√Λ is the
  shear of a layer in an accelerating flow, U_e·√(U_e'/ν) (Falkner and Skan);
- l = ln(S_u/(β·A_j)), which lets the flow near the wall turn back where it is separated.

The layer remembers the pressure gradient.  Λᵢ is Λ, or for i = 2, 3, 4 its positive part,
relaxed along z, and so is j:

    Λᵢ' = (Λ − Λᵢ)/ℓᵢ,    ℓ₁ = ℓ₂ = 0.005·δ²U/ν,  ℓ₃, ℓ₄, ℓ₅ = 0.3, 0.6, 1.2 r_u,
    j' = (R(S_u/(β·A_j) − 1) − j)/ℓ_j,    ℓ_j = 0.08·r_u²·(Q/S_u)/ν.

x⁻ is the size of the negative part of x.  As the losses, the result is computed at
three Reynolds numbers and interpolated.  An unsteady flow adds c₀·ρ/(6π·r_u)·∂Q/∂t, which with
c₀ = 1 is Womersley's result for slow oscillations.  In a straight vessel Λ, l and j are zero,
and the steady result is Poiseuille's for any parameters.  The result is the magnitude.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge.config.settings import Physics
from pcnde_bridge.engines.jax.closures import pressure_losses as losses
from pcnde_bridge.engines.jax.closures.boundary_layer import mean_speed
from pcnde_bridge.engines.jax.closures.pressure_losses import Marched

_WIDTH = 2
"""Intervals on either side of a point from which derivatives are computed."""

_CURVATURE = 0.6
"""Effect of the streamlines' curvature on U_e; 1 in a potential flow."""

_DECELERATION = 20.0
"""Λ at which the effect of a deceleration on the layer is limited."""

_SMALL_ROOT = 0.3
"""Value below which R is proportional to x."""

_LAYER_LENGTH, _JET_LENGTH = 0.005, 0.08
"""Lengths of relaxation over δ²U/ν and r_u²·(Q/S_u)/ν."""

_RADII = 0.3, 0.6, 1.2
"""Lengths of relaxation over r_u."""


class Terms(NamedTuple):
    """Terms of one vessel that the parameters multiply.

    Attributes
    ----------
    unsteady : array of shape (z,)
        ρ/(6π·r_u), the factor of ∂Q/∂t.
    forward, back : arrays of shape (9, 3, z)
        Poiseuille's stress and the eight terms, each as factors of x, x²/(1 + x) and x², for
        Q > 0 and Q < 0.
    """

    unsteady: jax.Array
    forward: jax.Array
    back: jax.Array


def terms(marched: Marched, physics: Physics) -> Terms:
    """Compute the terms of one vessel from its layer and jet."""
    directed = _directed(marched, physics)
    unsteady = physics.density / 6 / jnp.sqrt(jnp.pi * marched.area[0, 0])
    return Terms(unsteady, directed[:, 0], -directed[:, 1, :, ::-1])


def _directed(marched: Marched, physics: Physics) -> jax.Array:
    """Return the terms of flows in the direction of z, (9, 2, 3, z)."""
    area, z, flow, d, jet = marched
    kinematic = physics.viscosity / physics.density
    radius = jnp.sqrt(area / jnp.pi)
    mean = flow / area
    core = mean / mean_speed(d)
    edge = jnp.maximum(core - _CURVATURE / 8 * radius**2 * _derivatives(core, z)[1], 0)
    shear = edge / (2 * d * mean)
    gradient = (radius * d) ** 2 / kinematic * _derivatives(edge, z)[0]
    accelerating = jnp.maximum(gradient, 0)
    mixing = _root(jet - 1)
    sources = (gradient, *(accelerating,) * 3, gradient, mixing)
    layer_length = _LAYER_LENGTH * (radius * d) ** 2 * core / kinematic
    lengths = jnp.stack(
        [
            layer_length,
            layer_length,
            *(factor * radius + 0 * d for factor in _RADII),
            _JET_LENGTH * radius**2 * mean / kinematic,
        ]
    )
    first, second, third, fourth, fifth, mixed = _relaxed(jnp.stack(sources), lengths, z)
    factors = jnp.stack(
        [
            jnp.ones_like(d),
            shear * _root(first),
            _root(second),
            shear * _root(third),
            -d * _root(fourth),
            _root(-fifth),
            -d * jnp.tanh(jnp.maximum(-first, 0) / _DECELERATION),
            -jnp.log(jet),
            -mixed,
        ]
    )
    return losses.to_factors(4 * physics.viscosity * mean / radius * factors)


def _root(values: jax.Array) -> jax.Array:
    """Return R, almost the square root of positive values; it does not amplify round-off."""
    positive = jnp.maximum(values, 0)
    return positive / jnp.sqrt(positive + _SMALL_ROOT)


def _derivatives(values: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the first two derivatives along the last axis, zero at its ends."""
    both = 2 * _WIDTH
    distance = z[..., both:] - z[..., :-both]
    slopes = (values[..., _WIDTH:] - values[..., :-_WIDTH]) / (z[..., _WIDTH:] - z[..., :-_WIDTH])
    first = (values[..., both:] - values[..., :-both]) / distance
    second = 2 * (slopes[..., _WIDTH:] - slopes[..., :-_WIDTH]) / distance
    ends = [(0, 0)] * (values.ndim - 1) + [(_WIDTH, _WIDTH)]
    return jnp.pad(first, ends), jnp.pad(second, ends)


def _relaxed(source: jax.Array, length: jax.Array, z: jax.Array) -> jax.Array:
    """Solve y' = (source − y)/length from y = 0, (..., z); exact for linear sources."""
    steps = 2 * jnp.diff(z) / (length[..., 1:] + length[..., :-1])
    decay, mean = jnp.exp(-steps), -jnp.expm1(-steps) / steps
    gain = source[..., :-1] * (mean - decay) + source[..., 1:] * (1 - mean)

    def advance(y: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        y = step[0] * y + step[1]
        return y, y

    start = jnp.zeros_like(source[..., 0])
    _, later = jax.lax.scan(advance, start, jnp.moveaxis(jnp.stack([decay, gain]), -1, 0))
    return jnp.concatenate([start[..., None], jnp.moveaxis(later, 0, -1)], axis=-1)


def _factors(parameters: jax.Array, of_direction: jax.Array) -> jax.Array:
    """Return the factors (3, z) of the sum of all terms."""
    return of_direction[0] + jnp.tensordot(parameters[1:], of_direction[1:], axes=1)


def modes_in_space(parameters: jax.Array, t: Terms, share: jax.Array) -> jax.Array:
    """Return the functions of z, (18, z), for those of time of the losses; ``share`` is ξ."""
    unsteady = parameters[0] * t.unsteady
    no_rate = jnp.zeros_like(unsteady)[None]
    forward, back = (
        jnp.concatenate([_factors(parameters, direction), no_rate])
        for direction in (t.forward, t.back)
    )
    directed = losses.directed_modes(forward, back, share)
    return jnp.stack([unsteady, -unsteady * share, *directed])


def stress(
    parameters: jax.Array,
    t: Terms,
    reference_flow: jax.Array,
    flow: jax.Array,
    flow_rate: jax.Array,
) -> jax.Array:
    """Return the wall shear stress, with its sign, of a given flow and its rate, (time, z).

    Parameters
    ----------
    parameters : array of shape (9,)
        c₀ to c₈.
    t : Terms
        Terms of the vessel.
    reference_flow : scalar
        Q₀ of the losses, mL/s.
    flow, flow_rate : arrays of shape (time, z)
        Q, mL/s, and ∂Q/∂t, mL/s².
    """
    x = flow / reference_flow
    functions = jnp.stack(losses.steady(jnp.abs(x)))
    forward, back = (_factors(parameters, direction)[:, None] for direction in (t.forward, t.back))
    steady: jax.Array = jnp.sum(jnp.where(x > 0, forward, back) * functions, axis=0)
    return steady + parameters[0] * t.unsteady * flow_rate
