"""Hidden layers of a network whose last layer is found by least squares.

In variable projection (Golub and Pereyra 1973) the last layer is the exact minimum for the
hidden layers; the gradient with respect to these is then the one at a constant last layer.

The layers are evaluated with numpy on one thread, for every engine: the sums run over all
cases and points, and so must not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.engines.parameters import unpack_network

__all__ = ["ForwardPass", "HiddenLayers"]


class ForwardPass(NamedTuple):
    """Intermediate results of a pass through the layers, which the gradient needs.

    Attributes
    ----------
    values : list of arrays of shape (sample, width)
        Inputs, then the output of each layer.
    slopes : list of arrays of shape (sample, width)
        Derivatives of the activation function in each layer.
    matrices : list of arrays of shape (in, out)
        Weights of the layers.
    """

    values: list[Array]
    slopes: list[Array]
    matrices: list[Array]

    @property
    def last(self) -> Array:
        """Output of the last hidden layer, shape (sample, width)."""
        return self.values[-1]


class HiddenLayers:
    """Dense layers with one activation function.

    Their coordinates are one vector: for each layer the weights (in, out), then the biases.

    Parameters
    ----------
    widths : sequence of int
        Widths of the inputs and of each layer.
    activation : str
        ``tanh``, ``gelu``, ``relu``, ``sigmoid`` or ``swish``.
    """

    def __init__(self, widths: Sequence[int], activation: str) -> None:
        self._widths = widths
        self._activation = _ACTIVATIONS[activation]

    def __call__(self, coordinates: Array, inputs: Array) -> ForwardPass:
        """Pass inputs of shape (sample, in) through the layers."""
        passed = ForwardPass([inputs], [], [])
        for matrix, bias in unpack_network(coordinates, self._widths):
            value, slope = self._activation(passed.last @ matrix + bias)
            passed.values.append(value)
            passed.slopes.append(slope)
            passed.matrices.append(matrix)
        return passed

    @staticmethod
    def gradient(passed: ForwardPass, gradient: Array) -> Array:
        """Return the gradient with respect to the coordinates, given that to the output."""
        parts: list[Array] = []
        for value, slope, matrix in reversed(
            list(zip(passed.values, passed.slopes, passed.matrices, strict=False))
        ):
            gradient = gradient * slope
            parts = [(value.T @ gradient).ravel(), gradient.sum(axis=0), *parts]
            gradient = gradient @ matrix.T
        return np.concatenate(parts)


# Value and derivative of the activation functions.
_ROOT = np.sqrt(2 / np.pi)


def _tanh(x: Array) -> tuple[Array, Array]:
    value = np.tanh(x)
    return value, 1 - value**2


def _gelu(x: Array) -> tuple[Array, Array]:
    half = np.tanh(_ROOT * (x + 0.044715 * x**3))
    slope = _ROOT * (1 + 3 * 0.044715 * x**2)
    return x * (1 + half) / 2, (1 + half) / 2 + x * (1 - half**2) * slope / 2


def _relu(x: Array) -> tuple[Array, Array]:
    return np.maximum(x, 0.0), (x > 0).astype(np.float64)


def _sigmoid(x: Array) -> tuple[Array, Array]:
    value = 0.5 * (1 + np.tanh(x / 2))
    return value, value * (1 - value)


def _swish(x: Array) -> tuple[Array, Array]:
    share, _ = _sigmoid(x)
    return x * share, share + x * share * (1 - share)


_ACTIVATIONS: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "tanh": _tanh,
    "gelu": _gelu,
    "relu": _relu,
    "sigmoid": _sigmoid,
    "swish": _swish,
}
