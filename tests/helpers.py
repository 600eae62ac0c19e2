"""Helpers that several test files share: an engine without compilation, the Julia skip."""

from __future__ import annotations

import dataclasses
import functools
from typing import ClassVar

import numpy as np
import pytest

from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.jax.lbfgs import lbfgs_of_scipy
from pcnde_bridge.engines.julia.status import JuliaStatus, julia_status
from pcnde_bridge.engines.protocol import Engine, Fit
from pcnde_bridge.engines.staged import predict_by_stages


@functools.cache
def _status() -> JuliaStatus:
    return julia_status()


def skip_without_julia() -> None:
    """Skip the test, with the reason, where Julia is not usable without an installation."""
    if not _status().usable:
        pytest.skip(f"no Julia: {_status().message}")


def julia_or_skip() -> Engine:
    """Return the Julia engine; skip the test, with the reason, where it cannot be used."""
    skip_without_julia()
    return select_engine("julia")


class ToyStage:
    """A stage that a few numbers describe, fitted by descent: all in numpy, at once.

    ``formula(k, arrays, grid, config)`` gives the prediction; k are a few fixed
    projections of the parameters, so that every parameter counts.
    """

    def __init__(self, formula, compared=lambda prediction, n_times: prediction):
        self.formula, self.compared = formula, compared
        self.fits = []

    def _k(self, parameters):
        weights = np.cos(np.arange(3 * parameters.size).reshape(3, -1) + 1.0)
        return np.tanh(weights @ parameters / np.sqrt(parameters.size)), weights

    def solve(self, parameters, inputs, grid, config):
        return self.formula(self._k(parameters)[0], inputs, grid, config)

    def _loss(self, parameters, inputs, target, grid, config):
        predicted = self.solve(parameters, inputs, grid, config)
        return float(((self.compared(predicted, target.shape[1]) - target) ** 2).mean())

    def loss_and_gradient(self, parameters, inputs, target, grid, config):
        _, weights = self._k(parameters)
        gradient = np.zeros(parameters.size)
        for row in weights:
            step = 1e-4 * row
            rise = self._loss(parameters + step, inputs, target, grid, config)
            fall = self._loss(parameters - step, inputs, target, grid, config)
            gradient += (rise - fall) * row
        return self._loss(parameters, inputs, target, grid, config), gradient

    def objective(self, inputs, target, weight, grid, config):
        chosen = np.asarray(weight) > 0
        arrays = {f.name: getattr(inputs, f.name)[chosen] for f in dataclasses.fields(inputs)}
        part = type(inputs)(**arrays)
        return lambda x: self.loss_and_gradient(x, part, target[chosen], grid, config)

    def fit(self, parameters, inputs, target, grid, config, iterations, on_iteration=None):
        self.fits.append((parameters.copy(), inputs, target))
        losses = [self._loss(parameters, inputs, target, grid, config)]
        for number in range(1, iterations + 1):
            _, gradient = self.loss_and_gradient(parameters, inputs, target, grid, config)
            length = np.linalg.norm(gradient)
            parameters = parameters - 0.05 * gradient / (length if length > 0 else 1.0)
            losses.append(self._loss(parameters, inputs, target, grid, config))
            if on_iteration is not None:
                on_iteration(number, losses[-1])
        return Fit(parameters, np.array(losses), False, "all iterations done")


def _toy_flow(k, inputs, grid, config):
    slope = 0.1 * k[0] + 0.1 * k[1] * (inputs.area - 0.125) + 0.01 * k[2] * grid.z
    return inputs.inflow[:, :, None] * (1 + slope * grid.z)


def _toy_intermediate(k, inputs, grid, config):
    one = inputs.area_undeformed[:, None] * (1 + 0.1 * k[0] + 0.1 * k[1] * inputs.flow)
    return np.concatenate([one * (1 + 0.01 * k[2] * n) for n in range(3)], axis=1)


def _toy_fourier(k, inputs, grid, config):
    return inputs.initial_area[:, None] * (1 + 0.1 * k[0] * inputs.flow) + 0.01 * (k[1] + k[2])


def _toy_temporal(k, inputs, grid, config):
    return 1 + k[0] * inputs.flow + k[1] * inputs.area + k[2] * inputs.area_undeformed[:, None]


def _toy_spatial(k, inputs, grid, config):
    drop = (k[1] + k[2] * inputs.flow) * np.tanh(grid.z - 2)
    return inputs.temporal.mean(axis=2, keepdims=True) + k[0] - drop


class ToyEngine:
    """An engine that needs no compiling, for what does not depend on the equations."""

    name = "toy"
    versions: ClassVar = {"toy": "1"}
    lbfgs = staticmethod(lbfgs_of_scipy)

    def __init__(self):
        self.flow = ToyStage(_toy_flow)
        self.intermediate_area = ToyStage(_toy_intermediate, lambda p, n_times: p[:, -n_times:])
        self.fourier_area = ToyStage(_toy_fourier)
        self.temporal_pressure = ToyStage(_toy_temporal)
        self.spatial_pressure = ToyStage(_toy_spatial)

    def predict(self, *args):
        return predict_by_stages(self, *args)

    def __reduce__(self):  # so that it travels to worker processes
        return ToyEngine, ()
