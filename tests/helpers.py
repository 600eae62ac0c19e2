"""Helpers of several test files: the Julia skip, a problem for the closures, a toy engine."""

from __future__ import annotations

import functools
from typing import ClassVar

import numpy as np
import pytest

from pcnde_bridge._utils import jax_context
from pcnde_bridge.config import FAST, PHYSICS
from pcnde_bridge.config.settings import Physics
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.julia.environment import JuliaStatus, julia_status
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import predict_by_stages
from pcnde_bridge.engines.types import Fit, FitData, ModelInputs, ignore
from pcnde_bridge.model.pcnde import PCNDE


def compiled_quickly(function):
    """Compile a function whose compilation takes longer than all evaluations."""
    import jax

    options = jax_context._compiler_options() | {"xla_backend_optimization_level": 0}
    return jax.jit(function, compiler_options=options)


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


def loss_and_gradient_of(stage, parameters, inputs, target, grid, config):
    """Return a stage's loss and its gradient, all cases with equal weights."""
    data = FitData(inputs, target, grid, config)
    return stage.objective(data, np.ones(len(target)))(parameters)


# Closures of the preset ``physics``.  One grid throughout, and 16 cases at once: every new
# shape is compiled for seconds.
Z = np.linspace(0.0, 4.0, 41)
TIME = np.arange(32) / 32
GRID = Grid(TIME, Z, 1.0)
BLOOD = Physics()
FEW = {"folds": 2, "evaluations": 15}
CONFIG = PHYSICS.replace(wall={"law": "membrane"}, correction={"hidden": (4,)} | FEW)

STRAIGHT = np.full(41, 0.125)
RADIUS = np.sqrt(0.125 / np.pi)
MEMBRANE = np.array([1.0e6, 0.45, 0.2, 1.0, 2.0e3])
LOSSES = np.array([1.2, 1.1, 0.9, 1.3, 1.25, 0.95, 1.15, 0.06, 2.0, 0.7])
OUTLET = np.array([1.0e5, 0.0, 0.0, 5.0e3])
SHEAR = np.array([0.6, 0.1, 0.2, 0.3, 0.25, 0.15, 0.7, 1.4, 0.8])
# κ, ceiling and two scales, then the network's weights: g = 0, and g between 0 and 0.8.
OFF = np.concatenate([[1.3, 0.0, 1.0e6, 1.0], np.zeros(17)])
ON = np.concatenate([[1.3, 0.8, 1.0e6, 1.0], np.random.default_rng(5).normal(size=17)])
PASSIVE = ClosureParameters(OUTLET, LOSSES, MEMBRANE, OFF, SHEAR)
CORRECTED = PASSIVE.replace(correction=ON)

GEOMETRY, WAVEFORM = (a.ravel() for a in np.meshgrid(range(4), range(4), indexing="ij"))


def vessel(*places, blockage=0.6, z=Z):
    """S_u with a stenosis at each place."""
    taken = sum((np.exp(-(((z - at) / 0.3) ** 2)) for at in places), np.zeros(z.size))
    return 0.125 * (1 - blockage * taken)


def waveforms(time=TIME):
    """Four inflows of three harmonics, all forward; shape (waveform, time)."""
    parts = ((1, 0.25, 0.3), (2, 0.12, 1.5), (3, 0.05, 2.0))
    wave = sum(a * np.cos(2 * np.pi * k * time + phase) for k, a, phase in parts)
    return np.array([m + s * wave for m, s in ((1.0, 0.4), (1.1, 0.8), (1.2, 1.2), (1.3, 1.6))])


VESSELS = np.array([vessel(2.0, blockage=b) for b in (0.3, 0.45, 0.6, 0.7)])
INFLOW, AREA = waveforms()[WAVEFORM], VESSELS[GEOMETRY]


def solve(parameters=PASSIVE, inflow=INFLOW, area=AREA, grid=GRID, config=CONFIG):
    closures = select_engine("jax").closures
    inputs = ModelInputs(inflow, area, grid)
    return closures.predict(parameters, np.zeros(len(inflow)), inputs, config)


