r"""Displacement of the wall under a pressure: an elastic membrane, or a local tube law.

**Membrane.**  The vessel is a thin shell of revolution with the generator r_u(z),
clamped at both ends, that carries membrane and transverse shear forces, as in the
coupled momentum method (Figueroa et al. 2006).  With the displacement
(u_z, u_r), tangent t, normal n and arc length s of the generator, the strains are

    ε_s = t·∂u/∂s,    ε_θ = u_r/r_u,    γ = n·∂u/∂s,

and u makes the energy stationary:

    ½ K ∫ [ε_s² + ε_θ² + 2ν ε_s ε_θ + k γ² + f u_z²] r_u ds − ∫ (p − p₀) n·u r_u ds,

with the stiffness K = E·h/(1 − ν²), dyn/cm, Poisson's ratio ν, the shear ratio k
(5/12·(1 − ν) for a homogeneous wall) and the axial support f of the tissue, 1/cm².
There are linear elements between the points, with two Gauss points each; the block
tridiagonal system is solved directly.  In a long straight part the result is the linear
wall law, u_r = r_u²·(p − p₀)/K (for u_z = 0).

**Local law.**  u_r = r_u·(r_u/r_0)^m·(p − p₀)/K, with r_0 the first point's radius
and K in dyn/cm²: E·h/r₀ is constant for m = 0, and E·h for m = 1.  Its ends are free.

Both are linear in the pressure; the area S = π(r_u + u_r)² is not.
"""

from typing import Literal

import jax
import jax.numpy as jnp

_GAUSS = 0.5 / 3**0.5


def displacement(
    parameters: jax.Array,
    loads: jax.Array,
    area_undeformed: jax.Array,
    z: jax.Array,
    law: Literal["membrane", "local", "auto"],
) -> jax.Array:
    """Return the radial displacement under some loads.

    Parameters
    ----------
    parameters : array of shape (5,) or (3,)
        Membrane: K (dyn/cm), ν, k, f (1/cm²), p₀; local: K (dyn/cm²), m, p₀.
        p₀ is already part of the loads.
    loads : array of shape (load, z)
        p − p₀, dyn/cm².
    area_undeformed : array of shape (z,)
        S_u, cm².
    z : array of shape (z,)
        Points, cm.
    law : {'membrane', 'local'}
        Wall law; 'auto' must have been decided before.

    Returns
    -------
    array of shape (load, z)
        u_r, cm.
    """
    radius = jnp.sqrt(area_undeformed / jnp.pi)
    if law == "local":
        stiffness, exponent = parameters[0], parameters[1]
        return radius * (radius / radius[0]) ** exponent / stiffness * loads
    return _membrane(parameters, loads, radius, z)


def _membrane(
    parameters: jax.Array, loads: jax.Array, radius: jax.Array, z: jax.Array
) -> jax.Array:
    matrices, forces = _elements(parameters[1:4], loads, radius, z)
    # Assembled for the points between the clamped ends: [point, (u_z, u_r), ...].
    diagonal = matrices[:-1, 2:, 2:] + matrices[1:, :2, :2]
    above = matrices[1:, :2, 2:]
    right = forces[:-1, 2:] + forces[1:, :2]
    inside = _solve_block_tridiagonal(diagonal, above, right)
    return jnp.pad(inside[:, 1].T, ((0, 0), (1, 1))) / parameters[0]


def _elements(
    ratios: jax.Array, loads: jax.Array, radius: jax.Array, z: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return stiffness over K, (element, 4, 4), and forces, (element, 4, load)."""
    poisson, shear, support = ratios
    dz, dr = jnp.diff(z), jnp.diff(radius)
    length = jnp.hypot(dz, dr)
    tangent = jnp.stack([dz, dr], axis=1) / length[:, None]
    normal = jnp.stack([-dr, dz], axis=1) / length[:, None]
    along = jnp.concatenate([-tangent, tangent], axis=1) / length[:, None]
    across = jnp.concatenate([-normal, normal], axis=1) / length[:, None]
    zero = jnp.zeros_like(dz)

    def product(a: jax.Array, b: jax.Array) -> jax.Array:
        return a[:, :, None] * b[:, None, :]

    matrices = jnp.zeros((dz.size, 4, 4))
    forces = jnp.zeros((dz.size, 4, loads.shape[0]))
    for share in (0.5 - _GAUSS, 0.5 + _GAUSS):
        r = (1 - share) * radius[:-1] + share * radius[1:]
        around = jnp.stack([zero, (1 - share) / r, zero, share / r], axis=1)
        axial = jnp.stack([zero + 1 - share, zero, zero + share, zero], axis=1)
        weight = r * length / 2
        matrices += weight[:, None, None] * (
            product(along, along)
            + product(around, around)
            + poisson * (product(along, around) + product(around, along))
            + shear * product(across, across)
            + support * product(axial, axial)
        )
        shape = jnp.concatenate([(1 - share) * normal, share * normal], axis=1)
        load = (1 - share) * loads[:, :-1] + share * loads[:, 1:]
        forces += (weight[:, None] * shape)[:, :, None] * load.T[:, None, :]
    return matrices, forces


def _solve_block_tridiagonal(diagonal: jax.Array, above: jax.Array, right: jax.Array) -> jax.Array:
    """Solve a symmetric system of 2 × 2 blocks (block Thomas algorithm).

    Shapes: diagonal (n, 2, 2); above (n, 2, 2), block (i, i + 1), the last unused;
    right (n, 2, m).  Returns (n, 2, m).
    """
    below = jnp.concatenate([jnp.zeros((1, 2, 2)), jnp.swapaxes(above[:-1], 1, 2)])

    def eliminate(
        previous: tuple[jax.Array, jax.Array], row: tuple[jax.Array, ...]
    ) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
        d, up, low, b = row
        factor, solved = previous
        inverse = _inverse(d - low @ factor)
        row_result = inverse @ up, inverse @ (b - low @ solved)
        return row_result, row_result

    start = jnp.zeros((2, 2)), jnp.zeros(right.shape[1:])
    _, (factors, solved) = jax.lax.scan(eliminate, start, (diagonal, above, below, right))

    def substitute(
        after: jax.Array, row: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        factor, s = row
        x = s - factor @ after
        return x, x

    # Substitution begins at the last point, whose neighbor is clamped.
    _, result = jax.lax.scan(substitute, start[1], (factors, solved), reverse=True)
    return result


def _inverse(matrix: jax.Array) -> jax.Array:
    (a, b), (c, d) = matrix
    adjugate = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])])
    return adjugate / (a * d - b * c)
