"""L-BFGS with weight decay."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import julia_or_skip

from pcnde_bridge import (
    SolveError,
)
from pcnde_bridge.engines.jax.lbfgs import lbfgs_of_scipy
from pcnde_bridge.training.lbfgs import Options, minimize


@pytest.fixture(params=["scipy", pytest.param("optim", marks=pytest.mark.julia)])
def lbfgs(request):
    return lbfgs_of_scipy if request.param == "scipy" else julia_or_skip().lbfgs


def bowl(x):
    scale = np.array([1.0, 10.0, 100.0])
    return float(np.sum(scale * (x - 1) ** 2)), 2 * scale * (x - 1)


def test_the_minimizer_finds_the_minimum_and_tells_the_loss(lbfgs):
    seen = []
    found = minimize(
        bowl,
        np.zeros(3),
        Options(100, 0.0, 50, 1.0),
        lbfgs,
        lambda i, loss: seen.append((i, loss)),
    )
    assert np.allclose(found.parameters, 1, atol=1e-7)
    assert (found.converged, found.message) == (True, "loss falls no more")
    assert [i for i, _ in seen] == list(range(1, len(seen) + 1))
    assert seen[-1][1] < 1e-12
    stopped = minimize(bowl, np.zeros(3), Options(100, 0.0, 2, 1.0), lbfgs)
    assert (stopped.converged, stopped.message) == (False, "all iterations done")
    assert len(stopped.losses) == 3
    decayed = minimize(bowl, np.zeros(3), Options(100, 0.5, 50, 2.0), lbfgs)
    assert np.allclose(decayed.parameters, [1 / 2, 10 / 11, 100 / 101], atol=1e-6)


def test_a_diverging_trial_step_is_shortened(lbfgs):
    trials = []

    def cliff(x):
        trials.append(bool(x.max() > 1.5))
        return (np.inf, np.full(3, np.nan)) if trials[-1] else bowl(x)

    options = Options(100, 0.0, 100, 1e-3)
    found = minimize(cliff, np.full(3, -40.0), options, lbfgs)
    assert any(trials)
    assert np.allclose(found.parameters, 1, atol=1e-5)
    with pytest.raises(SolveError, match="not finite at the first parameters"):
        minimize(cliff, np.full(3, 2.0), Options(100, 1e-7, 10, 1.0), lbfgs)
