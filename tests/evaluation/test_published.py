"""The real cases: the published weights, and the paper's training at full length."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import PCNDE
from pcnde_bridge.model.metrics import relative_error

pytestmark = pytest.mark.data


@pytest.fixture(scope="module")
def published_model(published_folder):
    weights = published_folder / "trained_weights"
    if not weights.is_dir():
        pytest.skip(f"the published weights are not in {published_folder}")
    return PCNDE.from_published_weights(weights, engine="jax")


def test_published_weights_give_the_errors_of_the_paper(published_model, published_cases):
    train, test = published_cases.split("paper")
    on_test = published_model.evaluate(test).iloc[-1]
    assert on_test["flow"] == pytest.approx(0.0076, abs=0.0001)
    assert on_test["area"] == pytest.approx(0.0112, abs=0.0001)
    on_train = published_model.evaluate(train).iloc[-1]
    assert on_train["flow"] == pytest.approx(0.0038, abs=0.0001)
    assert on_train["area"] == pytest.approx(0.0075, abs=0.0001)
    assert "pressure" not in on_train


@pytest.mark.parametrize("coupling_passes", [1, 2, 3])
def test_each_case_is_that_of_an_independent_calculation(
    published_model, published_cases, published_folder, coupling_passes
):
    file = published_folder.parent / "reference" / "published_weights_prediction.npz"
    if not file.is_file():
        pytest.skip("the reference predictions are not on this machine")
    model = PCNDE(
        published_model.config.replace(coupling_passes=coupling_passes),
        published_model.parameters,
        published_model.grid,
        published_model.engine,
    )
    with np.load(file) as reference:
        pairs = [(int(g), int(w)) for g, w in reference["cases"]]
        prediction = model.predict(published_cases.select(pairs))
        for name in ("flow", "area"):
            expected = reference[f"{name}_{coupling_passes}"].astype(np.float64)
            for mine, theirs in zip(getattr(prediction, name), expected, strict=True):
                assert relative_error(mine, theirs) < 1e-3


@pytest.mark.slow
def test_the_papers_training_reaches_the_papers_accuracy(published_cases):
    train, test = published_cases.split("paper")
    model = PCNDE.fit(train, config="paper", engine="jax", seed=0, progress=False)
    on_test, on_train = model.evaluate(test).iloc[-1], model.evaluate(train).iloc[-1]
    limits = {"flow": (0.0045, 0.0080), "area": (0.0080, 0.0120), "pressure": (0.0090, 0.0125)}
    for variable, (train_limit, test_limit) in limits.items():
        assert on_train[variable] <= train_limit
        assert on_test[variable] <= test_limit
    per_stage = model.history.groupby("stage").size()
    assert per_stage["flow"] == 100 * 7 * 5
    assert per_stage["temporal_pressure"] == 250
    assert 0 < per_stage["spatial_pressure"] <= 75  # it may converge before