def as_cases(solution):
    labels = {"geometry": GEOMETRY + 1, "waveform": WAVEFORM}
    flow, area, pressure, *shear = solution
    given = {"wall_shear_stress": shear[0]} if shear else {}
    return Cases(flow, area, pressure, AREA, TIME, Z, period=1.0, labels=labels, **given)


def made_by_the_closures(parameters=CORRECTED):
    """16 cases that the preset can describe exactly."""
    return as_cases(solve(parameters, config=CONFIG.replace(losses={"spacing": RADIUS / 10})))


class ToyStage:
    """Stage with few parameters, fitted by gradient descent: all in numpy, at once.

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

    def objective(self, data, weight):
        inputs, target, grid, config = data
        chosen = np.asarray(weight) > 0
        part = tuple(array[chosen] for array in inputs), target[chosen], grid, config

        def evaluate(parameters):
            _, weights = self._k(parameters)
            gradient = np.zeros(parameters.size)
            for row in weights:
                step = 1e-4 * row
                rise, fall = (self._loss(parameters + s, *part) for s in (step, -step))
                gradient += (rise - fall) * row
            return self._loss(parameters, *part), gradient

        return evaluate

    def fit(self, parameters, data, iterations, on_iteration=ignore):
        inputs, target, grid, config = data
        self.fits.append((parameters.copy(), inputs, target))
        losses = [self._loss(parameters, inputs, target, grid, config)]
        for number in range(1, iterations + 1):
            _, gradient = loss_and_gradient_of(self, parameters, inputs, target, grid, config)
            length = np.linalg.norm(gradient)
            parameters = parameters - 0.05 * gradient / (length if length > 0 else 1.0)
            losses.append(self._loss(parameters, inputs, target, grid, config))
            on_iteration(number, losses[-1])
        return Fit(parameters, np.array(losses), False, "all iterations done")


def _toy_flow(k, inputs, grid, config):
    inflow, area = inputs
    slope = 0.1 * k[0] + 0.1 * k[1] * (area - 0.125) + 0.01 * k[2] * grid.z
    return inflow[:, :, None] * (1 + slope * grid.z)


def _toy_intermediate(k, inputs, grid, config):
    flow, area_undeformed = inputs
    one = area_undeformed[:, None] * (1 + 0.1 * k[0] + 0.1 * k[1] * flow)
    return np.concatenate([one * (1 + 0.01 * k[2] * n) for n in range(3)], axis=1)


def _toy_fourier(k, inputs, grid, config):
    flow, initial_area = inputs
    return initial_area[:, None] * (1 + 0.1 * k[0] * flow) + 0.01 * (k[1] + k[2])


def _toy_temporal(k, inputs, grid, config):
    flow, area, area_undeformed = inputs
    return 1 + k[0] * flow + k[1] * area + k[2] * area_undeformed[:, None]


def _toy_spatial(k, inputs, grid, config):
    temporal, flow, _ = inputs
    drop = (k[1] + k[2] * flow) * np.tanh(grid.z - 2)
    return temporal.mean(axis=2, keepdims=True) + k[0] - drop


class ToyEngine:
    """Engine without compilation, for tests that do not depend on the equations."""

    name = "toy"
    versions: ClassVar = {"toy": "1"}

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


def same_bits(a, b):
    """Return whether two data sets or predictions have the same values, bit for bit."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in VARIABLES)


class FailingEngine:
    """Toy engine whose fits of the flow fail, by their number."""

    def __new__(cls, counts):
        engine = ToyEngine()
        fit = engine.flow.fit

        def failing(parameters, inputs, *args):
            if len(engine.flow.fits) in counts:
                engine.flow.fits.append(None)
                raise OSError("lost")
            return fit(parameters, inputs, *args)

        engine.flow.fit = failing
        return engine


