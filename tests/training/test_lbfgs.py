"""L-BFGS with weight decay."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import SolveError
from pcnde_bridge.training.lbfgs import Options, minimize


def bowl(x):
    scale = np.array([1.0, 10.0, 100.0])
    return float(np.sum(scale * (x - 1) ** 2)), 2 * scale * (x - 1)


def test_the_minimizer_finds_the_minimum_and_tells_the_loss():
    seen = []
    found = minimize(
        bowl,
        np.zeros(3),
        Options(100, 0.0, 50, 1.0),
        lambda i, loss: seen.append((i, loss)),
    )
    assert np.allclose(found.parameters, 1, atol=1e-7)
    assert (found.converged, found.message) == (True, "loss falls no more")
    assert [i for i, _ in seen] == list(range(1, len(seen) + 1))
    assert seen[-1][1] < 1e-12
    stopped = minimize(bowl, np.zeros(3), Options(100, 0.0, 2, 1.0))
    assert (stopped.converged, stopped.message) == (False, "all iterations done")
    assert len(stopped.losses) == 3
    decayed = minimize(bowl, np.zeros(3), Options(100, 0.5, 50, 2.0))
    assert np.allclose(decayed.parameters, [1 / 2, 10 / 11, 100 / 101], atol=1e-6)


def test_a_diverging_trial_step_is_shortened():
    trials = []

    def cliff(x):
        trials.append(bool(x.max() > 1.5))
        return (np.inf, np.full(3, np.nan)) if trials[-1] else bowl(x)

    options = Options(100, 0.0, 100, 1e-3)
    found = minimize(cliff, np.full(3, -40.0), options)
    assert any(trials)
    assert np.allclose(found.parameters, 1, atol=1e-5)
    with pytest.raises(SolveError, match="not finite at the first parameters"):
        minimize(cliff, np.full(3, 2.0), Options(100, 1e-7, 10, 1.0))
