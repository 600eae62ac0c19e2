"""The paper's training loop, independent of the engine that computes.

A run is a fixed list of units of work: one batch of the flow stage, one coupling
of the area, one pressure stage.  Every unit starts the optimiser afresh, so the
parameters and the number of finished units are the whole state of a run, and a
run continued from a checkpoint repeats the interrupted one bit for bit.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pcnde_bridge import all_at_once
from pcnde_bridge import history as histories
from pcnde_bridge.cases import Cases
from pcnde_bridge.checkpoints import Checkpoint, tell_of_other_engine
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.base import (
    Engine,
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    SpatialPressureInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.history import Iteration, OnRecord, Recorder
from pcnde_bridge.inference import initial_area, solve_area, undeformed
from pcnde_bridge.parameters import STAGES, Parameters, initial_parameters
from pcnde_bridge.provenance import provenance

Array = npt.NDArray[np.float64]

FORMAT, FORMAT_VERSION = "pcnde-checkpoint", 1


class Unit(NamedTuple):
    """A unit of work: ``"flow"``, ``"coupling"`` or a pressure stage."""

    work: str
    epoch: int
    batch: int


@dataclass(frozen=True)
class TrainingState:
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

        With ``training="all_at_once"`` the batches are the training part and, unless it
        is left out, the validation part.
        """
        parameters = initial_parameters(config, cases.n_times, cases.n_points, seed)
        if config.training == "all_at_once":
            return cls(seed, all_at_once.parts(cases, config.all_at_once, seed), parameters)
        order = np.random.default_rng(seed).permutation(cases.n_cases)
        batches = tuple(
            order[i : i + config.batch_size] for i in range(0, cases.n_cases, config.batch_size)
        )
        return cls(seed, batches, parameters)

    @property
    def seconds(self) -> float:
        """Time spent in the finished units."""
        return self.history[-1].seconds if self.history else 0.0


def plan(config: PCNDEConfig, n_batches: int) -> list[Unit]:
    """All units of a run, in order."""
    if config.training == "all_at_once":
        rounds = range(1, config.all_at_once.rounds + 1)
        units = [Unit(work, r, 1) for r in rounds for work in ("flow", "coupling")]
        # As the flow: with the validation part kept apart, then on all cases.
        units += [Unit("temporal_pressure", r, 1) for r in range(1, n_batches + 1)]
        return [*units, Unit("spatial_pressure", 1, 1)]
    units = []
    for epoch in range(1, config.flow.epochs + 1):
        units += [Unit("flow", epoch, batch) for batch in range(1, n_batches + 1)]
        if epoch % config.flow.couple_every == 0:
            units.append(Unit("coupling", epoch, 1))
    return [*units, Unit("temporal_pressure", 1, 1), Unit("spatial_pressure", 1, 1)]


def count_iterations(config: PCNDEConfig, n_batches: int) -> int:
    """Count the iterations of all stages, if no fit ends early."""
    if config.training == "all_at_once":
        fast = config.all_at_once
        fits = fast.starts if config.flow.terms else 1  # of the equation in the first round
        flow_iterations = (fast.starts + fast.rounds - 1) * fast.known_flow_iterations
        flow_iterations += fits * fast.iterations + (fast.rounds - 1) * fast.later_iterations
        return flow_iterations + 2 * fast.rounds + (n_batches + 1) * fast.pressure_iterations
    flow, couplings = config.flow, config.flow.epochs // config.flow.couple_every
    area = config.intermediate_area.iterations + config.fourier_area.iterations
    return (
        n_batches * (flow.epochs * flow.iterations + couplings * area)
        + config.temporal_pressure.iterations
        + config.spatial_pressure.iterations
    )