def interrupt_at(engine, monkeypatch, number):
    """Raise KeyboardInterrupt in the given fit of the flow."""
    fit = engine.flow.fit

    def interrupted(*args):
        if len(engine.flow.fits) == number:
            engine.flow.fits.append(None)
            raise KeyboardInterrupt
        return fit(*args)

    monkeypatch.setattr(engine.flow, "fit", interrupted)


def case_arguments(cases, **changes):
    """Return the arguments that create a data set, with changes."""
    names = *cases.variables(), "area_undeformed", "time", "z"
    given = {name: np.array(getattr(cases, name)) for name in names}
    return given | {"period": cases.period, "labels": cases.labels} | changes


def case_pairs(cases):
    return list(zip(cases.labels["geometry"], cases.labels["waveform"], strict=True))


def with_labels(cases, labels):
    axes = cases.area_undeformed, cases.time, cases.z
    return Cases(cases.flow, cases.area, cases.pressure, *axes, period=cases.period, labels=labels)


# Preset ``fast`` with few iterations.
LITTLE = FAST.replace(
    coupling_passes=2,
    full_batch={
        "rounds": 2,
        "collocation_iterations": 6,
        "whitening": 1e-2,
        "iterations": 8,
        "later_iterations": 5,
        "pressure_iterations": 12,
    },
)


PHYSICS_SETTINGS = {"hidden": (4,), "folds": 2, "evaluations": 15}
PHYSICS_CONFIG = PHYSICS.replace(correction=PHYSICS_SETTINGS)


def fit_physics(cases, config=PHYSICS_CONFIG, seed=0, engine="jax", **options):
    return PCNDE.fit(cases, config, engine, seed, **{"progress": False, **options})


def same_numbers(a, b):
    """Return whether two models have the same bits, apart from times and versions."""
    parts_of = [
        [*dict(m.parameters).values(), *dict(m.uncertainty).values(), *dict(m.novelty).values()]
        for m in (a, b)
    ]
    same_history = a.history.drop(columns="seconds").equals(b.history.drop(columns="seconds"))
    return same_history and all(map(np.array_equal, *parts_of))


def artery(
    diameter, speed, slenderness, period, pressure, n_times=16, rigid=False, shear=1.0, drop=True
):
    """An artery in CGS units whose volume is conserved: pulses that grow along it.

    Its wall shear stress is ``shear`` times Poiseuille's; None: it has none.  With ``drop``,
    its pressure accelerates the flow and overcomes Poiseuille's friction.
    """
    time, z = np.arange(n_times) / n_times * period, np.linspace(0, slenderness * diameter, 7)
    undeformed = np.full(7, np.pi / 4 * diameter**2)
    angle = 2 * np.pi * np.arange(n_times) / n_times
    strain = 1.05 + (0.0 if rigid else 0.03) * np.cos(angle)
    area = strain[:, None] * undeformed
    flow = speed * undeformed[0] * (1 + 0.5 * np.sin(angle))[:, None] * np.ones(7)
    growth = -2 * np.pi / period * (0.0 if rigid else 0.03) * np.sin(angle)[:, None] * undeformed
    flow = flow - growth * z
    pressures = pressure * (1 + 0.2 * np.cos(angle))[:, None] * np.ones(7)
    if drop:
        harmonic = 2j * np.pi / period * np.arange(n_times // 2 + 1)[:, None]
        rate = np.fft.irfft(np.fft.rfft(flow, axis=0) * harmonic, n_times, axis=0)
        slope = 1.06 * rate / undeformed + 8 * np.pi * 0.04 * flow / undeformed**2
        pressures -= (slope[:, :1] + slope) / 2 * z  # the integral, as slopes are linear in z
    fields = {
        "flow": flow[None],
        "area": area[None],
        "pressure": pressures[None],
        "area_undeformed": undeformed[None],
        "time": time,
        "z": z,
    }
    if shear is None:
        return fields
    stress = shear * 4 * 0.04 * flow / (np.pi * (diameter / 2) ** 3)
    return {**fields, "wall_shear_stress": stress[None]}
