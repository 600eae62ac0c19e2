"""Loss landscapes, and the physics terms of the momentum equation on both engines."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import loss_and_gradient_of
from scipy.integrate import solve_ivp

from pcnde_bridge import plots
from pcnde_bridge.config import FAST, PAPER
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import FitData, ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import relative_error
from pcnde_bridge.studies import explore_landscapes
from pcnde_bridge.studies.landscapes import (
    Landscape,
    amplitudes,
    loss_landscape,
)

TERMS = ("friction", "convection", "inertia")


TIGHT = {"rtol": 1e-10, "atol": 1e-12, "max_steps": 4096}


needs_julia = [
    pytest.mark.julia,
]


@pytest.fixture(scope="module", params=["jax", pytest.param("julia", marks=needs_julia)])
def engine(request):
    return select_engine(request.param)


@pytest.fixture(scope="module")
def both():
    return select_engine("julia"), select_engine("jax")


def explore(cases, config, engine):
    sides = {"network": (), "convection": ("convection",)}
    return explore_landscapes(cases, sides, config, engine, points=5, seed=3, progress=False)


@pytest.fixture(scope="module")
def study(small_cases, short_config):
    return explore(small_cases, short_config, "jax")


def flow_problem(cases):
    area = undeformed(cases.area_undeformed, cases.n_times)
    return (cases.inflow, area), cases.grid


def gentle(inputs):
    """Reduce the oscillation: with the inertia term, the full waveform steepens and diverges."""
    inflow, area = inputs
    mean = inflow.mean(axis=1, keepdims=True)
    return mean + 0.05 * (inflow - mean), area


def quiet(vector):
    """Balance the friction by the network: the inertia term is singular where Q is zero."""
    return np.concatenate([0.3 * vector[:-20], np.full(20, 0.35)])


def test_terms_are_those_of_the_momentum_equation(engine, small_cases):
    """Compare all three terms with the equation itself, one interval at a time."""
    case = small_cases.select([1])
    inputs, grid = flow_problem(case)
    inputs = gentle(inputs)
    config = PAPER.replace(flow={"terms": TERMS, "steps": 80, "hidden": (4,)})
    vector = quiet(initial_parameters(config, case.n_times, case.n_points, 0).flow)
    network = vector[: 40 * 4].reshape(4, 40, order="F"), vector[40 * 4 + 4 : -20]
    bias = vector[40 * 4 : 40 * 4 + 4]
    s, ds = (
        case.area_undeformed[0],
        np.gradient(case.area_undeformed[0], case.z, edge_order=2),
    )
    nu, dt = 0.04 / 1.06, case.period / case.n_times

    def right_hand_side(z, q):
        here, slope = np.interp(z, case.z, s), np.interp(z, case.z, ds)
        hidden = np.tanh(network[0] @ np.append(q, np.full(20, here)) + bias)
        f = network[1].reshape(20, 4, order="F") @ hidden
        rise = (np.roll(q, -1) - np.roll(q, 1)) / (2 * dt)
        f = f + vector[-20:]
        return f - 3 * np.pi * nu + q / here * slope / 2 - here / q * rise * 3 / 8

    expected = inputs[0][0][:, None] + 0 * case.z
    for i in range(case.n_points - 1):
        span = case.z[i : i + 2]
        found = solve_ivp(right_hand_side, span, expected[:, i], rtol=1e-9, atol=1e-11)
        assert found.success
        expected[:, i + 1] = found.y[:, -1]
    found = engine.flow.solve(vector, inputs, grid, config)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    adaptive = config.replace(flow={"steps": None, "rtol": 1e-8, "atol": 1e-10, "max_steps": 4096})
    np.testing.assert_allclose(
        engine.flow.solve(vector, inputs, grid, adaptive)[0], expected, rtol=1e-5
    )


def test_gradient_with_all_terms_agrees_with_finite_differences(engine, small_cases):
    cases = small_cases.select([1, 5])
    inputs, grid = flow_problem(cases)
    inputs = gentle(inputs)
    config = PAPER.replace(flow={"terms": TERMS, "steps": 40, "hidden": (4,)})
    vector = quiet(initial_parameters(config, cases.n_times, cases.n_points, 0).flow)

    def loss_and_gradient(x):
        return loss_and_gradient_of(engine.flow, x, inputs, cases.flow, grid, config)

    _, gradient = loss_and_gradient(vector)
    direction = np.random.default_rng(0).normal(size=vector.size)
    h = 1e-5
    finite = (
        loss_and_gradient(vector + h * direction)[0] - loss_and_gradient(vector - h * direction)[0]
    ) / (2 * h)
    assert finite == pytest.approx(gradient @ direction, rel=1e-6)


def test_center_is_the_loss_of_the_parameters(engine, small_cases, short_config):
    inputs, grid = flow_problem(small_cases)
    vector = initial_parameters(short_config, small_cases.n_times, small_cases.n_points, 1).flow
    args = (inputs, small_cases.flow, grid, short_config)
    loss, gradient = loss_and_gradient_of(engine.flow, vector, *args)
    losses = loss_landscape(engine, vector, *args, points=3, amplitude=1e-6, seed=7)
    assert losses.shape == (3, 3)
    assert losses[1, 1] == pytest.approx(loss, rel=1e-12)
    # The first amplitude belongs to the first direction.
    first, second = np.random.default_rng(7).standard_normal((2, vector.size))
    slopes = (losses[2, 1] - losses[0, 1]) / 2e-6, (losses[1, 2] - losses[1, 0]) / 2e-6
    assert slopes == pytest.approx((gradient @ first, gradient @ second), rel=1e-5)


def test_directions_are_those_of_the_seed(engine, small_cases, short_config):
    inputs, grid = flow_problem(small_cases.select([0]))
    vector = initial_parameters(short_config, small_cases.n_times, small_cases.n_points, 1).flow
    target = small_cases.flow[:1]
    first, same, other = (
        loss_landscape(engine, vector, inputs, target, grid, short_config, points=3, seed=seed)
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, same)
    assert not np.allclose(first[0], other[0])


def test_study_evaluates_each_equation_twice(study, small_cases):
    assert study.outcomes["network"] == "trained"
    initial = study.landscape("network", "initial")
    # After the first batch's iterations.
    first_batch = study.history.query(
        "right_hand_side == 'network' and stage == 'flow' and epoch == 1 and batch == 1"
    )
    assert initial.center == pytest.approx(first_batch["loss"].iloc[-1], rel=1e-9)
    # Each equation has two landscapes, unless training diverged before.
    drawn = [(each.right_hand_side, each.moment) for each in study.landscapes]
    assert len(set(drawn)) == len(drawn)
    for name, outcome in study.outcomes.items():
        assert (name, "initial") in drawn
        assert (name, "coupled") in drawn or outcome != "trained"
    frame = study.to_frame()
    centers = frame.query("amplitude_1 == 0 and amplitude_2 == 0")
    assert list(zip(centers["right_hand_side"], centers["moment"], strict=True)) == drawn
    assert len(frame) == 25 * len(drawn)
    np.testing.assert_array_equal(frame["loss"][:25], initial.losses.ravel())
    # The network uses S_u before the coupling, and another area after it.
    inside = np.s_[:, :, 5:-5]
    start, truth = (
        a[inside]
        for a in (undeformed(small_cases.area_undeformed, small_cases.n_times), small_cases.area)
    )
    expected = np.linalg.norm(start - truth) / np.linalg.norm(truth)
    assert initial.area_error == pytest.approx(expected)
    assert study.landscape("network", "coupled").area_error != initial.area_error
    assert len(study.summary()) == len(study.landscapes)


def test_divergence_is_recorded(engine, small_cases, short_config):
    """Two steps of the adaptive solver are too few for all parameters."""
    config = short_config.replace(flow={"steps": None, "max_steps": 2})
    seen = []
    study = explore_landscapes(
        small_cases, {"friction": ("friction",)}, config, engine, points=3, progress=seen.append
    )
    (landscape,) = study.landscapes
    assert landscape.diverged.all()
    assert np.isinf(landscape.center)
    assert study.outcomes == {"friction": "diverged at the first parameters"}
    assert study.to_frame()["diverged"].all()
    assert study.landscape("friction", "coupled") is None
    assert seen == []
    drawn, missing = plots.landscapes(study).axes
    assert drawn.texts[0].get_text() == "diverges\nat all points"
    assert missing.texts[0].get_text() == "diverged\nat the first parameters"


def test_minima_and_roughness():
    along = amplitudes(0.1, np.int64(11))
    x, y = np.meshgrid(along, along, indexing="ij")
    bowl = Landscape("a", "initial", along, np.exp(x**2 + 2 * y**2), 0.0)
    assert (bowl.minima, bowl.center) == (1, 1.0)
    assert bowl.roughness < 1e-12
    noise = np.random.default_rng(0).uniform(1, 2, (11, 11))
    noise[3, 3] = np.inf
    rough = Landscape("a", "initial", along, noise, 0.0)
    assert rough.minima > 3
    assert rough.roughness > 0.5
    assert rough.diverged.sum() == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"points": 4}, "odd"),
        ({"points": 10**9 + 1}, "GB of memory, .* ask for fewer points"),
        ({"points": 5.0}, "points must be a whole number"),
        ({"amplitude": np.inf}, "amplitude must be positive and finite"),
        ({"config": "physics"}, "needs the paper's equations"),
        ({"amplitude": 0.0}, "positive"),
        ({"config": FAST}, "minibatch"),
        ({"right_hand_sides": {}}, "at least one"),
        ({"seed": -1}, "whole number"),
    ],
)
def test_invalid_arguments_are_reported(small_cases, changes, words, short_config):
    with pytest.raises(InputError, match=words):
        explore_landscapes(small_cases, **{"config": short_config, "progress": False, **changes})


class TestEnginesAgree:
    pytestmark = needs_julia

    @pytest.mark.parametrize(
        ("terms", "solver", "agreement"),
        [
            # The study covers convection alone; JAX compiles each of these.
            pytest.param(TERMS[:1], {"steps": 40}, 1e-12, id=TERMS[0], marks=pytest.mark.slow),
            pytest.param(TERMS[1:2], {"steps": 40}, 1e-12, id=TERMS[1], marks=pytest.mark.slow),
            pytest.param(TERMS[2:], {"steps": 40}, 1e-12, id=TERMS[2]),
            pytest.param(TERMS, {"steps": 40}, 1e-12, id="all"),
            pytest.param(TERMS, TIGHT, 1e-9, id="adaptive"),
        ],
    )
    def test_on_loss_and_gradient(self, both, small_cases, terms, solver, agreement):
        cases = small_cases.select([1, 5])
        inputs, grid = flow_problem(cases)
        inputs = gentle(inputs)
        if "steps" not in solver:
            # Kinks of S amplify round-off through the step sizes, so S is linear in z here.
            taper = np.linspace(1.0, 0.8, cases.n_points)
            inputs = inputs[0], inputs[1][:, :, :1] * taper
        config = PAPER.replace(flow={"terms": terms, "hidden": (4,), **solver})
        vector = quiet(initial_parameters(config, cases.n_times, cases.n_points, 0).flow)
        (julia, by_julia), (jax, by_jax) = (
            loss_and_gradient_of(e.flow, vector, inputs, cases.flow, grid, config) for e in both
        )
        assert julia == pytest.approx(jax, rel=agreement)
        assert relative_error(by_julia, by_jax) < agreement

    def test_on_many_losses_and_where_they_diverge(self, both, small_cases):
        """The inertia term is singular where the network lets the flow fall to zero."""
        inputs, grid = flow_problem(small_cases)
        config = PAPER.replace(flow={"terms": TERMS, "hidden": (4,)})
        first = initial_parameters(config, small_cases.n_times, small_cases.n_points, 0).flow
        vectors = np.stack([np.append(0.3 * first[:-20], np.full(20, b)) for b in (-1, 0, 1, 2)])
        julia, jax = (
            e.flow.losses(vectors, FitData(gentle(inputs), small_cases.flow, grid, config))
            for e in both
        )
        assert np.isinf(jax).any() and np.isfinite(jax).any()
        np.testing.assert_allclose(julia, jax, rtol=1e-7)

    def test_on_the_study(self, study, small_cases, short_config):
        by_julia = explore(small_cases, short_config, "julia")
        assert by_julia.outcomes == study.outcomes
        for julia, jax in zip(by_julia.landscapes, study.landscapes, strict=True):
            np.testing.assert_allclose(julia.losses, jax.losses, rtol=1e-6)
            assert julia.area_error == pytest.approx(jax.area_error, rel=1e-6)

    def test_on_a_prediction(self, both, small_cases):
        """Predict stage by stage, because the fused prediction of neither engine has terms."""
        cases = small_cases.select([1])
        inputs, grid = flow_problem(cases)
        config = PAPER.replace(flow={"terms": TERMS, "steps": 80, "hidden": (4,)})
        first = initial_parameters(config, cases.n_times, cases.n_points, 0)
        given = first.without_pressure().replace(
            flow=quiet(first.flow),
            intermediate_area=1e-3 * first.intermediate_area,
            fourier_area=1e-3 * first.fourier_area,
        )
        julia, jax = (
            e.predict(given, ModelInputs(gentle(inputs)[0], cases.area_undeformed, grid), config)
            for e in both
        )
        assert relative_error(julia.flow, jax.flow) < 1e-10
        assert relative_error(julia.area, jax.area) < 1e-10
        assert julia.pressure is None


def test_an_unknown_term_is_rejected():
    with pytest.raises(InputError, match=r"terms\[1\] must be one of .*friction"):
        PAPER.replace(flow={"terms": ("friction", "gravity")})


def test_landscapes_show_the_study(study):
    mesh = plots.landscapes(study).axes[0].collections[0]
    np.testing.assert_array_equal(mesh.get_array(), study.landscape("network", "initial").losses.T)
