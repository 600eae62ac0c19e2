"""BFGS as in Optim.jl, with the BackTracking line search of LineSearches.jl.

The paper's fits are short: 5 to 250 iterations for up to 2724 parameters, each
starting from a scaled identity as inverse Hessian.  The inverse Hessian is therefore not
formed: its product with the gradient is computed from the stored pairs of steps
and gradient changes (Nocedal and Wright 2006, algorithm 7.4, with all pairs),
which equals the product with the BFGS matrix up to round-off and costs 4·k·n operations
instead of 4·n².
"""

import math
from collections.abc import Callable

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config.settings import BFGS
from pcnde_bridge.engines.types import Fit, Objective, OnIteration, check_start, ignore, is_finite

Value = Callable[[Array], float]
"""Loss at a vector; where it is infinite or NaN, the step is shortened."""


def minimize(
    value: Value,
    value_and_gradient: Objective,
    start: Array,
    settings: BFGS,
    iterations: int,
    on_iteration: OnIteration = ignore,
) -> Fit:
    """Minimize a function of a vector.

    Parameters
    ----------
    value : callable
        Loss at a vector of shape (n,), for the line search.
    value_and_gradient : callable
        Loss and its gradient of shape (n,).
    start : array of shape (n,)
        First iterate.
    settings : BFGS
        Initial step, line search and tolerance.
    iterations : int
        Maximum number of iterations.
    on_iteration : callable
        Called with the number and loss of each iteration; it may raise to stop.

    Returns
    -------
    Fit
        The last accepted iterate.

    Raises
    ------
    SolveError
        If the loss or its gradient is not finite at the start.
    """
    x = np.array(start, dtype=np.float64)
    loss, gradient = value_and_gradient(x)
    check_start(loss, gradient)
    losses, inverse_hessian = [loss], _InverseHessian(gradient, settings)
    converged, message = _largest(gradient) <= settings.gradient_tolerance, "gradient tolerance"
    while not converged:
        if len(losses) > iterations:
            message = "all iterations done"
            break
        step = _line_search(value, x, loss, gradient, -(inverse_hessian @ gradient), settings)
        if step is None:
            # Optim.jl discards the curvature and tries steepest descent once.
            inverse_hessian.reset(gradient)
            step = _line_search(value, x, loss, gradient, -gradient, settings)
        if step is None:
            message = "line search found no lower loss"
            break
        candidate = x + step
        new_loss, new_gradient = value_and_gradient(candidate)
        if not is_finite(new_loss, new_gradient):
            message = "loss or gradient not finite"
            break
        change = candidate - x
        inverse_hessian.update(change, new_gradient - gradient)
        unchanged = new_loss == loss or not change.any()
        x, loss, gradient = candidate, new_loss, new_gradient
        losses.append(loss)
        on_iteration(len(losses) - 1, loss)
        converged = unchanged or _largest(gradient) <= settings.gradient_tolerance
        message = "no change" if unchanged else "gradient tolerance"
    return Fit(x, np.array(losses), converged, message)


def _largest(vector: Array) -> float:
    return float(np.abs(vector).max())


class _InverseHessian:
    """γ·I and the rank-two updates since, stored as pairs of steps and gradient changes."""

    def __init__(self, gradient: Array, settings: BFGS) -> None:
        self._step_norm = settings.initial_step_norm
        self.reset(gradient)

    def reset(self, gradient: Array) -> None:
        """Discard the updates, and scale the identity to the gradient."""
        largest = _largest(gradient)
        self._scale = self._step_norm / largest if largest > 0 else 1.0
        self._pairs: list[tuple[Array, Array, float]] = []

    def update(self, change: Array, gradient_change: Array) -> None:
        """Add the pair of a step, unless its curvature is not positive."""
        curvature = float(change @ gradient_change)
        if curvature > 0:
            self._pairs.append((change, gradient_change, 1.0 / curvature))

    def __matmul__(self, vector: Array) -> Array:
        result = vector.copy()
        weights = []
        for change, gradient_change, rho in reversed(self._pairs):
            weights.append(rho * (change @ result))
            result -= weights[-1] * gradient_change
        result *= self._scale
        pairs = zip(self._pairs, reversed(weights), strict=True)
        for (change, gradient_change, rho), weight in pairs:
            result += (weight - rho * (gradient_change @ result)) * change
        return result


def _line_search(
    value: Value, x: Array, loss: float, gradient: Array, direction: Array, settings: BFGS
) -> Array | None:
    """Return the step from x along a direction that decreases the loss enough, or None.

    Its length is found by cubic interpolation.
    """
    slope = float(gradient @ direction)
    if not slope < 0:
        return None
    before, step = 1.0, 1.0
    loss_before, loss_at = loss, value(x + direction)
    # Where a solve diverges the loss is not finite: halve the step until it is, up to machine
    # precision.
    while not math.isfinite(loss_at):
        before, step = step, step / 2
        if step <= np.finfo(float).eps:
            return None
        loss_at = value(x + step * direction)
    for backtrack in range(settings.max_backtracks + 1):
        if loss_at <= loss + settings.sufficient_decrease * step * slope:
            return step * direction
        excess = loss_at - loss - slope * step
        if backtrack == 0:
            trial = -(slope * step**2) / (2 * excess)
        else:
            trial = _cubic_minimum(before, step, loss_before - loss - slope * before, excess, slope)
        before, loss_before = step, loss_at
        largest = step * settings.shrink_least
        trial = largest if math.isnan(trial) else min(trial, largest)
        step = max(trial, step * settings.shrink_most)
        if step == 0:
            break
        loss_at = value(x + step * direction)
    return None


def _cubic_minimum(a: float, b: float, excess_a: float, excess_b: float, slope: float) -> float:
    """Return the minimum of the cubic through the start, its slope, and two trial steps."""
    volume = a**2 * b**2 * (b - a)
    if volume == 0:
        return math.nan
    scale = 1.0 / volume
    cubic = (a**2 * excess_b - b**2 * excess_a) * scale
    square = (-(a**3) * excess_b + b**3 * excess_a) * scale
    if abs(cubic) <= np.finfo(float).eps:
        return slope / (2 * square) if square else math.nan
    return (-square + math.sqrt(max(square**2 - 3 * cubic * slope, 0.0))) / (3 * cubic)
