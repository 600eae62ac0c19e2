"""Training of the ``physics`` preset: one closure after the other, then the ensemble."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pcnde_bridge._typing import AnyArray, Array, ComplexArray
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import check_resolution
from pcnde_bridge.data.selection import Positions, some_of
from pcnde_bridge.data.splits import neighboring_folds
from pcnde_bridge.engines.closure_parameters import (
    CLOSURES,
    REFITTED,
    ClosureParameters,
    sizes,
)
from pcnde_bridge.engines.internal_points import POINTS_PER_RADIUS
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.training import closure_fit
from pcnde_bridge.training.closure_parts import HeldCases, hold_cases
from pcnde_bridge.training.history import Recorder
from pcnde_bridge.training.procedure import Procedure, RunState, Step
from pcnde_bridge.uncertainty.sampling import SampledModel, calibrate

_CLAMPED = 0.01  # largest variation of the ends' area, relative to the middle's
_TESTED = 32  # most cases of a fold on which the uncertainty is calibrated: for 90 % quantiles
_RIGID = 1e-9  # largest variation of a rigid vessel's area, relative to the largest S_u


@dataclass(frozen=True, kw_only=True)
class ClosureState(RunState):
    """State of a run that fits the closures of the ``physics`` preset.

    Attributes
    ----------
    vectors : dict of arrays
        Closures fitted so far, by name, then the ensemble's ``losses_0``, ``member_0``, ….
    """

    vectors: dict[str, Array]

    @property
    def parameters(self) -> ClosureParameters:
        """All closures; those that are not fitted yet are empty."""
        return ClosureParameters(**{name: self.vectors.get(name, np.empty(0)) for name in CLOSURES})


class ClosureTraining(Procedure[ClosureState]):
    """Training procedure of the closures.

    The closures are fitted to all cases.  Losses, wall shear stress and correction are then
    fitted once more for each fold of the cases that is left out; these fits are the ensemble
    that gives the uncertainty.

    Parameters
    ----------
    cases : Cases
        All training cases.
    config : ClosureConfig
        Settings; the attribute ``config`` has the wall law and the spacing that were chosen.
    engine : Engine
        Compute engine.

    Raises
    ------
    InputError
        If the closures cannot be trained on the cases.
    """

    checkpoint_format = "pcnde-closures-checkpoint", 1
    config: ClosureConfig

    def __init__(self, cases: Cases, config: ClosureConfig, engine: Engine) -> None:
        _check(cases)
        self.cases, self.engine = cases, engine
        self.config = _with_spacing(cases, _with_wall_law(cases, config))
        folds = config.correction.folds
        self.left_out = neighboring_folds(cases, folds) if folds else []
        self._parts: dict[str, HeldCases] = {}

    def start(self, seed: int) -> ClosureState:
        """Return the state without any closure."""
        return ClosureState(seed=seed, vectors={})

    def steps(self, _: ClosureState) -> list[Step]:
        """Return all steps: one for each closure, then two for each fold that is left out."""
        again = range(2, len(self.left_out) + 2)
        members = [Step(name, epoch) for epoch in again for name in ("losses", "correction")]
        return [*(Step(name) for name in CLOSURES), *members]

    def count_iterations(self, _: ClosureState) -> int:
        """Return the usual number of iterations: most fits end long before their limit.

        The calibration, which has none, takes as long as 25.
        """
        most = self.config.correction.evaluations
        members = 2 * len(self.left_out) * min(self._few, 5) + 25 * bool(self.left_out)
        return sum(min(most, usual) for usual in (10, 6, 10)) + members

    @property
    def _few(self) -> int:
        """Largest number of evaluations of the ensemble's fits, which start from a fit."""
        return max(self.config.correction.evaluations // 5, 2)

    def fit(self, step: Step, state: ClosureState, recorder: Recorder) -> ClosureState:
        """Return the state with one more closure, or member of the ensemble.

        Raises
        ------
        SolveError
            If the equations cannot be evaluated.
        """
        cases, config = self.cases, self.config
        name, weight, member = step.task, np.ones(len(cases)), step.epoch - 2
        if name == "outlet":
            vector = np.zeros(4) if self.outlet else closure_fit.fit_outlet(cases, config)
            return _with(state, name, vector)
        if name == "wall_shear_stress":
            return _with(state, name, self._wall_shear_stress(state.parameters, np.empty(0, int)))
        held = self._held(name, state)
        if name == "wall":
            optimize = partial(closure_fit.fit_wall, held, cases, config)
            return _with(state, name, recorder.run(name, 1, 1, optimize))
        if name == "losses":
            again = None if member < 0 else (state.vectors[name], self.left_out[member], self._few)
            optimize = partial(closure_fit.fit_losses, held, config, again=again)
            fitted = recorder.run(name, step.epoch, 1, optimize)
            return _with(state, name if member < 0 else f"losses_{member}", fitted)
        others = state.parameters
        if member < 0:
            rng = np.random.default_rng([state.seed, 0])
            first = closure_fit.first_correction(cases, config, rng)
            evaluations = config.correction.evaluations
        else:
            first, evaluations = others.correction, self._few
            weight[self.left_out[member]] = 0
            others = others.replace(losses=state.vectors[f"losses_{member}"])
            shear = self._wall_shear_stress(others, self.left_out[member])
            others = others.replace(wall_shear_stress=shear)
        fit = others, config, first, weight, evaluations
        optimize = partial(closure_fit.fit_correction, held, *fit)
        correction = recorder.run("correction", step.epoch, 1, optimize)
        if member < 0:
            return _with(state, name, correction)
        return _with(state, f"member_{member}", others.replace(correction=correction).refitted)

    def _held(self, name: str, state: ClosureState) -> HeldCases:
        """Return the parts of the cases for a closure; those of the wall are released then."""
        if name not in self._parts:
            outlet = self._response(state.parameters) if name == "correction" else None
            given = self.engine.closures, self.cases, self.config, self.workers, outlet
            self._parts = {k: v for k, v in self._parts.items() if k != "wall"}
            self._parts[name] = hold_cases(name, *given)
        return self._parts[name]

    def finish(self, state: ClosureState) -> ClosureState:
        """Calibrate the uncertainty on the folds that were left out."""
        if not self.left_out:
            return state
        members = [state.vectors[f"member_{k}"] for k in range(len(self.left_out))]
        model = SampledModel(self.engine.closures, state.parameters, self.config)
        tested = [some_of(fold, _TESTED) for fold in self.left_out]
        outlet = self._response(state.parameters)
        uncertainty = calibrate(model, members, tested, self.cases, outlet)
        return replace(state, uncertainty=uncertainty)

    def _response(self, parameters: ClosureParameters) -> ComplexArray | None:
        """Return the response of a given outlet, (case, 2, harmonic)."""
        if self.outlet is None:
            return None
        cases = self.cases
        inputs = ModelInputs(cases.inflow, cases.area_undeformed, cases.grid)
        return parameters.respond(self.outlet, inputs, self.config)

    def _wall_shear_stress(self, others: ClosureParameters, left_out: Positions) -> Array:
        given = others, self.cases, self.config
        return closure_fit.fit_wall_shear_stress(self.engine.closures, *given, left_out)

    def to_archive(self, state: ClosureState) -> tuple[dict[str, Any], dict[str, AnyArray]]:
        """Return facts and arrays of a checkpoint."""
        return {"vectors": list(state.vectors)}, dict(state.vectors)

    def from_archive(
        self, facts: Mapping[str, Any], arrays: Mapping[str, AnyArray]
    ) -> ClosureState:
        """Restore a state from the facts and arrays of a checkpoint.

        Raises
        ------
        KeyError, ValueError
            If a vector is missing, or is of another length or not finite.
        """
        lengths = sizes(self.config)
        lengths["member"] = sum(lengths[name] for name in REFITTED)
        vectors = {name: arrays[name] for name in facts["vectors"]}
        for name, vector in vectors.items():
            needed = lengths[name.rstrip("_0123456789")]
            if vector.shape != (needed,) or not np.isfinite(vector).all():
                raise ValueError(f"{name} must be {needed} finite numbers, got {vector.shape}")
        return ClosureState(seed=facts["seed"], finished=len(vectors), vectors=vectors)


def _with(state: ClosureState, name: str, vector: AnyArray) -> ClosureState:
    return replace(state, vectors={**state.vectors, name: vector})


def _check(cases: Cases) -> None:
    check_resolution(cases.n_times, cases.n_points)
    pressure = [(part.pressure.min(), part.pressure.max()) for _, part in cases.batches()]
    if float(np.std(cases.at_point("flow", -1))) == 0 or float(np.ptp(pressure)) == 0:
        raise InputError("The training cases' flow and pressure do not vary: nothing to learn.")
    if float(_variation(cases).max()) <= _RIGID * float(cases.area_undeformed.max()):
        raise InputError(
            "The training cases' area does not change in time: their inflow is steady or "
            "their walls are rigid. The physics preset learns from compliant walls in "
            "pulsatile flow; use the preset 'paper' or 'fast'."
        )


def _variation(cases: Cases) -> Array:
    """Return the variation of the area in time, cm², (case, z)."""
    return np.concatenate([np.ptp(part.area, axis=1) for _, part in cases.batches()])


def _with_wall_law(cases: Cases, config: ClosureConfig) -> ClosureConfig:
    """Choose the wall law by whether the ends of the training cases move."""
    if config.wall.law != "auto":
        return config
    variation = _variation(cases)
    largest = variation.max(axis=1, keepdims=True)
    clamped = bool((variation[:, [0, -1]] <= _CLAMPED * largest).all())
    return config.replace(wall={"law": "membrane" if clamped else "local"})


def _with_spacing(cases: Cases, config: ClosureConfig) -> ClosureConfig:
    """Choose the distance of the points at which the closures are solved."""
    if config.losses.spacing is not None:
        return config
    radius = float(np.sqrt(cases.area_undeformed[:, 0] / np.pi).mean())
    return config.replace(losses={"spacing": radius / POINTS_PER_RADIUS})
