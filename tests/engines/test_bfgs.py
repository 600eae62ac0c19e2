"""The optimizer against a dense BFGS matrix, and where trial steps diverge."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pcnde_bridge.config.settings import BFGS
from pcnde_bridge.engines.jax.bfgs import minimize
from pcnde_bridge.errors import SolveError


def rosenbrock(x):
    value = np.sum(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)
    gradient = np.zeros_like(x)
    gradient[:-1] = -400 * x[:-1] * (x[1:] - x[:-1] ** 2) - 2 * (1 - x[:-1])
    gradient[1:] += 200 * (x[1:] - x[:-1] ** 2)
    return float(value), gradient


def dense_bfgs(function, x, settings, iterations):
    """Textbook BFGS with the inverse Hessian as a matrix, and the same line search."""
    loss, gradient = function(x)
    h = np.eye(len(x)) * settings.initial_step_norm / np.abs(gradient).max()
    losses = [loss]
    for _ in range(iterations):
        direction = -h @ gradient
        slope = gradient @ direction
        step, previous, previous_loss = 1.0, None, None
        while (trial := function(x + step * direction)[0]) > loss + 1e-4 * step * slope:
            if previous is None:
                new = -slope * step**2 / (2 * (trial - loss - slope * step))
            else:
                # Coefficients of the cubic through both trial steps.
                matrix = np.array([[step**3, step**2], [previous**3, previous**2]])
                right = np.array(
                    [trial - loss - slope * step, previous_loss - loss - slope * previous]
                )
                a, b = np.linalg.solve(matrix, right)
                new = (-b + math.sqrt(max(b**2 - 3 * a * slope, 0))) / (3 * a)
            previous, previous_loss = step, trial
            step = min(max(new, 0.1 * step), 0.5 * step)
        change = step * direction
        x = x + change
        loss, new_gradient = function(x)
        y = new_gradient - gradient
        gradient = new_gradient
        losses.append(loss)
        if (curvature := change @ y) > 0:
            left = np.eye(len(x)) - np.outer(change, y) / curvature
            h = left @ h @ left.T + np.outer(change, change) / curvature
    return x, np.array(losses)


@pytest.mark.parametrize("n", [2, 10, 40])
def test_same_iterates_as_a_dense_inverse_hessian(n):
    start = np.linspace(-1.2, 1.1, n)
    expected, losses = dense_bfgs(rosenbrock, start, BFGS(), 25)
    fit = minimize(lambda x: rosenbrock(x)[0], rosenbrock, start, BFGS(), 25)
    np.testing.assert_allclose(fit.losses, losses, rtol=1e-7)
    np.testing.assert_allclose(fit.parameters, expected, rtol=1e-6)


def test_finds_the_minimum_and_says_so():
    fit = minimize(lambda x: rosenbrock(x)[0], rosenbrock, np.array([-1.2, 1.0]), BFGS(), 500)
    assert fit.converged
    assert fit.message == "gradient tolerance"
    np.testing.assert_allclose(fit.parameters, 1, atol=1e-7)
    assert (np.diff(fit.losses) <= 0).all()


def test_convergence_on_the_last_iteration_is_reported():
    def fit(iterations):
        start = np.array([-1.2, 1.0])
        return minimize(lambda x: rosenbrock(x)[0], rosenbrock, start, BFGS(), iterations)

    needed = len(fit(500).losses) - 1
    assert (fit(needed).converged, fit(needed).message) == (True, "gradient tolerance")
    assert (fit(needed - 1).converged, fit(needed - 1).message) == (False, "all iterations done")


def test_first_step_is_initial_step_norm_long():
    settings = BFGS(initial_step_norm=0.01)
    fit = minimize(lambda x: float(x @ x), lambda x: (float(x @ x), 2 * x), np.ones(3), settings, 1)
    np.testing.assert_allclose(fit.parameters, 0.99)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_diverging_trial_step_backtracks(bad):
    """Loss is finite only close to the start: the step must come back there."""

    def value(x):
        return float(np.sum((x - 3) ** 2)) if np.abs(x).max() < 0.005 else bad

    fit = minimize(
        value, lambda x: (value(x), 2 * (x - 3)), np.zeros(4), BFGS(initial_step_norm=1.0), 3
    )
    assert np.isfinite(fit.losses).all()
    assert 0 < fit.parameters.max() < 0.005


def test_loss_that_is_never_finite_again_ends_the_fit_with_the_start():
    def value(x):
        return 1.0 if not x.any() else math.nan

    fit = minimize(value, lambda x: (value(x), np.ones(2)), np.zeros(2), BFGS(), 5)
    assert fit.message == "line search found no lower loss"
    assert not fit.parameters.any()
    assert fit.losses.tolist() == [1.0]


def test_no_finite_loss_at_the_start_is_an_error():
    with pytest.raises(SolveError, match="not finite at the first parameters"):
        minimize(lambda x: math.inf, lambda x: (math.inf, np.ones(2)), np.zeros(2), BFGS(), 5)


def test_iterations_are_reported_and_may_be_interrupted():
    seen = []

    def stop_at_three(number, loss):
        seen.append((number, loss))
        if number == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimize(lambda x: rosenbrock(x)[0], rosenbrock, np.zeros(5), BFGS(), 10, stop_at_three)
    assert [number for number, _ in seen] == [1, 2, 3]
    assert seen[0][1] > seen[2][1]


def test_start_at_the_minimum_does_nothing():
    fit = minimize(lambda x: rosenbrock(x)[0], rosenbrock, np.ones(4), BFGS(), 10)
    assert fit.converged
    assert len(fit.losses) == 1
