"""Fit of a network whose last layer is found by least squares.

In variable projection (Golub and Pereyra 1973) the last layer is the exact minimum for the
hidden layers; the gradient with respect to these is then the one at a constant last layer.

The layers are evaluated with numpy on one thread, for every engine: the sums run over all
cases and points, and so must not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import FullBatch
from pcnde_bridge.engines.parameters import unpack_network
from pcnde_bridge.engines.types import LBFGS, Fit, OnIteration
from pcnde_bridge.training.lbfgs import minimize
from pcnde_bridge.training.whitening import Whitening

__all__ = ["HiddenLayers", "Projection", "Subset", "VariableProjection"]


class Projection(NamedTuple):
    """Solution of the least squares for given hidden layers.

    Attributes
    ----------
    layer : array of shape (hidden + 1, out)
        Weights and bias of the last layer.
    loss : float
        Smallest loss.
    gradient : callable
        Returns the gradient with respect to the last hidden layer's output, (sample, hidden).
    """

    layer: Array
    loss: float
    gradient: Callable[[], Array]


class Subset(Protocol):
    """Inputs and reference data of some cases.

    Attributes
    ----------
    inputs : array of shape (sample, in)
        Inputs of the network.
    """

    inputs: Array

    def project(self, hidden: Array) -> Projection:
        """Find the last layer for the output of the hidden layers, (sample, hidden)."""

    def error(self, hidden: Array, layer: Array) -> float:
        """Return the mean square error with a given last layer."""


@dataclass
class VariableProjection:
    """Fit of a network's hidden layers, in whitened coordinates of the first.

    Attributes
    ----------
    subsets : sequence of Subset
        Cases to fit and, if given, validation cases, whose error ends the fit.
    whitening : Whitening
        Coordinates of the first layer.
    widths : sequence of int
        Widths of the network from input to output.
    activation : str
        Activation function of the hidden layers.
    settings, iterations, unit
        Arguments of :func:`pcnde_bridge.training.lbfgs.minimize`.
    """

    subsets: Sequence[Subset]
    whitening: Whitening
    widths: Sequence[int]
    activation: str
    settings: FullBatch
    iterations: int
    unit: float

    def __post_init__(self) -> None:
        self._inputs = [self.whitening.inputs(subset.inputs) for subset in self.subsets]
        widths = self._inputs[0].shape[1], *self.widths[1:-1]
        self._hidden = HiddenLayers(widths, self.activation)

    def fit(self, start: Array, on_iteration: OnIteration | None, lbfgs: LBFGS) -> Fit:
        """Fit the network from given parameters."""
        validate = self._validation_error if len(self.subsets) > 1 else None
        run = self.settings, self.iterations, self.unit, validate, on_iteration
        found = minimize(self.objective, self.coordinates(start), *run, lbfgs=lbfgs)
        layer = self._project(found.parameters)[1].layer
        coordinates = np.concatenate([found.parameters, layer.ravel()])
        return replace(found, parameters=self.whitening.parameters(coordinates))

    def coordinates(self, parameters: Array) -> Array:
        """Return the hidden layers' coordinates of a network's parameters."""
        last = (self.widths[-2] + 1) * self.widths[-1]  # parameters of the last layer
        return self.whitening.coordinates(parameters)[:-last]

    def objective(self, coordinates: Array) -> tuple[float, Array]:
        """Return the smallest loss for the hidden layers, and its gradient."""
        passed, projection = self._project(coordinates)
        return projection.loss, self._hidden.gradient(passed, projection.gradient())

    def _project(self, coordinates: Array) -> tuple[_ForwardPass, Projection]:
        passed = self._hidden(coordinates, self._inputs[0])
        return passed, self.subsets[0].project(passed.last)

    def _validation_error(self, coordinates: Array) -> float:
        hidden = self._hidden(coordinates, self._inputs[1]).last
        return self.subsets[1].error(hidden, self._project(coordinates)[1].layer)


class _ForwardPass(NamedTuple):
    """Results of a pass through the layers: outputs, activations' slopes, and weights."""

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

    def __call__(self, coordinates: Array, inputs: Array) -> _ForwardPass:
        """Pass inputs of shape (sample, in) through the layers."""
        passed = _ForwardPass([inputs], [], [])
        for matrix, bias in unpack_network(coordinates, self._widths):
            value, slope = self._activation(passed.last @ matrix + bias)
            passed.values.append(value)
            passed.slopes.append(slope)
            passed.matrices.append(matrix)
        return passed

    @staticmethod
    def gradient(passed: _ForwardPass, gradient: Array) -> Array:
        """Return the gradient with respect to the coordinates, given that to the output."""
        parts: list[Array] = []
        for value, slope, matrix in reversed(list(zip(*passed, strict=False))):
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
