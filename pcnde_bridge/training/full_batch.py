"""Training algorithm of preset ``fast``: every stage on all cases at once.

The equations, the parameters and their layout are the paper's, so that the result is a
model like any other.  Only the way to the minimum differs:

- the flow network by L-BFGS without restarts, in whitened coordinates: first by collocation
  on the reference flow from some starts, then, from the best of these, through the
  equation; weaker waveforms have larger weights (:mod:`pcnde_bridge.training.flow_fit`);
- (â, b̂) and (a, b) by least squares, point by point (:mod:`pcnde_bridge.training.area_fit`);
- the pressure network's last layer by least squares inside the L-BFGS fit of the hidden
  layers (:mod:`pcnde_bridge.training.temporal_pressure_fit`);
- a₁, a₂ and b₁(t) by least squares inside the fit of b₂(t)
  (:mod:`pcnde_bridge.training.spatial_pressure_fit`).

The engine computes the flow and runs L-BFGS; everything else is small enough for numpy.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions, training_and_validation
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.training.area_fit import fit_area_stage
from pcnde_bridge.training.flow_fit import fit_flow
from pcnde_bridge.training.procedure import StageFit, Step
from pcnde_bridge.training.spatial_pressure_fit import fit_spatial_pressure
from pcnde_bridge.training.temporal_pressure_fit import fit_temporal_pressure


def divide(cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
    """Return the positions of the training part and, if there is one, of the validation part."""
    return training_and_validation(cases, config.full_batch.validation, seed)


def plan(config: PCNDEConfig, n_batches: int) -> list[Step]:
    """Return all steps of a run: rounds of flow and area, then the pressure."""
    rounds = range(1, config.full_batch.rounds + 1)
    steps = [Step(task, number) for number in rounds for task in ("flow", "coupling")]
    # Like the flow: first without the validation part, then on all cases.
    steps += [Step("temporal_pressure", number) for number in range(1, n_batches + 1)]
    return [*steps, Step("spatial_pressure")]


def count_iterations(config: PCNDEConfig, n_batches: int) -> int:
    """Count the iterations of all steps, if no fit ends early."""
    settings = config.full_batch
    fits = settings.starts if config.flow.terms else 1  # through the equation, in the first round
    later = settings.rounds - 1
    flow = (settings.starts + later) * settings.collocation_iterations
    flow += fits * settings.iterations + later * settings.later_iterations
    return flow + 2 * settings.rounds + (n_batches + 1) * settings.pressure_iterations


def fit(wanted: StageFit) -> Array:
    """Fit a stage: without the validation part in the first round, then on all cases."""
    stage, step, cases, config = wanted.stage, wanted.step, wanted.cases, wanted.config
    engine, grid, run = wanted.engine, wanted.cases.grid, wanted.recorder.run
    first = step.epoch == 1
    selection = wanted.state.batches if first else (np.arange(len(cases)),)
    if stage == "flow":
        settings, starts = config.full_batch, [wanted.start]
        if first:
            size = cases.n_times, cases.n_points
            starts += [
                initial_parameters(config, *size, wanted.state.seed, number).flow
                for number in range(1, settings.starts)
            ]
        iterations = settings.iterations if first else settings.later_iterations
        run_fit = partial(run, stage, step.epoch)
        area = wanted.inputs.area
        return fit_flow(starts, cases, area, selection, engine, config, iterations, run_fit)
    data = wanted.inputs, wanted.target
    if stage == "temporal_pressure":
        optimize = partial(fit_temporal_pressure, wanted.start, *data, selection, engine, config)
    elif stage == "spatial_pressure":
        optimize = partial(fit_spatial_pressure, wanted.start, *data, engine, grid, config)
    else:
        optimize = partial(fit_area_stage, getattr(engine, stage), *data, grid, config)
    return run(stage, step.epoch, 1, optimize)
