"""Linear least squares."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge.training.least_squares import solve_per_point


def test_least_squares_at_every_point():
    rng = np.random.default_rng(0)
    columns = [rng.normal(size=(4, 5, 3)), rng.normal(size=(1, 5, 1))]
    target = rng.normal(size=(4, 5, 3))
    unknowns, loss = solve_per_point(columns, target)
    for point in range(3):
        matrix = np.stack([np.broadcast_to(c, target.shape)[..., point].ravel() for c in columns])
        expected = np.linalg.lstsq(matrix.T, target[..., point].ravel())[0]
        assert np.allclose(unknowns[:, point], expected, rtol=1e-10)
    left = target - sum(u * c for u, c in zip(unknowns, columns, strict=True))
    assert loss == pytest.approx(np.mean(left**2), rel=1e-12)


def test_what_the_columns_do_not_determine_stays_finite():
    column = np.ones((2, 3, 4))
    column[..., 0] = 0.0
    unknowns, _ = solve_per_point([column, column], 3 * np.ones((2, 3, 4)))
    assert np.allclose(unknowns, [[0, 1.5, 1.5, 1.5]] * 2)
