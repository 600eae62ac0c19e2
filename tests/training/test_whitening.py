"""Whitened coordinates."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge.training.whitening import Whitening


def test_whitened_coordinates():
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(3, 12))
    inputs = 5 + rng.normal(size=(200, 3)) * [1.0, 0.5, 0.2] @ basis
    whitening = Whitening(inputs, 4, 1e-3)
    spread = whitening.inputs(inputs)
    assert spread.shape == (200, 3)
    assert np.abs(spread.mean(axis=0)).max() < 1e-10
    assert 0.5 < spread.std(axis=0).min() <= spread.std(axis=0).max() < 1 + 1e-10
    parameters = rng.normal(size=12 * 4 + 4 + 7)
    ours = whitening.coordinates(parameters)
    back = whitening.parameters(ours)
    assert np.allclose(whitening.coordinates(back), ours)

    def first_layer(vector, n_in, x):
        return x @ vector[: n_in * 4].reshape(n_in, 4) + vector[n_in * 4 : n_in * 4 + 4]

    expected = first_layer(parameters, 12, inputs)
    assert np.allclose(first_layer(back, 12, inputs), expected)
    assert np.allclose(first_layer(ours, 3, spread), expected)
    weights = rng.normal(size=parameters.size)
    direction = rng.normal(size=ours.size)
    change = whitening.parameters(ours + direction) - whitening.parameters(ours)
    assert whitening.gradient(weights) @ direction == pytest.approx(weights @ change)
