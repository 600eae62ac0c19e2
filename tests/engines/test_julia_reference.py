"""The Julia engine's flow stage against the Julia libraries alone."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from helpers import loss_and_gradient_of

from pcnde_bridge import PCNDE
from pcnde_bridge.config import PAPER
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import FitData, ModelInputs
from pcnde_bridge.errors import EngineError
from pcnde_bridge.model.metrics import relative_error

pytestmark = pytest.mark.julia

TIGHT = {"rtol": 1e-12, "atol": 1e-14, "max_steps": 16384}
# With equal steps both paths compute the same; with adaptive ones, the kinks of S at the points
# amplify the difference of the controllers.
SMALL = PAPER.replace(flow={"hidden": (2,), "steps": 20})


@pytest.fixture(scope="module")
def stages():
    """The fast flow stage and that of the reference."""
    return select_engine("julia").flow, select_engine("julia-reference").flow


def difference(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


def problem(cases, config):
    inputs = cases.inflow, undeformed(cases.area_undeformed, cases.n_times)
    vector = initial_parameters(config, cases.n_times, cases.n_points, seed=0).flow
    return vector, inputs, cases.flow, cases.grid, config


def test_a_fit_takes_the_path_of_the_libraries(stages, small_cases):
    data = problem(small_cases, SMALL)
    fast, reference = (stage.fit(data[0], FitData(*data[1:]), 5) for stage in stages)
    np.testing.assert_allclose(fast.losses, reference.losses, rtol=1e-8)
    assert difference(fast.parameters, reference.parameters) < 1e-6
    vector, inputs, _, *settings = data
    fast, reference = (stage.solve(vector, inputs, *settings) for stage in stages)
    assert difference(fast, reference) < 1e-9


def test_the_reference_engine_predicts(small_cases):
    engine, reference = (select_engine(name) for name in ("julia", "julia-reference"))
    assert pickle.loads(pickle.dumps(reference)) is reference  # noqa: S301
    cases, config = small_cases.select(slice(0, 2)), PAPER.replace(flow={"hidden": (2,), **TIGHT})
    parameters = initial_parameters(config, cases.n_times, cases.n_points, seed=0)
    inputs = ModelInputs(cases.inflow, cases.area_undeformed, cases.grid)
    fast, slow = (e.predict(parameters, inputs, config) for e in (engine, reference))
    for name in ("flow", "area", "pressure"):
        assert difference(getattr(fast, name), getattr(slow, name)) < 1e-8
    with pytest.raises(EngineError, match="has no physics terms"):
        with_terms = config.replace(flow={"terms": ("friction",)})
        reference.predict(parameters, inputs, with_terms)


@pytest.mark.data
@pytest.mark.parametrize(
    ("settings", "limit"), [({"rtol": 1e-3, "atol": 1e-6}, 1e-6), (TIGHT, 1e-9)]
)
def test_published_weights(stages, published_cases, published_folder, settings, limit):
    weights = published_folder / "trained_weights"
    if not weights.is_dir():
        pytest.skip(f"the published weights are not in {published_folder}")
    model = PCNDE.from_published_weights(weights, engine="julia")
    config = model.config.replace(flow=settings)
    cases = published_cases.split("paper").test
    _, inputs, _, grid, _ = problem(cases, config)
    fast, reference = (stage.solve(model.parameters.flow, inputs, grid, config) for stage in stages)
    assert relative_error(fast, reference) < limit


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(("settings", "limit"), [({}, 1e-6), ({"steps": 10}, 1e-8)])
def test_the_first_batch_of_preset_paper(stages, published_cases, settings, limit):
    train = published_cases.split("paper").train
    first = np.random.default_rng(0).permutation(train.n_cases)[: PAPER.batch_size]
    data = problem(train.select(first), PAPER.replace(flow=settings))
    fast, reference = (loss_and_gradient_of(stage, *data)[1] for stage in stages)
    assert difference(fast, reference) < limit
    fast, reference = (stage.fit(data[0], FitData(*data[1:]), 5).losses for stage in stages)
    np.testing.assert_allclose(fast, reference, rtol=limit)
