"""Each stage of the JAX engine against an independent calculation."""

from __future__ import annotations

import pickle
import subprocess
import sys
from itertools import pairwise
from unittest.mock import Mock

import jax
import numpy as np
import pytest
from helpers import loss_and_gradient_of, solve
from scipy.integrate import cumulative_trapezoid, solve_ivp

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PAPER, PUBLISHED_CODE
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.jax.stage import on_device
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import FitData, ModelInputs
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.pressure_losses import pressure_drop

TIGHT = PAPER.replace(flow={"rtol": 1e-10, "atol": 1e-12, "max_steps": 1024})
EQUAL = PAPER.replace(flow={"steps": 12})  # quickly compiled, where the steps do not matter


@pytest.fixture(scope="module")
def engine():
    return select_engine("jax")


@pytest.fixture(scope="module")
def grid(small_cases):
    return small_cases.grid


def test_it_travels_to_another_process_as_a_name(engine):
    assert pickle.loads(pickle.dumps(type(engine)())) is engine  # noqa: S301


@pytest.fixture(scope="module")
def parameters(small_cases):
    """Random corrections too, so that no term of an equation is zero or one."""
    first = initial_parameters(PAPER, small_cases.n_times, small_cases.n_points, seed=3)
    rng = np.random.default_rng(4)
    return first.replace(
        **{name: vector + 0.1 * rng.normal(size=vector.size) for name, vector in first}
    )


def stage_case(name, cases):
    """Inputs and target of a stage.

    The flow stage sees areas that are linear in z: where S has a kink at every
    point, a change of parameters moves steps across kinks, and finite
    differences see that.
    """
    taper = np.linspace(1.0, 0.6, cases.n_points)
    p_ref = PAPER.physics.reference_pressure
    p = cases.pressure / p_ref
    return {
        "flow": ((cases.inflow, cases.area[:, :, :1] * taper), cases.flow),
        "intermediate_area": (
            (cases.flow, cases.area_undeformed),
            cases.area,
        ),
        "fourier_area": ((cases.flow, cases.area[:, 0]), cases.area),
        "temporal_pressure": (
            (cases.flow, cases.area, cases.area_undeformed),
            p,
        ),
        "spatial_pressure": ((p, cases.flow, cases.area_undeformed), p),
    }[name]


def network(vector, widths, x, activation=np.tanh):
    """Plain numpy network from the documented layout: W (out × in) by columns, then b."""
    start = 0
    for layer, (n_in, n_out) in enumerate(pairwise(widths)):
        weight = vector[start : start + n_in * n_out].reshape(n_out, n_in, order="F")
        start += n_in * n_out
        x = weight @ x + vector[start : start + n_out]
        start += n_out
        if layer < len(widths) - 2:
            x = activation(x)
    assert start == vector.size
    return x


def test_flow_solves_the_neural_ode_in_the_full_state(engine, grid, parameters, small_cases):
    case = small_cases.select([5])
    n_t = case.n_times

    def right_hand_side(z, q):
        s = np.array([np.interp(z, case.z, row) for row in case.area[0]])
        widths = (2 * n_t, 8, 8, 8, 8, n_t)
        return network(parameters.flow, widths, np.concatenate([q, s]))

    expected = case.inflow[0][:, None] + 0 * case.z
    # One interval at a time: the area's slope jumps at the points.
    for i in range(case.n_points - 1):
        span = case.z[i : i + 2]
        solution = solve_ivp(right_hand_side, span, expected[:, i], rtol=1e-11, atol=1e-13)
        expected[:, i + 1] = solution.y[:, -1]
    inputs = small_cases.inflow, small_cases.area
    tight = engine.flow.solve(parameters.flow, inputs, grid, TIGHT)[5]
    np.testing.assert_allclose(tight, expected, rtol=1e-6, atol=1e-7)
    loose = engine.flow.solve(parameters.flow, inputs, grid, PAPER)[5]
    np.testing.assert_allclose(loose, expected, rtol=5e-3, atol=2e-3)
    np.testing.assert_array_equal(loose[:, 0], case.inflow[0])


