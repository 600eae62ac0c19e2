"""L-BFGS in whitened weights, with early stopping: how preset ``fast`` fits a network."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import FullBatch
from pcnde_bridge.engines.types import LBFGS, Objective, OnIteration
from pcnde_bridge.errors import SolveError

_DIVERGED = 10.0  # loss of a diverging trial step, in units of the first loss
_TINY = 1e-300


class Whitening:
    """Coordinates of a network's first layer in which its inputs are alike.

    The inputs of all cases, instants and points lie close to a plane of few dimensions,
    and in it their spread differs a hundredfold: the loss is then a narrow valley.  With
    the inputs u = m + Σ_i √λ_i ξ_i e_i, by principal components, the first layer

        W·u + c = V·ξ' + d,   ξ'_i = e_i·(u − m) / √(λ_i + ε·λ_max)

    has the coordinates V and d in place of W and c.  Components that the inputs do not
    show have no coordinate: their weights are zero.

    Parameters
    ----------
    inputs : array of shape (sample, in)
        What the network sees.
    width : int
        Of the first hidden layer.
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
        """ξ' of inputs, (..., component)."""
        result: Array = (inputs - self._mean) @ (self._components / self._size)
        return result

    def coordinates(self, parameters: Array) -> Array:
        """Of a network's parameters: V, d, and the other layers as they are."""
        weights, bias, rest = self._split(parameters, len(self._mean))
        ours = (self._components * self._size).T @ weights
        return np.concatenate([ours.ravel(), bias + self._mean @ weights, rest])

    def parameters(self, coordinates: Array) -> Array:
        """Inverse of :meth:`coordinates`, the unseen components' weights being zero."""
        ours, bias, rest = self._split(coordinates, len(self._size))
        weights = (self._components / self._size) @ ours
        return np.concatenate([weights.ravel(), bias - self._mean @ weights, rest])

    def gradient(self, gradient: Array) -> Array:
        """By the coordinates, from that by the parameters."""
        weights, bias, rest = self._split(gradient, len(self._mean))
        ours = (self._components / self._size).T @ (weights - np.outer(self._mean, bias))
        return np.concatenate([ours.ravel(), bias, rest])

    def _split(self, vector: Array, n_in: int) -> tuple[Array, Array, Array]:
        end = n_in * self._width
        weights = vector[:end].reshape(n_in, self._width)
        return weights, vector[end : end + self._width], vector[end + self._width :]


def minimise(
    objective: Objective,
    start: Array,
    settings: FullBatch,
    iterations: int,
    unit: float,
    validate: Callable[[Array], float] | None = None,
    on_iteration: OnIteration | None = None,
    *,
    lbfgs: LBFGS,
) -> Array:
    """Minimise objective(x)/unit + weight_decay·|x|².

    Parameters
    ----------
    objective : callable
        Loss and gradient.  Where the loss is not finite the step is shortened.
    start : array of shape (n,)
        First iterate.
    settings : FullBatch
        Memory, weight decay and patience.
    iterations : int
        At most so many.
    unit : float
        The loss's size, against which the weight decay is measured.
    validate : callable, optional
        Error on cases that the objective does not know; asked every few iterations, it
        ends the fit once it has not fallen for ``settings.patience`` iterations.
    on_iteration : callable, optional
        Called with the number and loss of each iteration; may raise to stop.
    lbfgs : callable
        Runs the iterations; see :meth:`pcnde_bridge.engines.protocol.Engine.lbfgs`.

    Returns
    -------
    array of shape (n,)
        The iterate of the least validation error, or the last one.

    Raises
    ------
    SolveError
        If the loss is not finite at the start.
    """
    first, _ = objective(start)
    if not math.isfinite(first):
        raise SolveError(
            f"The loss is not finite at the first parameters of the fit (loss {first}): the "
            "equation diverges there. Check the data's units, or start from another seed."
        )
    ceiling = _DIVERGED * (first / unit + settings.weight_decay * float(start @ start))

    number, last, judged = 0, start, 0
    best, best_error, best_number = start, math.inf, 0

    def total(x: Array) -> tuple[float, Array]:
        loss, gradient = objective(x)
        if not (math.isfinite(loss) and np.isfinite(gradient).all()):
            # A wall, which rises from the last iterate on.
            way = x - last
            return ceiling, way * (2 * ceiling / max(float(way @ way), _TINY))
        decay = settings.weight_decay
        return loss / unit + decay * float(x @ x), gradient / unit + 2 * decay * x

    def after(x: Array, value: float) -> None:
        nonlocal number, last, judged, best, best_error, best_number
        number, last = number + 1, x
        if on_iteration is not None:
            on_iteration(number, (value - settings.weight_decay * float(x @ x)) * unit)
        if validate is None:
            best = x
        elif number % settings.check_every == 0 or number == iterations:
            error, judged = validate(x), number
            if error < best_error:
                best, best_error, best_number = x, error, number
            elif number - best_number >= settings.patience:
                raise StopIteration

    lbfgs(total, start, settings.memory, iterations, after)
    # It may have converged between two questions.
    if validate is not None and judged < number and validate(last) < best_error:
        return last
    return best
