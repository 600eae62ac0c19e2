"""Fit of a network whose last layer is found by least squares.

In variable projection (Golub and Pereyra 1973) the last layer is the exact minimum for the
hidden layers; the gradient with respect to these is then the one at a constant last layer.

The layers are evaluated with numpy on one thread, for every engine: the sums run over all
cases and points, and so must not depend on the number of threads.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config.settings import FlowStage, TemporalPressureStage
from pcnde_bridge.engines.parameters import unpack_network
from pcnde_bridge.engines.types import Fit, OnIteration, ignore
from pcnde_bridge.training.lbfgs import Options, minimize
from pcnde_bridge.training.whitening import Whitening

Network = FlowStage | TemporalPressureStage

Projection = tuple[Array, float, Array]
"""Last layer (hidden + 1, out), its loss, and the loss's gradient (sample, hidden)."""


class VariableProjection(ABC):
    """Fit of a network's hidden layers, in whitened coordinates of the first.

    Parameters
    ----------
    inputs : array of shape (sample, in)
        Inputs of the network.
    whitening : Whitening
        Coordinates of the first layer.
    network : FlowStage or TemporalPressureStage
        Widths and activation function of the hidden layers.
    outputs : int
        Number of outputs of the network.
    options : Options
        Options of :func:`pcnde_bridge.training.lbfgs.minimize`.
    """

    def __init__(
        self, inputs: Array, whitening: Whitening, network: Network, outputs: int, options: Options
    ) -> None:
        self._whitening, self._inputs = whitening, whitening.inputs(inputs)
        self._options = options
        self._hidden_widths = self._inputs.shape[1], *network.hidden
        self._last = (network.hidden[-1] + 1) * outputs  # parameters of the last layer
        self._activation, self._slope = _ACTIVATIONS[network.activation]

    @abstractmethod
    def project(self, hidden: Array) -> Projection:
        """Solve the least squares for the output of the last hidden layer, (sample, hidden)."""

    def fit(self, start: Array, on_iteration: OnIteration = ignore) -> Fit:
        """Fit the network from given parameters."""
        first = self.coordinates(start)
        found = minimize(self.objective, first, self._options, on_iteration)
        layer, _, _ = self.project(self._forward(found.parameters)[0])
        coordinates = np.concatenate([found.parameters, layer.ravel()])
        return replace(found, parameters=self._whitening.parameters(coordinates))

    def coordinates(self, parameters: Array) -> Array:
        """Return the hidden layers' coordinates of a network's parameters."""
        return self._whitening.coordinates(parameters)[: -self._last]

    def objective(self, coordinates: Array) -> tuple[float, Array]:
        """Return the smallest loss for the hidden layers, and its gradient."""
        hidden, layers = self._forward(coordinates)
        _, loss, gradient = self.project(hidden)
        parts: list[Array] = []
        for value, slope, matrix in reversed(layers):
            gradient = gradient * slope
            parts = [(value.T @ gradient).ravel(), gradient.sum(axis=0), *parts]
            gradient = gradient @ matrix.T
        return loss, np.concatenate(parts)

    def _forward(self, coordinates: Array) -> tuple[Array, list[tuple[Array, Array, Array]]]:
        """Return the last hidden layer's output, and each layer's input, slope and weights."""
        value, layers = self._inputs, []
        for matrix, bias in unpack_network(coordinates, self._hidden_widths):
            x = value @ matrix + bias
            result = self._activation(x)
            layers.append((value, self._slope(x, result), matrix))
            value = result
        return value, layers


_ROOT = float(np.sqrt(2 / np.pi))


def _sigmoid(x: Array) -> Array:
    return 0.5 * (1 + np.tanh(x / 2))


def _gelu_tanh(x: Array) -> Array:
    return np.tanh(_ROOT * (x + 0.044715 * x**3))


def _gelu_slope(x: Array, _: Array) -> Array:
    half, slope = _gelu_tanh(x), _ROOT * (1 + 3 * 0.044715 * x**2)
    return (1 + half) / 2 + x * (1 - half**2) * slope / 2


_Activation = tuple[Callable[[Array], Array], Callable[[Array, Array], Array]]
_ACTIVATIONS: dict[str, _Activation] = {  # value, and slope given x and the value
    "tanh": (np.tanh, lambda _, value: 1 - value**2),
    "gelu": (lambda x: x * (1 + _gelu_tanh(x)) / 2, _gelu_slope),
    "relu": (lambda x: np.maximum(x, 0.0), lambda x, _: (x > 0).astype(np.float64)),
    "sigmoid": (_sigmoid, lambda _, value: value * (1 - value)),
    "swish": (
        lambda x: x * _sigmoid(x),
        lambda x, value: _sigmoid(x) + value * (1 - _sigmoid(x)),
    ),
}
