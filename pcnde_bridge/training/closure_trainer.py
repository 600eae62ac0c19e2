"""Training of the ``physics`` preset: one closure after the other, each a unit of work."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import check_resolution
from pcnde_bridge.data.splits import neighboring_folds
from pcnde_bridge.engines.closure_parameters import (
    CLOSURES,
    ClosureParameters,
    sizes,
)
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import OnIteration
from pcnde_bridge.errors import InputError
from pcnde_bridge.training import closure_fit as fit
from pcnde_bridge.training import history as histories
from pcnde_bridge.training.checkpoint import Checkpoint, RunState
from pcnde_bridge.training.history import (
    Iteration,
    OnRecord,
    Recorder,
)
from pcnde_bridge.uncertainty.sampling import Uncertainty, calibrate

FORMAT, FORMAT_VERSION = "pcnde-closures-checkpoint", 1

_STILL = 0.01
"""Ends whose area varies by less, relative to the middle's, are clamped."""


@dataclass(frozen=True)
class ClosureState(RunState):
    """How far a run has come.

    Attributes
    ----------
    seed : int
        Of the correction's first weights.
    vectors : dict of arrays
        Closures fitted so far, by name; then the ensemble's ``member_0``, ….
    history : tuple of Iteration
        All evaluations that made progress.
    uncertainty : Uncertainty or None
        After the last unit.
    """

    seed: int
    vectors: dict[str, Array]
    history: tuple[Iteration, ...] = field(default=(), repr=False)
    uncertainty: Uncertainty | None = None

    @property
    def parameters(self) -> ClosureParameters:
        """All closures; empty where not fitted yet."""
        return ClosureParameters(**{name: self.vectors.get(name, np.empty(0)) for name in CLOSURES})


_RIGID = 1e-9
"""Areas that vary by less, relative to the largest, do not move."""


