"""The paper's training: BFGS that starts afresh in every batch of cases."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.training.algorithm import StageFit, Unit


def divide(cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
    """Positions of the cases in every batch, at random; the last may be smaller."""
    order = np.random.default_rng(seed).permutation(len(cases))
    return tuple(order[i : i + config.batch_size] for i in range(0, len(cases), config.batch_size))


def plan(config: PCNDEConfig, n_batches: int) -> list[Unit]:
    """All units of a run, in order: epochs of the flow, couplings among them, the pressure."""
    units = []
    for epoch in range(1, config.flow.epochs + 1):
        units += [Unit("flow", epoch, batch) for batch in range(1, n_batches + 1)]
        if epoch % config.flow.couple_every == 0:
            units.append(Unit("coupling", epoch, 1))
    return [*units, Unit("temporal_pressure", 1, 1), Unit("spatial_pressure", 1, 1)]


def count_iterations(config: PCNDEConfig, n_batches: int) -> int:
    """Count the iterations of all stages, if no fit ends early."""
    flow, couplings = config.flow, config.flow.epochs // config.flow.couple_every
    area = config.intermediate_area.iterations + config.fourier_area.iterations
    return (
        n_batches * (flow.epochs * flow.iterations + couplings * area)
        + config.temporal_pressure.iterations
        + config.spatial_pressure.iterations
    )


def fit(wanted: StageFit) -> Array:
    """Fit the flow to one batch, an area stage to each in turn, the pressure to all cases."""
    stage, unit, state, inputs, target, cases, engine, config, record = wanted
    vector: Array = getattr(state.parameters, stage)
    iterations = getattr(config, stage).iterations
    batches: list[tuple[int, Any]] = list(enumerate(state.batches, 1))
    if unit.work == "flow":
        batches = [batches[unit.batch - 1]]
    elif unit.work != "coupling":
        batches = [(1, slice(None))]
    for number, batch in batches:
        if stage == "fourier_area" and config.fourier_area.restart:
            vector = np.repeat([1.0, 0.0], cases.n_points)
        part = type(inputs)(**{f.name: getattr(inputs, f.name)[batch] for f in fields(inputs)})
        found = getattr(engine, stage).fit(
            vector,
            part,
            target[batch],
            cases.grid,
            config,
            iterations,
            record(stage, unit.epoch, number),
        )
        vector = found.parameters
    return vector
