"""A network up to its last layer, which is left to least squares.

In variable projection (Golub and Pereyra 1973) the last layer is the exact minimum for the
layers before it; the gradient by these is then the one with the last layer held fixed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array

__all__ = ["HiddenLayers", "Passed"]


class Passed(NamedTuple):
    """What a pass through the layers leaves for the gradient.

    Attributes
    ----------
    values : list of arrays of shape (sample, width)
        The inputs, and what comes out of each layer.
    slopes : list of arrays of shape (sample, width)
        Derivatives of the activation function in each layer.
    matrices : list of arrays of shape (in, out)
        The layers' weights.
    """

    values: list[Array]
    slopes: list[Array]
    matrices: list[Array]

    @property
    def last(self) -> Array:
        """What the last layer sees, (sample, width)."""
        return self.values[-1]


class HiddenLayers:
    """Dense layers with one activation function.

    Their coordinates are one vector: of each layer the weights (in, out), then the biases.

    Parameters
    ----------
    widths : sequence of int
        Of the inputs and of each layer.
    activation : str
        ``tanh``, ``gelu``, ``relu``, ``sigmoid`` or ``swish``.
    """

    def __init__(self, widths: Sequence[int], activation: str) -> None:
        self._layers = list(pairwise(widths))
        self._activation = _ACTIVATIONS[activation]

    def __call__(self, coordinates: Array, inputs: Array) -> Passed:
        """Pass inputs (sample, in) through the layers."""
        passed, at = Passed([inputs], [], []), 0
        for n_in, n_out in self._layers:
            matrix = coordinates[at : at + n_in * n_out].reshape(n_in, n_out)
            at += n_in * n_out
            value, slope = self._activation(passed.last @ matrix + coordinates[at : at + n_out])
            at += n_out
            for kept, new in zip(passed, (value, slope, matrix), strict=True):
                kept.append(new)
        return passed

    @staticmethod
    def gradient(passed: Passed, back: Array) -> Array:
        """By the coordinates, from that by what comes out, (sample, width)."""
        gradient: list[Array] = []
        for value, slope, matrix in zip(
            reversed(passed.values[:-1]),
            reversed(passed.slopes),
            reversed(passed.matrices),
            strict=True,
        ):
            back = back * slope
            gradient = [(value.T @ back).ravel(), back.sum(axis=0), *gradient]
            back = back @ matrix.T
        return np.concatenate(gradient)


# Value and derivative, both from the argument x.
_ROOT = np.sqrt(2 / np.pi)


def _sigmoid(x: Array) -> Array:
    result: Array = 0.5 * (1 + np.tanh(x / 2))
    return result


def _tanh(x: Array) -> tuple[Array, Array]:
    value = np.tanh(x)
    return value, 1 - value**2


def _gelu(x: Array) -> tuple[Array, Array]:
    half = np.tanh(_ROOT * (x + 0.044715 * x**3))
    slope = _ROOT * (1 + 3 * 0.044715 * x**2)
    return x * (1 + half) / 2, (1 + half) / 2 + x * (1 - half**2) * slope / 2


def _relu(x: Array) -> tuple[Array, Array]:
    return np.maximum(x, 0.0), (x > 0).astype(np.float64)


def _logistic(x: Array) -> tuple[Array, Array]:
    value = _sigmoid(x)
    return value, value * (1 - value)


def _swish(x: Array) -> tuple[Array, Array]:
    share = _sigmoid(x)
    return x * share, share + x * share * (1 - share)


_ACTIVATIONS: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "tanh": _tanh,
    "gelu": _gelu,
    "relu": _relu,
    "sigmoid": _logistic,
    "swish": _swish,
}
