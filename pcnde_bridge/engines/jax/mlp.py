"""Fully connected network in JAX, from the package's flat parameter layout."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import jax
import jax.numpy as jnp

ACTIVATIONS = {
    "tanh": jnp.tanh,
    # The GeLU of NNlib, and of the paper, is the tanh approximation.
    "gelu": lambda x: jax.nn.gelu(x, approximate=True),
    "relu": jax.nn.relu,
    "sigmoid": jax.nn.sigmoid,
    "swish": jax.nn.swish,
}


def unpack(parameters: jax.Array, widths: Sequence[int]) -> list[tuple[jax.Array, jax.Array]]:
    """Return the weights, transposed to (in, out), and the bias of every layer."""
    layers, start = [], 0
    for n_in, n_out in pairwise(widths):
        weight = parameters[start : start + n_in * n_out].reshape(n_in, n_out)
        start += n_in * n_out
        layers.append((weight, parameters[start : start + n_out]))
        start += n_out
    return layers
