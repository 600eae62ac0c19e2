"""Fields over time and space that are a sum of a few products T(t)·Z(z)."""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp


class Separable(NamedTuple):
    """Field offset + Σ_k T_k(t)·Z_k(z) of every case.

    Attributes
    ----------
    offset : array that broadcasts to (case, time, z)
        The part that depends on time or on space alone.
    in_time : array of shape (k, time)
        T, the same for all cases.
    in_space : array of shape (case, k, z)
        Z.
    """

    offset: jax.Array
    in_time: jax.Array
    in_space: jax.Array

    def values(self) -> jax.Array:
        """Evaluate the field, (case, time, z), in one fused loop over the terms."""
        terms = (
            self.in_time[k][None, :, None] * self.in_space[:, k, None, :]
            for k in range(self.in_time.shape[0])
        )
        return reduce(jnp.add, terms, self.offset)

    def __matmul__(self, matrix: jax.Array) -> jax.Array:
        """Contract z with a matrix (z, m), without evaluating the field: (case, time, m)."""
        n_points = self.in_space.shape[2]
        offset = jnp.broadcast_to(self.offset, (*self.offset.shape[:2], n_points)) @ matrix
        return offset + jnp.einsum("kt,nkm->ntm", self.in_time, self.in_space @ matrix)
