"""The paper's training algorithm: BFGS that starts afresh in every batch of cases."""

from __future__ import annotations

from functools import partial
from typing import Any, TypeVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.types import arrays_of
from pcnde_bridge.training.procedure import StageFit, Step

InputsT = TypeVar("InputsT")


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
    pressure = config.temporal_pressure.iterations + config.spatial_pressure.iterations
    return n_batches * (flow.epochs * flow.iterations + couplings * area) + pressure


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
        data = select(wanted.inputs, batch), wanted.target[batch], wanted.cases.grid, config
        optimize = partial(getattr(wanted.engine, stage).fit, vector, *data, iterations)
        vector = wanted.recorder.run(stage, step.epoch, number, optimize)
    return vector


def select(inputs: InputsT, batch: Positions | slice) -> InputsT:
    """Return the inputs of a stage for some of the cases."""
    return type(inputs)(*(array[batch] for array in arrays_of(inputs)))
