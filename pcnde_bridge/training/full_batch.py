"""Training algorithm of preset ``fast``: every stage on all cases at once.

The equations, the parameters and their layout are the paper's, so that the result is a
model like any other.  Only the way to the minimum differs:

- the flow network by L-BFGS without restarts, in whitened coordinates: first by collocation
  on the reference flow, then through the equation; weaker waveforms have larger weights
  (:mod:`pcnde_bridge.training.flow_fit`);
- (â, b̂) and (a, b) by least squares, point by point (:mod:`pcnde_bridge.training.area_fit`);
- the pressure network's last layer by least squares inside the L-BFGS fit of the hidden
  layers, and a₁, a₂ and b₁(t) by least squares inside the fit of b₂(t)
  (:mod:`pcnde_bridge.training.pressure_fit`).

The engine computes the flow and its gradient; everything else is small enough for numpy.
"""

from functools import partial
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions, some_of
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import FitData
from pcnde_bridge.training.area_fit import fit_area_stage
from pcnde_bridge.training.flow_fit import fit_flow
from pcnde_bridge.training.history import RunFit
from pcnde_bridge.training.pressure_fit import SpatialPressureFit, TemporalPressureFit
from pcnde_bridge.training.procedure import Step
from pcnde_bridge.training.staged_training import StagedTraining, TrainingState


class FullBatchTraining(StagedTraining):
    """Fits every stage to all cases at once, or to as many as the settings allow."""

    def __init__(self, cases: Cases, config: PCNDEConfig, engine: Engine) -> None:
        if len(cases) > (most := config.full_batch.most_cases):
            cases = cases.select(some_of(np.arange(len(cases)), most))
        super().__init__(cases, config, engine)

    def divide(self, _: int) -> tuple[Positions, ...]:
        """Return all cases in use as one batch."""
        return (np.arange(len(self.cases)),)

    def steps(self, _: TrainingState) -> list[Step]:
        """Return all steps of a run: rounds of flow and area, then the pressure."""
        rounds = range(1, self.config.full_batch.rounds + 1)
        steps = [Step(task, number) for number in rounds for task in ("flow", "coupling")]
        return [*steps, Step("temporal_pressure"), Step("spatial_pressure")]

    def count_iterations(self, _: TrainingState) -> int:
        """Count the iterations; the fit of the spatial pressure usually ends after 20."""
        settings = self.config.full_batch
        flow = settings.rounds * settings.collocation_iterations + settings.iterations
        flow += (settings.rounds - 1) * settings.later_iterations
        pressure = settings.pressure_iterations + min(settings.pressure_iterations, 20)
        return flow + 2 * settings.rounds + pressure

    def fit_stage(
        self, stage: str, inputs: Any, target: Array, step: Step, state: TrainingState, run: RunFit
    ) -> Array:
        """Fit a stage by its own algorithm."""
        engine, settings = self.engine, self.config.full_batch
        data = FitData(inputs, target, self.cases.grid, self.config)
        start, record = getattr(state.parameters, stage), partial(run, stage, step.epoch)
        if stage == "flow":
            iterations = settings.iterations if step.epoch == 1 else settings.later_iterations
            return fit_flow(start, self.cases, data, engine, iterations, record)
        if step.task == "coupling":
            return record(1, partial(fit_area_stage, getattr(engine, stage), data))
        fit = TemporalPressureFit if stage == "temporal_pressure" else SpatialPressureFit
        return record(1, partial(fit(data).fit, start))
