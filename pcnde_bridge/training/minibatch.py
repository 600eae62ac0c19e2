"""The paper's training algorithm: BFGS that starts afresh in every batch of cases."""

from functools import partial
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.engines.types import FitData, StageInputs
from pcnde_bridge.training.history import RunFit
from pcnde_bridge.training.procedure import Step
from pcnde_bridge.training.staged_training import StagedTraining, TrainingState


def random_batches(cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
    """Return the positions of the cases in every batch, at random; the last may be smaller."""
    order = np.random.default_rng(seed).permutation(len(cases))
    return tuple(order[i : i + config.batch_size] for i in range(0, len(cases), config.batch_size))


def select(inputs: StageInputs, batch: Positions | slice) -> StageInputs:
    """Return the inputs of a stage for some of the cases."""
    return tuple(array[batch] for array in inputs)


class MinibatchTraining(StagedTraining):
    """Fits the flow to one batch, the area to each batch in turn, the pressure to all cases."""

    def divide(self, seed: int) -> tuple[Positions, ...]:
        """Return random batches."""
        return random_batches(self.cases, self.config, seed)

    def steps(self, state: TrainingState) -> list[Step]:
        """Return all steps of a run: epochs of the flow with couplings, then the pressure."""
        steps, flow = [], self.config.flow
        for epoch in range(1, flow.epochs + 1):
            steps += [Step("flow", epoch, batch + 1) for batch in range(len(state.batches))]
            if epoch % flow.couple_every == 0:
                steps.append(Step("coupling", epoch))
        return [*steps, Step("temporal_pressure"), Step("spatial_pressure")]

    def count_iterations(self, state: TrainingState) -> int:
        """Count the iterations of all steps, if no fit ends early."""
        config, flow = self.config, self.config.flow
        area = config.intermediate_area.iterations + config.fourier_area.iterations
        per_batch = flow.epochs * flow.iterations + flow.epochs // flow.couple_every * area
        return len(state.batches) * per_batch + self.slow_iterations(state)[0]

    def slow_iterations(self, state: TrainingState) -> tuple[int, float]:
        """Return the pressure's iterations, which compute all cases instead of a batch."""
        config = self.config
        count = config.temporal_pressure.iterations + config.spatial_pressure.iterations
        return count, len(self.cases) / len(state.batches[0])

    def fit_stage(
        self, stage: str, inputs: Any, target: Array, step: Step, state: TrainingState, run: RunFit
    ) -> Array:
        """Fit a stage by BFGS, from where its last fit ended."""
        batches: list[tuple[int, Any]] = list(enumerate(state.batches, 1))
        if step.task == "flow":
            batches = [batches[step.batch - 1]]
        elif step.task != "coupling":
            batches = [(1, slice(None))]
        config, iterations = self.config, getattr(self.config, stage).iterations
        vector: Array = getattr(state.parameters, stage)
        for number, batch in batches:
            if stage == "fourier_area" and config.fourier_area.restart:
                vector = np.repeat([1.0, 0.0], self.cases.n_points)
            data = FitData(select(inputs, batch), target[batch], self.cases.grid, config)
            optimize = partial(getattr(self.engine, stage).fit, vector, data, iterations)
            vector = run(stage, step.epoch, number, optimize)
        return vector