def test_intermediate_area_solves_continuity_over_three_cycles(
    engine, grid, parameters, small_cases
):
    a, b = np.split(parameters.intermediate_area, 2)
    inputs, _ = stage_case("intermediate_area", small_cases)
    found = engine.intermediate_area.solve(parameters.intermediate_area, inputs, grid, PAPER)
    slope = np.gradient(small_cases.flow, grid.z, axis=2, edge_order=2)
    time = np.arange(60) * grid.period / 20
    integral = cumulative_trapezoid(np.tile(slope, (1, 3, 1)), time, axis=1, initial=0)
    expected = small_cases.area_undeformed[:, None] - a * integral + b * time[:, None]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


def test_intermediate_area_is_what_tsit5_gives_with_a_step_for_each_time_point(
    engine, grid, parameters, small_cases
):
    """The published code's solver, for one point of one case."""
    import diffrax
    import jax.numpy as jnp

    a, b = np.split(parameters.intermediate_area, 2)
    inputs, _ = stage_case("intermediate_area", small_cases)
    found = engine.intermediate_area.solve(parameters.intermediate_area, inputs, grid, PAPER)
    slope = np.gradient(small_cases.flow[7], grid.z, axis=1, edge_order=2)[:, 10]
    step = grid.period / 20
    with double_precision():
        knots, values = jnp.arange(61) * step, jnp.asarray(np.tile(slope, 4)[:61])
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, s, _: -a[10] * jnp.interp(t, knots, values) + b[10]),
            diffrax.Tsit5(),
            0.0,
            59 * step,
            step,
            jnp.asarray(small_cases.area_undeformed[7, 10]),
            saveat=diffrax.SaveAt(steps=True, t0=True),
            max_steps=64,
        )
        expected = np.asarray(solution.ys)[:60]
    np.testing.assert_allclose(found[7, :, 10], expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("config", [PAPER, PUBLISHED_CODE], ids=["paper", "published code"])
def test_fourier_area_is_the_series_of_the_paper(engine, grid, parameters, small_cases, config):
    a, b = np.split(parameters.fourier_area, 2)
    inputs, _ = stage_case("fourier_area", small_cases)
    found = engine.fourier_area.solve(parameters.fourier_area, inputs, grid, config)
    slope = np.gradient(small_cases.flow, grid.z, axis=2, edge_order=2)
    coefficients = np.fft.fft(slope, axis=1) / 20
    area = np.zeros_like(small_cases.flow)
    published = config is PUBLISHED_CODE
    for n in range(1, 10):
        omega = 2 * np.pi * (n + published) / grid.period
        wave = np.exp(2j * np.pi * n * np.arange(20) / 20)[:, None]
        term = (-a / (1j * omega) * coefficients[:, n, None] * wave).real
        area += term if published else 2 * term
    area += (small_cases.area[:, 0] - area[:, 0] + b)[:, None]
    np.testing.assert_allclose(found, area, rtol=1e-12)


def test_fourier_area_is_periodic_and_obeys_continuity(engine, grid, small_cases):
    """With a = 1 the series integrates −∂Q/∂z exactly, for as many harmonics as it has."""
    inputs, _ = stage_case("fourier_area", small_cases)
    plain = initial_parameters(PAPER, 20, 21, seed=0).fourier_area
    area = engine.fourier_area.solve(plain, inputs, grid, PAPER)
    slope = np.gradient(small_cases.flow, grid.z, axis=2, edge_order=2)
    frequency = 2j * np.pi * np.fft.rfftfreq(20, grid.period / 20)[:, None]
    rate = np.fft.irfft(frequency * np.fft.rfft(area, axis=1), 20, axis=1)
    fluctuation = slope - slope.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(rate, -fluctuation, atol=1e-12 + 1e-9 * np.abs(slope).max())
    np.testing.assert_allclose(area[:, 0], small_cases.area[:, 0], rtol=1e-12)


def test_temporal_pressure_is_the_network_at_each_time_point(engine, grid, parameters, small_cases):
    inputs, _ = stage_case("temporal_pressure", small_cases)
    found = engine.temporal_pressure.solve(parameters.temporal_pressure, inputs, grid, PAPER)
    case, t = 8, 13
    s, s_u = small_cases.area[case, t], small_cases.area_undeformed[case]
    q = small_cases.flow[case, t]
    drop = pressure_drop(q, s_u[0], s_u.min(), 0.5) / 133_322.0
    x = np.concatenate([s, s - s_u, drop, q])
    g = network(parameters.temporal_pressure, (84, 2, 2, 21), x)
    stiffness = 1.5e7 * 0.05 / np.sqrt(s_u[0] / np.pi)
    np.testing.assert_allclose(found[case, t], 1 + stiffness / 133_322.0 * g, rtol=1e-12)


@pytest.mark.parametrize("form", ["continuous", "printed"])
def test_spatial_pressure_is_constant_tanh_constant(engine, grid, parameters, small_cases, form):
    inputs, _ = stage_case("spatial_pressure", small_cases)
    config = PAPER.replace(spatial_pressure={"form": form})
    found = engine.spatial_pressure.solve(parameters.spatial_pressure, inputs, grid, config)
    a1, a2 = parameters.spatial_pressure[:2]
    b1, b2 = np.split(parameters.spatial_pressure[2:], 2)
    case, t = 6, 4
    s_u = small_cases.area_undeformed[case]
    q = np.interp(2.0, grid.z, small_cases.flow[case, t])
    drop = pressure_drop(q, s_u[0], s_u.min(), 0.5, turbulent_coefficient=1.52 + a2) / 133_322.0
    upstream = inputs[0][case, t].mean() + a1
    expected = np.empty(21)
    for i, z in enumerate(grid.z):
        step = np.tanh(10 * b2[t] * (min(z, 8 / 3) - 2))
        if form == "printed":
            expected[i] = upstream - (drop + b1[t]) * step if z > 4 / 3 else upstream
        else:
            step = np.tanh(10 * b2[t] * (np.clip(z, 4 / 3, 8 / 3) - 2))
            expected[i] = upstream - (drop + b1[t]) * step / 2
    np.testing.assert_allclose(found[case, t], expected, rtol=1e-12)


@pytest.mark.parametrize(
    "stage",
    ["flow", "intermediate_area", "fourier_area", "temporal_pressure", "spatial_pressure"],
)
def test_gradient_agrees_with_finite_differences(engine, grid, parameters, small_cases, stage):
    inputs, target = stage_case(stage, small_cases)
    vector = getattr(parameters, stage)
    one = getattr(engine, stage)
    loss, gradient = loss_and_gradient_of(one, vector, inputs, target, grid, TIGHT)
    assert gradient.shape == vector.shape
    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = rng.normal(size=vector.size)
        direction /= np.linalg.norm(direction)
        h = 1e-4
        steps = [
            loss_and_gradient_of(one, vector + k * h * direction, inputs, target, grid, TIGHT)[0]
            for k in (-2, -1, 1, 2)
        ]
        finite = (steps[0] - 8 * steps[1] + 8 * steps[2] - steps[3]) / (12 * h)
        assert finite == pytest.approx(gradient @ direction, rel=1e-6, abs=1e-9 * abs(loss))


@pytest.mark.parametrize("stage", ["flow", "fourier_area"])
def test_loss_is_the_mean_square_and_padding_does_not_count(
    engine, grid, parameters, small_cases, stage
):
    """Nine cases are padded to twelve: neither loss, gradient nor steps may notice."""
    nine = small_cases.select(slice(0, 9))
    inputs, target = stage_case(stage, nine)
    vector = getattr(parameters, stage)
    loss, gradient = loss_and_gradient_of(
        getattr(engine, stage), vector, inputs, target, grid, TIGHT
    )
    predicted = getattr(engine, stage).solve(vector, inputs, grid, TIGHT)
    assert loss == pytest.approx(np.mean((predicted - target) ** 2), rel=1e-7)
    everything = FitData(*stage_case(stage, small_cases), grid, TIGHT)
    parts = [
        getattr(engine, stage).objective(everything, (np.arange(12) // 3 == third))(vector)[1]
        for third in range(3)
    ]
    np.testing.assert_allclose(gradient, np.mean(parts, axis=0), rtol=1e-5)
    padded = getattr(engine, stage).losses(vector[None], FitData(inputs, target, grid, TIGHT))
    assert padded == pytest.approx([loss], rel=1e-12)
    fit = getattr(engine, stage).fit(vector, FitData(inputs, target, grid, TIGHT), 1)
    descent = fit.parameters - vector  # along the gradient
    np.testing.assert_allclose(
        descent / np.linalg.norm(descent),
        -gradient / np.linalg.norm(gradient),
        rtol=1e-6,
        atol=1e-9,
    )


def test_sum_of_squares_is_the_published_codes_loss(engine, grid, parameters, small_cases):
    inputs, target = stage_case("flow", small_cases)
    summed = EQUAL.replace(flow={"loss": PUBLISHED_CODE.flow.loss})
    mean, total = (
        engine.flow.losses(parameters.flow[None], FitData(inputs, target, grid, config))[0]
        for config in (EQUAL, summed)
    )
    assert total == pytest.approx(mean * target.size, rel=1e-12)


def test_a_case_does_not_depend_on_the_cases_beside_it(engine, grid, parameters, small_cases):
    inputs, _ = stage_case("flow", small_cases)
    together = engine.flow.solve(parameters.flow, inputs, grid, PAPER)
    fewer = tuple(array[11:2:-1] for array in inputs)
    np.testing.assert_allclose(
        engine.flow.solve(parameters.flow, fewer, grid, PAPER), together[11:2:-1], rtol=1e-8
    )


def test_more_cases_than_one_batch(engine, grid, parameters, small_cases):
    inputs, _ = stage_case("flow", small_cases)
    many = (np.tile(inputs[0], (12, 1)), np.tile(inputs[1], (12, 1, 1)))
    found = engine.flow.solve(parameters.flow, many, grid, EQUAL)
    assert found.shape == (144, 20, 21)
    np.testing.assert_allclose(found[132:], found[:12], rtol=1e-12)


def test_divergence_is_an_infinite_loss_and_an_error_of_solve(
    engine, grid, parameters, small_cases
):
    inputs, target = stage_case("flow", small_cases)
    impatient = PAPER.replace(flow={"max_steps": 2})
    data = FitData(inputs, target, grid, impatient)
    assert engine.flow.losses(parameters.flow[None], data) == [np.inf]
    with pytest.raises(SolveError, match="case 0"):
        engine.flow.solve(parameters.flow, inputs, grid, impatient)


def test_compiled_functions_of_adaptive_steps_can_be_stored(engine, grid, parameters, small_cases):
    """JAX does not store functions with callbacks; see the setting in ``cli.main.run``."""
    inputs, _ = stage_case("flow", small_cases)
    with double_precision():
        solve = jax.jit(engine.flow._predict, static_argnames="config")
        traced = solve.lower(parameters.flow, inputs, grid=on_device(grid), config=PAPER)
    assert "while" in traced.as_text()
    assert "callback" not in traced.as_text()


def test_one_shape_is_compiled_once(engine, grid, parameters, small_cases, monkeypatch):
    stage = type(engine)().fourier_area
    model = Mock(wraps=stage._model)  # called when it is compiled, then no more
    monkeypatch.setattr(stage, "_model", model)
    calls = []
    for count in (9, 12, 10, 12):
        inputs, target = stage_case("fourier_area", small_cases.select(slice(0, count)))
        stage.fit(parameters.fourier_area, FitData(inputs, target, grid, PAPER), 1)
        calls.append(model.call_count)
    assert calls == calls[:1] * 4
    assert calls[0] > 0


def test_the_users_jax_precision_stays_as_it_was():
    code = (
        "import numpy as np, jax.numpy as jnp\n"
        "from pcnde_bridge.engines import select_engine\n"
        "from pcnde_bridge.data.grid import Grid\n"
        "from pcnde_bridge import PAPER\n"
        "e = select_engine('jax')\n"
        "q = np.ones((1, 20, 5)); p = np.ones(10)\n"
        "g = Grid(np.arange(20) / 20, np.linspace(0, 4, 5), 1.0)\n"
        "s = e.fourier_area.solve(p, (q, q[:, 0]), g, PAPER)\n"
        "assert s.dtype == np.float64, s.dtype\n"
        "assert jnp.ones(1).dtype == jnp.float32\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_users_stricter_rules_are_not_ours(small_model, small_cases):
    import jax

    expected = small_model.predict(small_cases)
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        found = small_model.predict(small_cases)
        waves = solve()
    assert np.array_equal(found.pressure, expected.pressure)
    assert np.array_equal(waves.pressure, solve().pressure)


@pytest.mark.parametrize("anchor", ["last_time_point", "last_cycle", "undeformed"])
def test_predict_is_the_five_stages_in_their_order(engine, grid, parameters, small_cases, anchor):
    # Round-off in the choice of steps shows up to the accuracy of the solve, which the
    # kinks of S between the points limit to about 1e-8 in each pass.
    config = PUBLISHED_CODE.replace(fourier_area={"anchor": anchor}, flow=TIGHT.flow.to_dict())
    inputs = ModelInputs(small_cases.inflow, small_cases.area_undeformed, grid)
    given = parameters, inputs, config
    whole, by_stages = engine.predict(*given)[:3], predict_by_stages(engine, *given)[:3]
    for fused, staged in zip(whole, by_stages, strict=True):
        np.testing.assert_allclose(fused, staged, rtol=0, atol=1e-6 * np.abs(staged).max())


def test_predict_without_pressure_stages(engine, grid, parameters, small_cases):
    config = PUBLISHED_CODE.replace(flow={"steps": 12})
    given = ModelInputs(small_cases.inflow, small_cases.area_undeformed, grid), config
    whole = engine.predict(parameters, *given)
    bare = engine.predict(parameters.without_pressure(), *given)
    assert bare.pressure is None
    np.testing.assert_allclose(bare.area, whole.area, rtol=1e-12)


def test_the_last_layer_may_have_another_width_than_the_first(engine, grid, small_cases):
    inputs = small_cases.inflow, small_cases.area
    found = []
    for flow in ({"steps": 200}, {"rtol": 1e-10, "atol": 1e-12, "max_steps": 1024}):
        config = PAPER.replace(flow={"hidden": (6, 4), **flow})
        vector = initial_parameters(config, small_cases.n_times, small_cases.n_points, 0).flow
        found.append(engine.flow.solve(vector, inputs, grid, config))
    assert np.abs(found[0] - small_cases.inflow[..., None]).max() > 1e-3
    assert np.allclose(*found, rtol=0, atol=1e-7)


@pytest.mark.parametrize("count", [3, 8])
def test_a_prediction_can_be_written_to(engine, grid, parameters, small_cases, count):
    inputs = ModelInputs(small_cases.inflow[:count], small_cases.area_undeformed[:count], grid)
    solution = engine.predict(parameters, inputs, EQUAL)
    assert all(values.flags.writeable for values in solution[:3])
