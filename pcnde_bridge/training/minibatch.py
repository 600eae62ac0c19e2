"""The paper's training algorithm: BFGS that starts afresh in every batch of cases."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.protocol import Stage
from pcnde_bridge.engines.types import Fit, OnIteration
from pcnde_bridge.training.algorithm import StageFit
from pcnde_bridge.training.procedure import Step


def divide(cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
    """Return the positions of the cases in every batch, at random; the last may be smaller."""
    order = np.random.default_rng(seed).permutation(len(cases))
    return tuple(order[i : i + config.batch_size] for i in range(0, len(cases), config.batch_size))


def plan(config: PCNDEConfig, n_batches: int) -> list[Step]:
    """Return all steps of a run: epochs of the flow with couplings, then the pressure."""
    steps = []
    for epoch in range(1, config.flow.epochs + 1):
        steps += [Step("flow", epoch, batch) for batch in range(1, n_batches + 1)]
        if epoch % config.flow.couple_every == 0:
            steps.append(Step("coupling", epoch))
    return [*steps, Step("temporal_pressure"), Step("spatial_pressure")]


def count_iterations(config: PCNDEConfig, n_batches: int) -> int:
    """Count the iterations of all steps, if no fit ends early."""
    flow, couplings = config.flow, config.flow.epochs // config.flow.couple_every
    area = config.intermediate_area.iterations + config.fourier_area.iterations
    return (
        n_batches * (flow.epochs * flow.iterations + couplings * area)
        + config.temporal_pressure.iterations
        + config.spatial_pressure.iterations
    )


def fit(wanted: StageFit) -> Array:
    """Fit the flow to one batch, an area stage to each batch in turn, the pressure to all cases."""
    stage, step, config = wanted.stage, wanted.step, wanted.config
    batches: list[tuple[int, Any]] = list(enumerate(wanted.state.batches, 1))
    if step.task == "flow":
        batches = [batches[step.batch - 1]]
    elif step.task != "coupling":
        batches = [(1, slice(None))]
    vector, iterations = wanted.start, getattr(config, stage).iterations
    for number, batch in batches:
        if stage == "fourier_area" and config.fourier_area.restart:
            vector = np.repeat([1.0, 0.0], wanted.cases.n_points)
        data = wanted.inputs, wanted.target, batch, wanted.cases.grid, config
        optimize = partial(fit_batch, getattr(wanted.engine, stage), vector, *data, iterations)
        vector = wanted.recorder.run(stage, step.epoch, number, optimize)
    return vector


def fit_batch(
    stage: Stage[Any],
    parameters: Array,
    inputs: Any,
    target: Array,
    batch: Positions | slice,
    grid: Grid,
    config: PCNDEConfig,
    iterations: int,
    on_iteration: OnIteration | None = None,
) -> Fit:
    """Fit a stage to one batch of the cases; see :meth:`pcnde_bridge.engines.protocol.Stage.fit`.

    Parameters
    ----------
    stage : Stage
        Stage of an engine.
    inputs, target
        Inputs of the stage and reference data, (case, time, z), for all cases.
    batch : array of int or slice
        Positions of the cases to fit.
    parameters, grid, config, iterations, on_iteration
        Arguments of the stage's ``fit``.
    """
    some = type(inputs)(**{f.name: getattr(inputs, f.name)[batch] for f in fields(inputs)})
    return stage.fit(parameters, some, target[batch], grid, config, iterations, on_iteration)
