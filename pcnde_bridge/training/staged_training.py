"""Training of the paper's networks: flow and area alternately, coupled, then the pressure."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray, Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.engines.parameters import STAGES, Parameters, initial_parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import predict_by_stages, solve_area, undeformed
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.training.area_fit import FitStage, fit_area
from pcnde_bridge.training.history import Recorder, RunFit
from pcnde_bridge.training.procedure import Procedure, RunState, Step


@dataclass(frozen=True, kw_only=True)
class TrainingState(RunState):
    """State of a run that trains the paper's networks.

    Attributes
    ----------
    batches : tuple of arrays of int
        Positions of the training cases in every batch.
    parameters : Parameters
        Parameters after the finished steps.
    area : array of shape (case, time, z)
        S that the flow network sees after the couplings so far, cm².
    couplings : tuple of Parameters
        Parameters at each coupling so far, which give this area.
    """

    batches: tuple[Positions, ...]
    parameters: Parameters
    area: Array = field(repr=False)
    couplings: tuple[Parameters, ...] = ()

    @property
    def facts(self) -> dict[str, Any]:
        """Facts for the provenance of the model, with the positions of the cases in batches."""
        return {**super().facts, "batches": [[int(i) for i in batch] for batch in self.batches]}


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
    if (terms := config.fourier_area.terms) > cases.n_times // 2:
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
    """Training procedure of the paper's five stages; subclasses fit a single stage.

    Every fit starts the optimizer afresh, so that the parameters and the number of finished
    steps are the whole state of a run.  The tasks of the steps are ``"flow"``, ``"coupling"``
    (both area stages), ``"temporal_pressure"`` and ``"spatial_pressure"``.

    Parameters
    ----------
    cases : Cases
        All training cases.
    config : PCNDEConfig
        Settings.
    engine : Engine
        Compute engine.

    Raises
    ------
    InputError
        If the configuration does not fit the cases.
    """

    checkpoint_format = "pcnde-checkpoint", 1
    config: PCNDEConfig

    def __init__(self, cases: Cases, config: PCNDEConfig, engine: Engine) -> None:
        check(cases, config)
        self.cases, self.config, self.engine = cases, config, engine

    @abstractmethod
    def divide(self, seed: int) -> tuple[Positions, ...]:
        """Return the positions of the cases in every batch."""

    @abstractmethod
    def fit_stage(
        self, stage: str, inputs: Any, target: Array, step: Step, state: TrainingState, run: RunFit
    ) -> Array:
        """Return the new parameters of a stage, fitted to a target (case, time, z)."""

    def start(self, seed: int) -> TrainingState:
        """Return the state with seeded parameters and batches."""
        cases = self.cases
        parameters = initial_parameters(self.config, cases.n_times, cases.n_points, seed)
        area = undeformed(cases.area_undeformed, cases.n_times)
        return TrainingState(seed=seed, batches=self.divide(seed), parameters=parameters, area=area)

    def fit(self, step: Step, state: TrainingState, recorder: Recorder) -> TrainingState:
        """Return the state with the stages fitted that the step asks for.

        Raises
        ------
        SolveError
            If an equation diverges at the start of a fit.
        """
        fit = partial(self.fit_stage, step=step, state=state, run=recorder.run)
        parameters = state.parameters
        if step.task == "flow":
            inputs = self.cases.inflow, state.area
            fitted = parameters.replace(flow=fit("flow", inputs, self.cases.flow))
            return replace(state, parameters=fitted)
        if step.task == "coupling":
            return self._couple(state, fit)
        return replace(state, parameters=self._fit_pressure(step.task, parameters, fit))

    def _couple(self, state: TrainingState, fit: FitStage) -> TrainingState:
        """Fit both area stages on the predicted flow, and predict the area for the network."""
        flow = self._flow(state.parameters, state.area)
        fitted = fit_area(flow, self.cases, self.engine, self.config, fit)
        parameters = state.parameters.replace(**fitted)
        couplings, area = (*state.couplings, parameters), self._area(parameters, flow)
        return replace(state, parameters=parameters, couplings=couplings, area=area)

    def _fit_pressure(self, stage: str, parameters: Parameters, fit: FitStage) -> Parameters:
        """Fit one of the pressure stages on the predicted flow and area."""
        cases, grid, config = self.cases, self.cases.grid, self.config
        target = cases.pressure / config.physics.reference_pressure
        s_u = cases.area_undeformed
        known = parameters.without_pressure()
        solved = predict_by_stages(self.engine, known, ModelInputs(cases.inflow, s_u, grid), config)
        inputs: Any = solved.flow, solved.area, s_u
        if stage == "spatial_pressure":
            network, vector = self.engine.temporal_pressure, parameters.temporal_pressure
            temporal = network.solve(vector, inputs, grid, config)
            inputs = temporal, solved.flow, s_u
        return parameters.replace(**{stage: fit(stage, inputs, target)})

    def _flow(self, parameters: Parameters, area: Array) -> Array:
        inputs = self.cases.inflow, area
        return self.engine.flow.solve(parameters.flow, inputs, self.cases.grid, self.config)

    def _area(self, parameters: Parameters, flow: Array) -> Array:
        s_u, grid = self.cases.area_undeformed, self.cases.grid
        return solve_area(self.engine, parameters, flow, s_u, grid, self.config)

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

        couplings = tuple(parameters(f"coupling_{n}_") for n in range(facts["couplings"]))
        area = undeformed(self.cases.area_undeformed, self.cases.n_times)
        for coupling in couplings:
            area = self._area(coupling, self._flow(coupling, area))
        return TrainingState(
            seed=facts["seed"],
            batches=tuple(np.split(arrays["batches"], np.cumsum(facts["batch_sizes"])[:-1])),
            parameters=parameters(""),
            area=area,
            couplings=couplings,
            finished=facts["finished"],
        )
