"""The momentum equation in time, against independent calculations and in both engines."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers import loss_and_gradient_of
from scipy.integrate import solve_ivp

from pcnde_bridge.config import PAPER
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_temporal_flow
from pcnde_bridge.engines.types import FitData
from pcnde_bridge.errors import SolveError

N_TIMES, N_POINTS, N_CASES = 12, 7, 2
GRID = Grid(np.arange(N_TIMES) / N_TIMES, np.linspace(0.0, 4.0, N_POINTS), 1.0)


@pytest.fixture(
    scope="module",
    params=[
        "jax",
        pytest.param(
            "julia",
            marks=[
                pytest.mark.julia,
            ],
        ),
    ],
)
def engine(request):
    return select_engine(request.param)


def settings(**changes):
    return PAPER.replace(temporal_flow={"hidden": (4, 3), **changes})


def problem(config, seed=0):
    """Parameters, inputs and target that no symmetry makes easy."""
    rng = np.random.default_rng(seed)
    vector = initial_temporal_flow(config, N_POINTS, seed)
    inflow = 1 + 0.3 * np.sin(2 * np.pi * GRID.time + rng.uniform(0, 6, (N_CASES, 1)))
    initial = inflow[:, :1] + 0.1 * rng.normal(size=(N_CASES, N_POINTS))
    initial[:, 0] = inflow[:, 0]
    target = rng.normal(size=(N_CASES, N_TIMES, N_POINTS))
    return vector + 0.1 * rng.normal(size=vector.size), (inflow, initial), target


def rate_of(vector, config):
    """f_θ(Q, t) by plain numpy."""
    stage = config.temporal_flow
    widths = (N_POINTS + stage.time_input, *stage.hidden, N_POINTS)

    def rate(t, q):
        values = np.append(q, t) if stage.time_input else q
        start = 0
        for layer, (n_in, n_out) in enumerate(pairwise(widths)):
            weight = vector[start : start + n_in * n_out].reshape(n_out, n_in, order="F")
            start += n_in * n_out
            values = weight @ values + vector[start : start + n_out]
            start += n_out
            if layer < len(widths) - 2:
                values = np.tanh(values)
        return values

    return rate


@pytest.mark.parametrize("time_input", [False, True])
def test_the_inlet_is_exact(engine, time_input):
    config = settings(time_input=time_input, steps=2)
    vector, inputs, _ = problem(config)
    flow = engine.temporal_flow.solve(vector, inputs, GRID, config)
    assert flow.shape == (N_CASES, N_TIMES, N_POINTS)
    np.testing.assert_array_equal(flow[:, :, 0], inputs[0])
    np.testing.assert_array_equal(flow[:, 0], inputs[1])


@pytest.mark.parametrize("time_input", [False, True])
def test_steps_are_those_of_runge_kutta_with_the_inlet_after_each(engine, time_input):
    config = settings(time_input=time_input, steps=2)
    vector, inputs, _ = problem(config)
    found = engine.temporal_flow.solve(vector, inputs, GRID, config)
    f, h = rate_of(vector, config), 1 / (2 * N_TIMES)
    for case in range(N_CASES):
        q = inputs[1][case].copy()
        for number in range(2 * (N_TIMES - 1)):
            t = number * h
            k1 = f(t, q)
            k2 = f(t + h / 2, q + h / 2 * k1)
            k3 = f(t + h / 2, q + h / 2 * k2)
            k4 = f(t + h, q + h * k3)
            q = q + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            q[0] = np.interp(t + h, GRID.time, inputs[0][case])
            if number % 2:
                np.testing.assert_allclose(found[case, number // 2 + 1], q, rtol=1e-12)


def test_halved_steps_have_a_sixteenth_of_the_error(engine):
    config = settings(time_input=True)
    vector, inputs, _ = problem(config)
    # The network moves the inlet as the inflow does, so that setting it changes nothing.
    vector = 3 * vector
    last = vector[-4 * N_POINTS :]  # last layer: weights (z, 3), then bias
    last[: 3 * N_POINTS : N_POINTS], last[3 * N_POINTS] = 0.0, 0.5
    inflow = inputs[0][:, :1] + 0.5 * GRID.time
    inputs = inflow, inputs[1]
    exact = np.stack(
        [
            solve_ivp(rate_of(vector, config), (0, GRID.time[-1]), q, rtol=1e-12, atol=1e-13).y[
                :, -1
            ]
            for q in inputs[1]
        ]
    )
    errors = []
    for steps in (1, 2, 4):
        k = config.replace(temporal_flow={"steps": steps})
        flow = engine.temporal_flow.solve(vector, inputs, GRID, k)
        errors.append(np.abs(flow[:, -1] - exact).max())
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert errors[0] > 1e-9
    np.testing.assert_allclose(orders, 4.0, atol=0.4)


@pytest.mark.parametrize("changes", [{}, {"time_input": True, "steps": 2, "activation": "gelu"}])
def test_gradient_agrees_with_finite_differences(engine, changes):
    config = settings(**changes)
    vector, inputs, target = problem(config)

    def loss_and_gradient(x):
        return loss_and_gradient_of(engine.temporal_flow, x, inputs, target, GRID, config)

    loss, gradient = loss_and_gradient(vector)
    flow = engine.temporal_flow.solve(vector, inputs, GRID, config)
    assert loss == pytest.approx(((flow - target) ** 2).mean(), rel=1e-12)
    rng = np.random.default_rng(5)
    for _ in range(3):
        direction = rng.normal(size=vector.size)
        h = 1e-5
        rise = loss_and_gradient(vector + h * direction)[0]
        fall = loss_and_gradient(vector - h * direction)[0]
        assert (rise - fall) / (2 * h) == pytest.approx(gradient @ direction, rel=1e-6)


def test_many_losses_are_those_of_each(engine):
    config = settings()
    vector, inputs, target = problem(config)
    scale = np.arange(5.0)[:, None]
    many = vector + scale * np.random.default_rng(0).normal(size=(5, vector.size))
    many[4] = 1e200
    found = engine.temporal_flow.losses(many, FitData(inputs, target, GRID, config))
    one = [
        loss_and_gradient_of(engine.temporal_flow, x, inputs, target, GRID, config)[0] for x in many
    ]
    np.testing.assert_allclose(found, one, rtol=1e-10)
    assert np.isinf(found[4])


def test_divergence_is_an_error_with_advice(engine):
    config = settings()
    vector, inputs, target = problem(config)
    with pytest.raises(SolveError, match="case 0"):
        engine.temporal_flow.solve(np.full_like(vector, np.nan), inputs, GRID, config)
    broken = np.full_like(vector, np.nan)
    assert (
        loss_and_gradient_of(engine.temporal_flow, broken, inputs, target, GRID, config)[0]
        == np.inf
    )


@pytest.mark.julia
@pytest.mark.parametrize("changes", [{}, {"time_input": True, "steps": 3, "hidden": (5,)}])
def test_engines_agree(changes):
    config = settings(**changes)
    vector, inputs, target = problem(config, seed=2)
    julia, jax = (
        (
            e.temporal_flow.solve(vector, inputs, GRID, config),
            *loss_and_gradient_of(e.temporal_flow, vector, inputs, target, GRID, config),
            e.temporal_flow.fit(vector, FitData(inputs, target, GRID, config), 4).losses,
        )
        for e in (select_engine("julia"), select_engine("jax"))
    )
    for by_julia, by_jax in zip(julia[:3], jax[:3], strict=True):
        np.testing.assert_allclose(by_julia, by_jax, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(julia[3], jax[3], rtol=1e-7)
