"""Training of the paper's networks: flow and area in turns, coupled, then the pressure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray, Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.parameters import STAGES, Parameters, initial_parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import initial_area, predict_by_stages, solve_area, undeformed
from pcnde_bridge.engines.types import (
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    SpatialPressureInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.errors import InputError
from pcnde_bridge.training.history import Recorder
from pcnde_bridge.training.procedure import Algorithm, Procedure, StageFit, Step, TrainingState

_FitStage = Callable[[str, Any, Array], Array]  # stage, inputs and target to parameters


def check(cases: Cases, config: PCNDEConfig) -> None:
    """Check that the configuration fits the cases, before any computation.

    Raises
    ------
    InputError
        If it does not; the message names the setting and the change to make.
    """
    if not cases.flow.any():
        raise InputError("The training cases have no flow: it is zero everywhere.")
    if config.training == "minibatch" and config.flow.epochs < config.flow.couple_every:
        raise InputError(
            f"flow.epochs={config.flow.epochs} is smaller than flow.couple_every="
            f"{config.flow.couple_every}: the area would never be fitted. Couple at least once."
        )
    if config.fourier_area.terms > cases.n_times // 2:
        terms = config.fourier_area.terms
        raise InputError(
            f"fourier_area.terms={terms} needs at least {2 * terms} time points per cycle, the "
            f"cases have {cases.n_times}."
        )
    start, length = float(cases.z[0]), float(cases.z[-1] - cases.z[0])
    position = config.physics.stenosis_position
    if not start + length / 3 < position < start + 2 * length / 3:
        raise InputError(
            f"physics.stenosis_position={position} cm is not in the middle third of the vessel "
            f"(z from {start:g} to {start + length:g} cm), where the paper's pressure model needs "
            "it. Set it to the position of your stenosis."
        )


class StagedTraining(Procedure[TrainingState]):
    """Training procedure of the paper's five stages.

    Every fit starts the optimizer afresh, so that the parameters and the number of finished
    steps are the whole state of a run.

    Parameters
    ----------
    cases : Cases
        All training cases.
    config : PCNDEConfig
        Settings.
    engine : Engine
        Compute engine.
    algorithm : Algorithm
        Batches, order of the steps, and fit of a stage.

    Raises
    ------
    InputError
        If the configuration does not fit the cases.
    """

    checkpoint_format = "pcnde-checkpoint", 1
    config: PCNDEConfig

    def __init__(
        self, cases: Cases, config: PCNDEConfig, engine: Engine, algorithm: Algorithm
    ) -> None:
        check(cases, config)
        self.cases, self.config, self.engine = cases, config, engine
        self._algorithm = algorithm
        self._coupled: tuple[tuple[Parameters, ...], Array] | None = None

    def start(self, seed: int) -> TrainingState:
        """Return the state with seeded parameters and batches."""
        cases, config = self.cases, self.config
        parameters = initial_parameters(config, cases.n_times, cases.n_points, seed)
        batches = self._algorithm.divide(cases, config, seed)
        return TrainingState(seed=seed, batches=batches, parameters=parameters)

    def steps(self, state: TrainingState) -> list[Step]:
        """Return all steps of the run: flow, coupling of the area, pressure stages."""
        return self._algorithm.plan(self.config, len(state.batches))

    def count_iterations(self, state: TrainingState) -> int:
        """Count the iterations of all steps, if no fit ends early."""
        return self._algorithm.count_iterations(self.config, len(state.batches))

    def fit(self, step: Step, state: TrainingState, recorder: Recorder) -> TrainingState:
        """Return the state with the stages fitted that the step asks for.

        Raises
        ------
        SolveError
            If an equation diverges at the start of a fit.
        """

        def fit(stage: str, inputs: Any, target: Array) -> Array:
            run = self.cases, self.config, self.engine, recorder
            return self._algorithm.fit(StageFit(stage, step, state, inputs, target, *run))

        parameters, couplings = state.parameters, state.couplings
        if step.task == "flow":
            inputs = FlowInputs(self.cases.inflow, self.coupled_area(state))
            parameters = parameters.replace(flow=fit("flow", inputs, self.cases.flow))
        elif step.task == "coupling":
            parameters = self._fit_area(state, fit)
            couplings = (*couplings, parameters)
        else:
            parameters = self._fit_pressure(step.task, parameters, fit)
        return replace(state, parameters=parameters, couplings=couplings)

    def _fit_area(self, state: TrainingState, fit: _FitStage) -> Parameters:
        """Fit both area stages on the flow that the network predicts with the coupled area."""
        parameters, cases, grid = state.parameters, self.cases, self.cases.grid
        flow_inputs = FlowInputs(cases.inflow, self.coupled_area(state))
        flow = self.engine.flow.solve(parameters.flow, flow_inputs, grid, self.config)
        inputs = IntermediateAreaInputs(flow, cases.area_undeformed)
        intermediate = fit("intermediate_area", inputs, cases.area)
        cycles = self.engine.intermediate_area.solve(intermediate, inputs, grid, self.config)
        start = initial_area(cycles, cases.n_times, self.config)
        fourier = fit("fourier_area", FourierAreaInputs(flow, start), cases.area)
        return parameters.replace(intermediate_area=intermediate, fourier_area=fourier)

    def _fit_pressure(self, stage: str, parameters: Parameters, fit: _FitStage) -> Parameters:
        """Fit one of the pressure stages on the predicted flow and area."""
        cases, grid, config = self.cases, self.cases.grid, self.config
        target = cases.pressure / config.physics.reference_pressure
        s_u = cases.area_undeformed
        known = parameters.without_pressure()
        solved = predict_by_stages(self.engine, known, cases.inflow, s_u, grid, config)
        inputs = TemporalPressureInputs(solved.flow, solved.area, s_u)
        if stage == "temporal_pressure":
            return parameters.replace(temporal_pressure=fit(stage, inputs, target))
        network = self.engine.temporal_pressure
        temporal = network.solve(parameters.temporal_pressure, inputs, grid, config)
        spatial_inputs = SpatialPressureInputs(temporal, solved.flow, s_u)
        return parameters.replace(spatial_pressure=fit(stage, spatial_inputs, target))

    def coupled_area(self, state: TrainingState) -> Array:
        """Return the area (case, time, z), cm², that the flow network sees after the couplings."""
        known, area = self._coupled or ((), None)
        if area is None or known != state.couplings[: len(known)]:
            known, area = (), undeformed(self.cases.area_undeformed, self.cases.n_times)
        for parameters in state.couplings[len(known) :]:
            inputs = FlowInputs(self.cases.inflow, area)
            grid, s_u = self.cases.grid, self.cases.area_undeformed
            flow = self.engine.flow.solve(parameters.flow, inputs, grid, self.config)
            area = solve_area(self.engine, parameters, flow, s_u, grid, self.config)
        self._coupled = state.couplings, area
        return area

    def count_numbers(self, state: TrainingState) -> int:
        """Count the parameters in the last checkpoint: current ones and those of each coupling."""
        couplings = sum(step.task == "coupling" for step in self.steps(state))
        return (1 + couplings) * sum(vector.size for _, vector in state.parameters)

    def to_archive(self, state: TrainingState) -> tuple[dict[str, Any], dict[str, AnyArray]]:
        """Return facts and arrays of a checkpoint."""
        facts = {"finished": state.finished, "couplings": len(state.couplings)}
        arrays = {"batches": np.concatenate(state.batches), **dict(state.parameters)}
        for number, coupling in enumerate(state.couplings):
            arrays |= {f"coupling_{number}_{stage}": vector for stage, vector in coupling}
        return {**facts, "batch_sizes": [len(batch) for batch in state.batches]}, arrays

    def from_archive(
        self, facts: Mapping[str, Any], arrays: Mapping[str, AnyArray]
    ) -> TrainingState:
        """Restore a state from the facts and arrays of a checkpoint."""

        def parameters(prefix: str) -> Parameters:
            return Parameters(**{stage: arrays[prefix + stage] for stage in STAGES})

        return TrainingState(
            seed=facts["seed"],
            batches=tuple(np.split(arrays["batches"], np.cumsum(facts["batch_sizes"])[:-1])),
            parameters=parameters(""),
            couplings=tuple(parameters(f"coupling_{n}_") for n in range(facts["couplings"])),
            finished=facts["finished"],
        )