def check(cases: Cases, config: PCNDEConfig) -> None:
    """Raise before any computing if the configuration does not fit the cases.

    Raises
    ------
    InputError
        Naming the setting and what to change.
    """
    if config.training == "batches" and config.flow.epochs < config.flow.couple_every:
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
        (:class:`~pcnde_bridge.checkpoints.Checkpoint`).
    on_record : callable, optional
        Called with every :class:`~pcnde_bridge.history.Iteration`.
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
        self._config = config
        self._engine = engine
        self._grid = cases.grid
        self._checkpoint = None
        if checkpoint is not None:
            self._checkpoint = Checkpoint(checkpoint, FORMAT, FORMAT_VERSION)
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
        state = self._checkpoint.read(self._read)
        if state is None:
            self._save(first)
            return first
        if state.seed != seed:
            raise InputError(
                f"{self._checkpoint.path} belongs to a run with seed {state.seed}, not {seed}. "
                "Give that seed, or another checkpoint file."
            )
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
                parameters, couplings = state.parameters, state.couplings
                if unit.work == "flow":
                    parameters = self._fit_flow(state, unit, area, record)
                elif unit.work == "coupling":
                    parameters = self._fit_area(state, unit, area, record)
                    area = self._next_area(parameters, area)
                    couplings = (*couplings, parameters)
                else:
                    parameters = self._fit_pressure(state, unit, record)
                state = replace(
                    state,
                    parameters=parameters,
                    couplings=couplings,
                    finished=state.finished + 1,
                    history=(*state.history, *record.iterations),
                )
                if unit.work != "flow" or self._ends_epoch(unit, state):
                    self._save(state)
        except KeyboardInterrupt:
            self._save(state)
            raise
        return state

    def _ends_epoch(self, unit: Unit, state: TrainingState) -> bool:
        return self._config.training == "all_at_once" or unit.batch == len(state.batches)

    def _fit_flow(
        self, state: TrainingState, unit: Unit, area: Array, record: Recorder
    ) -> Parameters:
        if self._config.training == "all_at_once":
            settings, first = self._config.all_at_once, unit.epoch == 1
            starts = [state.parameters.flow]
            if first:
                starts += self._other_starts(state.seed)
            vector = all_at_once.fit_flow(
                starts,
                self._cases,
                area,
                self._selection(state, unit),
                self._engine,
                self._config,
                settings.iterations if first else settings.later_iterations,
                lambda number: record("flow", unit.epoch, number),
            )
            return state.parameters.replace(flow=vector)
        batch = state.batches[unit.batch - 1]
        fit = self._engine.flow.fit(
            state.parameters.flow,
            FlowInputs(self._cases.flow[batch, :, 0], area[batch]),
            self._cases.flow[batch],
            self._grid,
            self._config,
            self._config.flow.iterations,
            record("flow", unit.epoch, unit.batch),
        )
        return state.parameters.replace(flow=fit.parameters)

    def _other_starts(self, seed: int) -> list[Array]:
        """Flow networks before training, beside that of the first state."""
        config, grid = self._config, (self._cases.n_times, self._cases.n_points)
        return [
            initial_parameters(config, *grid, seed, number).flow
            for number in range(1, config.all_at_once.starts)
        ]

    def _fit_area(
        self, state: TrainingState, unit: Unit, area: Array, record: Recorder
    ) -> Parameters:
        """Both area stages, on the flow that the network gives with the area it knows."""
        cases, config, engine = self._cases, self._config, self._engine
        parameters = state.parameters
        flow = engine.flow.solve(
            parameters.flow, FlowInputs(cases.inflow, area), self._grid, config
        )
        if config.training == "all_at_once":
            intermediate, fourier = all_at_once.fit_area(
                flow, cases, engine, config, lambda stage: record(stage, unit.epoch, 1)
            )
            return parameters.replace(intermediate_area=intermediate, fourier_area=fourier)
        vector = parameters.intermediate_area
        for number, batch in enumerate(state.batches, 1):
            vector = engine.intermediate_area.fit(
                vector,
                IntermediateAreaInputs(flow[batch], cases.area_undeformed[batch]),
                cases.area[batch],
                self._grid,
                config,
                config.intermediate_area.iterations,
                record("intermediate_area", unit.epoch, number),
            ).parameters
        parameters = parameters.replace(intermediate_area=vector)
        intermediate = engine.intermediate_area.solve(
            vector, IntermediateAreaInputs(flow, cases.area_undeformed), self._grid, config
        )
        start = initial_area(intermediate, cases.n_times, config)
        first = np.concatenate([np.ones(cases.n_points), np.zeros(cases.n_points)])
        vector = parameters.fourier_area
        for number, batch in enumerate(state.batches, 1):
            vector = engine.fourier_area.fit(
                first if config.fourier_area.restart else vector,
                FourierAreaInputs(flow[batch], start[batch]),
                cases.area[batch],
                self._grid,
                config,
                config.fourier_area.iterations,
                record("fourier_area", unit.epoch, number),
            ).parameters
        return parameters.replace(fourier_area=vector)

    def _fit_pressure(self, state: TrainingState, unit: Unit, record: Recorder) -> Parameters:
        cases, config, engine, parameters = (
            self._cases,
            self._config,
            self._engine,
            state.parameters,
        )
        target = cases.pressure / config.physics.reference_pressure
        solved = engine.predict(
            parameters.without_pressure(), cases.inflow, cases.area_undeformed, self._grid, config
        )
        inputs = TemporalPressureInputs(solved.flow, solved.area, cases.area_undeformed)
        linear = config.training == "all_at_once"
        if unit.work == "temporal_pressure" and linear:
            vector = all_at_once.fit_temporal_pressure(
                parameters.temporal_pressure,
                inputs,
                target,
                self._selection(state, unit),
                engine,
                config,
                record(unit.work, unit.epoch, 1),
            )
            return parameters.replace(temporal_pressure=vector)
        if unit.work == "temporal_pressure":
            fit = engine.temporal_pressure.fit(
                parameters.temporal_pressure,
                inputs,
                target,
                self._grid,
                config,
                config.temporal_pressure.iterations,
                record(unit.work, 1, 1),
            )
            return parameters.replace(temporal_pressure=fit.parameters)
        temporal = engine.temporal_pressure.solve(
            parameters.temporal_pressure, inputs, self._grid, config
        )
        spatial_inputs = SpatialPressureInputs(temporal, solved.flow, cases.area_undeformed)
        if linear:
            vector = all_at_once.fit_spatial_pressure(
                parameters.spatial_pressure,
                spatial_inputs,
                target,
                engine,
                self._grid,
                config,
                record(unit.work, 1, 1),
            )
            return parameters.replace(spatial_pressure=vector)
        fit = engine.spatial_pressure.fit(
            parameters.spatial_pressure,
            spatial_inputs,
            target,
            self._grid,
            config,
            config.spatial_pressure.iterations,
            record(unit.work, 1, 1),
        )
        return parameters.replace(spatial_pressure=fit.parameters)

    def _selection(self, state: TrainingState, unit: Unit) -> tuple[Any, ...]:
        """Training and validation part in the first round, afterwards all cases."""
        return state.batches if unit.epoch == 1 else (np.arange(len(self._cases)),)

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
            "seed": state.seed,
            "finished": state.finished,
            "couplings": len(state.couplings),
            "config": self._config.to_dict(),
            "cases": self._cases.fingerprint(),
            "batch_sizes": [len(batch) for batch in state.batches],
            "units": len(plan(self._config, len(state.batches))),
            "provenance": provenance(self._cases, self._engine, state.seed),
        }
        arrays: dict[str, npt.NDArray[Any]] = {
            "batches": np.concatenate(state.batches),
            "history": histories.to_array(state.history),
            **dict(state.parameters),
        }
        for number, coupling in enumerate(state.couplings):
            arrays |= {f"coupling_{number}_{stage}": vector for stage, vector in coupling}
        self._checkpoint.write(facts, arrays)

    def _read(
        self, path: Path, facts: dict[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
    ) -> TrainingState:
        try:
            before = facts["provenance"]["engine"]
            same_cases = facts["cases"] == self._cases.fingerprint()
            same_config = PCNDEConfig.from_dict(facts["config"]) == self._config
            state = TrainingState(
                seed=facts["seed"],
                batches=tuple(np.split(arrays["batches"], np.cumsum(facts["batch_sizes"])[:-1])),
                parameters=_stage_vectors(arrays, ""),
                couplings=tuple(
                    _stage_vectors(arrays, f"coupling_{n}_") for n in range(facts["couplings"])
                ),
                finished=facts["finished"],
                history=tuple(histories.from_array(arrays["history"])),
            )
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise FileError(f"{path} is not a whole checkpoint: {error!r}.") from error
        if not same_cases:
            raise InputError(
                f"{path} belongs to a run on other cases. Give the same cases, or another "
                "checkpoint file."
            )
        if not same_config:
            raise InputError(
                f"{path} belongs to a run with another configuration. Give the same one, or "
                "another checkpoint file."
            )
        tell_of_other_engine(path, before, self._engine.name)
        return state


def _stage_vectors(arrays: Mapping[str, npt.NDArray[Any]], prefix: str) -> Parameters:
    return Parameters(**{stage: arrays[prefix + stage] for stage in STAGES})