class ClosureTrainer:
    """Fits the closures, and keeps the state in a checkpoint after each.

    Parameters
    ----------
    cases : Cases
        All training cases.
    config : ClosureConfig
        Settings.
    engine : Engine
        Computes.
    checkpoint : path-like, optional
        File that keeps the state: read if it exists.
    on_record : callable, optional
        Called with every :class:`~pcnde_bridge.training.history.Iteration`.

    Raises
    ------
    InputError
        If the cases cannot train this model.
    """

    def __init__(
        self,
        cases: Cases,
        config: ClosureConfig,
        engine: Engine,
        checkpoint: str | os.PathLike[str] | None = None,
        on_record: OnRecord | None = None,
    ) -> None:
        check_resolution(cases.n_times, cases.n_points)
        if float(np.std(cases.flow[:, :, -1])) == 0 or float(np.ptp(cases.pressure)) == 0:
            raise InputError("The training cases' flow and pressure do not vary: nothing to learn.")
        if float(np.ptp(cases.area, axis=1).max()) <= _RIGID * float(cases.area.max()):
            raise InputError(
                "The training cases' area does not change in time: their inflow is steady or "
                "their walls are rigid. The physics preset learns from compliant walls in "
                "pulsatile flow; use the preset 'paper' or 'fast'."
            )
        self.config = _decided(cases, config)
        self.on_record = on_record
        self._cases = cases
        self._engine, self._closures = engine, engine.closures
        self._checkpoint = None
        if checkpoint is not None:
            self._checkpoint = Checkpoint(
                checkpoint, FORMAT, FORMAT_VERSION, cases, self.config, engine
            )
        folds = config.correction.folds
        self._left_out = neighboring_folds(cases, folds) if folds else []

    def total(self, _: ClosureState) -> int:
        """Count the iterations of a run at most."""
        return 3 * self.config.correction.evaluations + len(self._left_out) * self._few

    @property
    def _few(self) -> int:
        """Evaluations of the ensemble's fits, which start from the fit to all cases."""
        return max(self.config.correction.evaluations // 5, 2)

    def start(self, seed: int) -> ClosureState:
        """First state of a run, or the checkpoint's if there is one.

        Raises
        ------
        InputError
            If the checkpoint belongs to other cases, settings or another seed.
        FileError
            If the checkpoint cannot be read, or could not be written later.
        """
        first = ClosureState(seed, {})
        if self._checkpoint is None:
            return first
        lengths = sizes(self.config)
        size = sum(lengths.values()) + len(self._left_out) * lengths["correction"]
        self._checkpoint.check(size + 6 * self.total(first))
        state = self._checkpoint.read(seed, self._state)
        if state is None:
            self._save(first)
            return first
        return state

    def run(self, state: ClosureState) -> ClosureState:
        """Fit what is not fitted yet.

        Raises
        ------
        KeyboardInterrupt
            As it came; the finished units are in the checkpoint.
        SolveError
            If the equations cannot be evaluated.
        """
        began = time.perf_counter() - state.seconds
        for name in (*CLOSURES, *(f"member_{k}" for k in range(len(self._left_out)))):
            if name in state.vectors:
                continue
            recorder = Recorder(began, self.on_record)
            vector = self._fit(name, state, recorder)
            state = replace(
                state,
                vectors={**state.vectors, name: vector},
                history=(*state.history, *recorder.iterations),
            )
            self._save(state)
        if self._left_out and state.uncertainty is None:
            members = [state.vectors[f"member_{k}"] for k in range(len(self._left_out))]
            uncertainty = calibrate(
                self._closures,
                state.parameters,
                members,
                self._left_out,
                self._cases,
                self.config,
                np.random.default_rng([state.seed, 1]),
            )
            state = replace(state, uncertainty=uncertainty)
        return state

    def _fit(self, name: str, state: ClosureState, recorder: Recorder) -> Array:
        cases, config, closures = self._cases, self.config, self._closures

        def record(stage: str, epoch: int = 1) -> OnIteration:
            return recorder(stage, epoch, 1)

        if name == "outlet":
            return fit.fit_outlet(cases, config)
        if name == "losses":
            return fit.fit_losses(closures, cases, config, record(name))
        if name == "wall":
            return fit.fit_wall(closures, cases, config, record(name))
        if name == "correction":
            rng = np.random.default_rng([state.seed, 0])
            first = fit.first_correction(cases, config, rng)
            weight, evaluations, epoch = np.ones(len(cases)), config.correction.evaluations, 1
        else:
            number = int(name.removeprefix("member_"))
            first, weight = state.vectors["correction"], np.ones(len(cases))
            weight[self._left_out[number]] = 0
            evaluations, epoch = self._few, number + 2
        return fit.fit_correction(
            closures,
            state.parameters,
            cases,
            config,
            first,
            weight,
            evaluations,
            record("correction", epoch),
        )

    def _save(self, state: ClosureState) -> None:
        if self._checkpoint is None:
            return
        facts = {
            "vectors": list(state.vectors),
            "units": len(CLOSURES) + len(self._left_out),
        }
        arrays: dict[str, npt.NDArray[Any]] = {
            "history": histories.to_array(state.history),
            **state.vectors,
        }
        self._checkpoint.write(state.seed, facts, arrays)

    def _state(
        self, facts: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
    ) -> ClosureState:
        """Inverse of what is saved; raises ValueError for vectors that do not fit."""
        lengths = sizes(self.config)
        vectors = {name: arrays[name] for name in facts["vectors"]}
        for name, vector in vectors.items():
            needed = lengths["correction" if name.startswith("member_") else name]
            if vector.shape != (needed,) or not np.isfinite(vector).all():
                raise ValueError(f"{name} must be {needed} finite numbers, got {vector.shape}")
        history = tuple(histories.from_array(arrays["history"]))
        return ClosureState(facts["seed"], vectors, history)


def _decided(cases: Cases, config: ClosureConfig) -> ClosureConfig:
    """Choose the wall's law by whether the ends of the training cases move."""
    if config.wall.law != "auto":
        return config
    variation = np.ptp(cases.area, axis=1)
    largest = variation.max(axis=1, keepdims=True)
    still = bool((variation[:, [0, -1]] <= _STILL * largest).all())
    return config.replace(wall={"law": "membrane" if still else "local"})
