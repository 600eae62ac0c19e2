"""Whitened coordinates of a network's first layer."""

import numpy as np

from pcnde_bridge._typing import Array


class Whitening:
    """Coordinates of a network's first layer in which all inputs have a similar spread.

    The inputs of all cases, time points and points lie close to a plane of few dimensions,
    and in it their spread differs a hundredfold, so that the loss is a narrow valley.  With
    the inputs u = m + Σ_i √λ_i ξ_i e_i, by principal components, the first layer

        W·u + c = V·ξ' + d,   ξ'_i = e_i·(u − m) / √(λ_i + ε·λ_max)

    has the coordinates V and d in place of W and c.  Components that the inputs do not
    show have no coordinate: their weights are zero.

    Parameters
    ----------
    inputs : array of shape (sample, in)
        Inputs of the network.
    width : int
        Width of the first hidden layer.
    floor : float
        ε.
    """

    def __init__(self, inputs: Array, width: int, floor: float) -> None:
        self._width, self._mean = width, inputs.mean(axis=0)
        spread = inputs - self._mean
        variances, components = np.linalg.eigh(spread.T @ spread / len(inputs))
        largest = variances[-1]
        seen = variances > 1e-4 * floor * largest
        self._size = np.sqrt(variances[seen] + floor * largest)
        self._components = components[:, seen]

    def inputs(self, inputs: Array) -> Array:
        """Return ξ' of inputs, shape (..., component)."""
        return (inputs - self._mean) @ (self._components / self._size)

    def coordinates(self, parameters: Array) -> Array:
        """Return V, d and the other layers' parameters, which do not change."""
        weights, bias, rest = self._split(parameters, len(self._mean))
        whitened = (self._components * self._size).T @ weights
        return np.concatenate([whitened.ravel(), bias + self._mean @ weights, rest])

    def parameters(self, coordinates: Array) -> Array:
        """Invert :meth:`coordinates`; weights of components that do not occur are zero."""
        whitened, bias, rest = self._split(coordinates, len(self._size))
        weights = (self._components / self._size) @ whitened
        return np.concatenate([weights.ravel(), bias - self._mean @ weights, rest])

    def gradient(self, gradient: Array) -> Array:
        """Return the gradient with respect to the coordinates, given that to the parameters."""
        weights, bias, rest = self._split(gradient, len(self._mean))
        whitened = (self._components / self._size).T @ (weights - np.outer(self._mean, bias))
        return np.concatenate([whitened.ravel(), bias, rest])

    def _split(self, vector: Array, n_in: int) -> tuple[Array, Array, Array]:
        end = n_in * self._width
        weights = vector[:end].reshape(n_in, self._width)
        return weights, vector[end : end + self._width], vector[end + self._width :]
