from __future__ import annotations

import dataclasses
import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import settings

from pcnde_bridge.cli import main as cli
from pcnde_bridge.config import PAPER, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.jax.lbfgs import lbfgs_of_scipy
from pcnde_bridge.engines.protocol import Fit
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.errors import DataNotFoundError
from pcnde_bridge.io.datasets import find_published, load_cases
from pcnde_bridge.model.pcnde import PCNDE

# The same examples each time in the suite; HYPOTHESIS_PROFILE=long tries others, and many.
settings.register_profile("suite", max_examples=25, derandomize=True, deadline=None)
settings.register_profile("long", max_examples=2000, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "suite"))

# JAX compiles what the suite's processes share once. The workers inherit the first one's folder.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _compiled = tempfile.TemporaryDirectory(prefix="pcnde-compiled-")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _compiled.name
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")

# A shell lets its background jobs ignore Ctrl-C, and they what they start.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def small_cases() -> Cases:
    """3 geometries × 4 waveforms, 20 instants, 21 points; smooth, by formula."""
    rng = np.random.default_rng(20241108)
    time = np.arange(20) / 20
    z = np.linspace(0.0, 4.0, 21)
    blockage = np.array([0.4, 0.5, 0.6])
    scale = np.array([0.0, 0.5, 1.0, 1.5])
    bump = np.exp(-(((z - 2.0) / 0.4) ** 2))
    amplitude = rng.uniform(0.05, 0.2, size=3)[:, None]
    phase = rng.uniform(0.0, 2 * np.pi, size=3)[:, None]
    harmonic = np.arange(1, 4)[:, None]
    wave = (amplitude * np.cos(2 * np.pi * harmonic * time + phase)).sum(axis=0)

    geometry, waveform = (grid.ravel() for grid in np.meshgrid([1, 2, 3], range(4), indexing="ij"))
    area_undeformed = 0.125 * (1.0 - blockage[geometry - 1, None] * bump)
    inflow = 1.2 + scale[waveform, None] * wave
    damping = 1.0 - 0.02 * scale[waveform, None, None] * z / z[-1]
    flow = inflow[:, :, None] * damping
    drop = 4e3 * blockage[geometry - 1, None, None] * (1 - np.tanh(3 * (z - 2))) * flow
    pressure = 1.09e5 * flow[:, :, -1:] + drop
    area = area_undeformed[:, None, :] * (1 + pressure / 4.9e6) ** 2
    return Cases(
        flow,
        area,
        pressure,
        area_undeformed,
        time,
        z,
        period=1.0,
        labels={
            "geometry": geometry,
            "waveform": waveform,
            "blockage": blockage[geometry - 1],
            "patient": [f"patient {g}" for g in geometry],
        },
    )


@pytest.fixture(scope="session")
def other_period(small_cases) -> Cases:
    """The same numbers in a shorter cycle: what only the grid tells apart."""
    arrays = {name: getattr(small_cases, name) for name in ("flow", "area", "pressure")}
    return Cases(
        **arrays,
        area_undeformed=small_cases.area_undeformed,
        time=0.8 * small_cases.time,
        z=small_cases.z,
        period=0.8,
        labels=small_cases.labels,
    )


@pytest.fixture(scope="session")
def published_folder() -> Path:
    """Folder of the authors' data set; skips where it is not on this machine."""
    try:
        folder = find_published()
    except DataNotFoundError as error:
        pytest.skip(str(error))
    if folder is None:
        pytest.skip("the published data set is not on this machine (set PCNDE_DATA)")
    return folder


@pytest.fixture(scope="session")
def published_cases(published_folder: Path) -> Cases:
    return load_cases(published_folder)


@pytest.fixture(scope="session")
def small_config() -> PCNDEConfig:
    """The paper's training in little: two couplings, two batches of one compiled shape."""
    return PAPER.replace(
        batch_size=6,
        coupling_passes=2,  # compiled one after the other
        flow={"epochs": 4, "couple_every": 2, "iterations": 3},
        intermediate_area={"iterations": 3},
        fourier_area={"iterations": 3},
        temporal_pressure={"iterations": 8},
        spatial_pressure={"iterations": 6},
    )


@pytest.fixture(scope="session")
def small_split() -> dict[str, list[list[int]]]:
    """Eleven cases for training, so that the last batch is smaller, and one for test."""
    train = [[g, w] for g in (1, 2, 3) for w in range(4) if (g, w) != (2, 1)]
    return {"train": train, "test": [[2, 1]]}


@pytest.fixture(scope="session")
def small_model(small_cases, small_config, small_split) -> PCNDE:
    """Fitted by the JAX engine; what it compiled serves every test of these shapes."""
    train = small_cases.split(small_split).train
    return PCNDE.fit(train, small_config, engine="jax", seed=0, progress=False)


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


@pytest.fixture
def toy_engine() -> ToyEngine:
    return ToyEngine()


@pytest.fixture(scope="session")
def toy_config(small_config) -> PCNDEConfig:
    """As ``small_config``, with batches of 5, so that the last of 12 cases has 2."""
    return small_config.replace(batch_size=5)


@pytest.fixture
def run_pcnde(monkeypatch, capsys):
    """Run ``pcnde`` in this process: exit code, standard output, standard error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["pcnde", *map(str, arguments)])
        capsys.readouterr()
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return code, out, err

    return run


class _Dying:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)


@pytest.fixture
def drop_ctrl_c():
    """Press Ctrl-C in an object's last moment, when nobody can receive an exception."""

    def drop() -> None:
        dying = _Dying()
        del dying

    return drop
