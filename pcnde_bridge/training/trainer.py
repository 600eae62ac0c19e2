"""The paper's training loop, independent of the engine that computes.

A run is a fixed list of units of work: one batch of the flow stage, one coupling
of the area, one pressure stage.  Every unit starts the optimizer afresh, so the
parameters and the number of finished units are the whole state of a run, and a
run continued from a checkpoint repeats the interrupted one bit for bit.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.parameters import (
    STAGES,
    Parameters,
    initial_parameters,
)
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import (
    initial_area,
    predict_by_stages,
    solve_area,
    undeformed,
)
from pcnde_bridge.engines.types import (
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    SpatialPressureInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.errors import InputError
from pcnde_bridge.training import full_batch as all_at_once
from pcnde_bridge.training import history as histories
from pcnde_bridge.training import minibatch as batches
from pcnde_bridge.training.algorithm import (
    Algorithm,
    StageFit,
    Unit,
)
from pcnde_bridge.training.checkpoint import Checkpoint, RunState
from pcnde_bridge.training.history import (
    Iteration,
    OnRecord,
    Recorder,
)

FORMAT, FORMAT_VERSION = "pcnde-checkpoint", 1

_ALGORITHMS: dict[str, Algorithm] = {"minibatch": batches, "full_batch": all_at_once}


@dataclass(frozen=True)
class TrainingState(RunState):
    """How far a run has come.

    Attributes
    ----------
    seed : int
        Gave the first parameters and the order of the batches.
    batches : tuple of arrays of int
        Positions of the training cases in every batch.
    parameters : Parameters
        After the finished units.
    couplings : tuple of Parameters
        The parameters at each coupling so far, which give the area that the
        flow network sees.
    finished : int
        Number of finished units.
    history : tuple of Iteration
        All iterations of the finished units.
    """

    seed: int
    batches: tuple[npt.NDArray[np.int64], ...]
    parameters: Parameters
    couplings: tuple[Parameters, ...] = ()
    finished: int = 0
    history: tuple[Iteration, ...] = field(default=(), repr=False)

    @classmethod
    def start(cls, cases: Cases, config: PCNDEConfig, seed: int) -> TrainingState:
        """State before the first unit: seeded parameters and order of the batches.

        With ``training="full_batch"`` the batches are the training part and, unless it
        is left out, the validation part.
        """
        parameters = initial_parameters(config, cases.n_times, cases.n_points, seed)
        return cls(seed, _ALGORITHMS[config.training].divide(cases, config, seed), parameters)


def plan(config: PCNDEConfig, n_batches: int) -> list[Unit]:
    """All units of a run, in order."""
    return _ALGORITHMS[config.training].plan(config, n_batches)


def count_iterations(config: PCNDEConfig, n_batches: int) -> int:
    """Count the iterations of all stages, if no fit ends early."""
    return _ALGORITHMS[config.training].count_iterations(config, n_batches)


def check(cases: Cases, config: PCNDEConfig) -> None:
    """Raise before any computing if the configuration does not fit the cases.

    Raises
    ------
    InputError
        Naming the setting and what to change.
    """
    if not cases.flow.any():
        raise InputError("The training cases have no flow: it is zero everywhere.")
    if config.training == "minibatch" and config.flow.epochs < config.flow.couple_every:
        raise InputError(
            f"flow.epochs={config.flow.epochs} is smaller than flow.couple_every="
            f"{config.flow.couple_every}: the area would never be fitted. Couple at least once."
        )
    if config.fourier_area.terms > cases.n_times // 2:
        raise InputError(
            f"fourier_area.terms={config.fourier_area.terms} needs at least "
            f"{2 * config.fourier_area.terms} instants per cycle, the cases have {cases.n_times}."
        )
    start, length = float(cases.z[0]), float(cases.z[-1] - cases.z[0])
    position = config.physics.stenosis_position
    if not start + length / 3 < position < start + 2 * length / 3:
        raise InputError(
            f"physics.stenosis_position={position} cm is not in the middle third of the vessel "
            f"(z from {start:g} to {start + length:g} cm), where the paper's pressure model needs "
            "it. Set it to where your stenosis is."
        )


class Trainer:
    """Runs the units of a plan.

    Parameters
    ----------
    cases : Cases
        All training cases.
    config : PCNDEConfig
        Settings.
    engine : Engine
        Computes.
    checkpoint : path-like, optional
        File that keeps the state: read if it exists, written after each epoch,
        coupling and pressure stage, and when training is interrupted
        (:class:`~pcnde_bridge.training.checkpoint.Checkpoint`).
    on_record : callable, optional
        Called with every :class:`~pcnde_bridge.training.history.Iteration`.
    """

    def __init__(
        self,
        cases: Cases,
        config: PCNDEConfig,
        engine: Engine,
        checkpoint: str | os.PathLike[str] | None = None,
        on_record: OnRecord | None = None,
    ) -> None:
        check(cases, config)
        self._cases = cases
        self.config = self._config = config
        self._engine = engine
        self._grid = cases.grid
        self._checkpoint = None
        if checkpoint is not None:
            self._checkpoint = Checkpoint(checkpoint, FORMAT, FORMAT_VERSION, cases, config, engine)
        self.on_record = on_record

    def total(self, state: TrainingState) -> int:
        """Count the iterations of a whole run, if no fit ends early."""
        return count_iterations(self._config, len(state.batches))

    def start(self, seed: int) -> TrainingState:
        """First state of a run, or the checkpoint's if there is one.

        Raises
        ------
        InputError
            If the checkpoint belongs to other cases, settings or another seed.
        FileError
            If the checkpoint cannot be read, or could not be written later.
        """
        first = TrainingState.start(self._cases, self._config, seed)
        if self._checkpoint is None:
            return first
        couplings = sum(u.work == "coupling" for u in plan(self._config, len(first.batches)))
        size = sum(vector.size for _, vector in first.parameters)
        # A disk that is full or cannot be written is found now, not after the first epoch.
        self._checkpoint.check((1 + couplings) * size + 6 * self.total(first))
        state = self._checkpoint.read(seed, _state)
        if state is None:
            self._save(first)
            return first
        return state

    def run(self, state: TrainingState, until: int | None = None) -> TrainingState:
        """Run the units that are not finished: all, or up to ``until`` finished ones.

        Raises
        ------
        KeyboardInterrupt
            As it came, after the checkpoint was written.
        SolveError
            If an equation diverges at the start of a fit.
        """
        units = plan(self._config, len(state.batches))
        area = self.coupled_area(state)
        began = time.perf_counter() - state.seconds
        try:
            for unit in units[state.finished : until]:
                record = Recorder(began, self.on_record)
                parameters, couplings = self._fit(unit, state, area, record), state.couplings
                if unit.work == "coupling":
                    area = self._next_area(parameters, area)
                    couplings = (*couplings, parameters)
                state = replace(
                    state,
                    parameters=parameters,
                    couplings=couplings,
                    finished=state.finished + 1,
                    history=(*state.history, *record.iterations),
                )
                following = units[state.finished :][:1]
                if not following or following[0][:2] != unit[:2]:  # no more of this epoch
                    self._save(state)
        except KeyboardInterrupt:
            self._save(state)
            raise
        return state

    def _fit(self, unit: Unit, state: TrainingState, area: Array, record: Recorder) -> Parameters:
        """Parameters after a unit; the area is what the flow network sees."""
        cases, config, engine, grid = self._cases, self._config, self._engine, self._grid
        parameters, s_u = state.parameters, cases.area_undeformed

        def fit(stage: str, inputs: Any, target: Array) -> Array:
            return _ALGORITHMS[config.training].fit(
                StageFit(stage, unit, state, inputs, target, cases, engine, config, record)
            )

        if unit.work == "flow":
            vector = fit("flow", FlowInputs(cases.inflow, area), cases.flow)
            return parameters.replace(flow=vector)
        if unit.work == "coupling":
            # Both area stages, on the flow that the network gives with the area it knows.
            flow = engine.flow.solve(parameters.flow, FlowInputs(cases.inflow, area), grid, config)
            inputs = IntermediateAreaInputs(flow, s_u)
            intermediate = fit("intermediate_area", inputs, cases.area)
            whole = engine.intermediate_area.solve(intermediate, inputs, grid, config)
            start = initial_area(whole, cases.n_times, config)
            fourier = fit("fourier_area", FourierAreaInputs(flow, start), cases.area)
            return parameters.replace(intermediate_area=intermediate, fourier_area=fourier)
        target = cases.pressure / config.physics.reference_pressure
        solved = predict_by_stages(
            engine, parameters.without_pressure(), cases.inflow, s_u, grid, config
        )
        temporal_inputs = TemporalPressureInputs(solved.flow, solved.area, s_u)
        if unit.work == "temporal_pressure":
            vector = fit(unit.work, temporal_inputs, target)
            return parameters.replace(temporal_pressure=vector)
        temporal = engine.temporal_pressure.solve(
            parameters.temporal_pressure, temporal_inputs, grid, config
        )
        vector = fit(unit.work, SpatialPressureInputs(temporal, solved.flow, s_u), target)
        return parameters.replace(spatial_pressure=vector)

    def coupled_area(self, state: TrainingState) -> Array:
        """Area (case, time, z) that the flow network sees, computed from the couplings so far."""
        area = undeformed(self._cases.area_undeformed, self._cases.n_times)
        for parameters in state.couplings:
            area = self._next_area(parameters, area)
        return area

    def _next_area(self, parameters: Parameters, area: Array) -> Array:
        cases = self._cases
        inputs = FlowInputs(cases.inflow, area)
        flow = self._engine.flow.solve(parameters.flow, inputs, self._grid, self._config)
        return solve_area(
            self._engine, parameters, flow, cases.area_undeformed, self._grid, self._config
        )

    def _save(self, state: TrainingState) -> None:
        if self._checkpoint is None:
            return
        facts = {
            "finished": state.finished,
            "couplings": len(state.couplings),
            "batch_sizes": [len(batch) for batch in state.batches],
            "units": len(plan(self._config, len(state.batches))),
        }
        arrays: dict[str, npt.NDArray[Any]] = {
            "batches": np.concatenate(state.batches),
            "history": histories.to_array(state.history),
            **dict(state.parameters),
        }
        for number, coupling in enumerate(state.couplings):
            arrays |= {f"coupling_{number}_{stage}": vector for stage, vector in coupling}
        self._checkpoint.write(state.seed, facts, arrays)


def _state(facts: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> TrainingState:
    """Inverse of what is saved."""

    def parameters(prefix: str) -> Parameters:
        return Parameters(**{stage: arrays[prefix + stage] for stage in STAGES})

    return TrainingState(
        seed=facts["seed"],
        batches=tuple(np.split(arrays["batches"], np.cumsum(facts["batch_sizes"])[:-1])),
        parameters=parameters(""),
        couplings=tuple(parameters(f"coupling_{n}_") for n in range(facts["couplings"])),
        finished=facts["finished"],
        history=tuple(histories.from_array(arrays["history"])),
    )
