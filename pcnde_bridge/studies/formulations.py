"""Momentum equation in space and in time, compared (sections 2.3 and 3.1).

In time every point has its own equation, and only the training relates a point to its
neighbors: Q can be accurate while ∂Q/∂z, and so the area from continuity, is not smooth.
In space, the equation itself makes Q a smooth function of z.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.config import PAPER, PCNDEConfig, resolve_pcnde_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import check_grid
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.engines import EngineChoice, select_engine
from pcnde_bridge.engines.parameters import initial_parameters, initial_temporal_flow
from pcnde_bridge.engines.protocol import Engine, Stage
from pcnde_bridge.engines.staged import solve_area, undeformed
from pcnde_bridge.engines.types import FitData, StageInputs
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.model.metrics import compared, relative_error
from pcnde_bridge.studies._shared import describe_outcome, train_until_divergence
from pcnde_bridge.training import history as histories
from pcnde_bridge.training import minibatch
from pcnde_bridge.training.area_fit import fit_area, fit_area_stage
from pcnde_bridge.training.history import Iteration, Recorder
from pcnde_bridge.training.procedure import Procedure, RunState, Step
from pcnde_bridge.training.trainer import training_session

Formulation = Literal["spatial", "temporal", "temporal_with_time"]

FORMULATIONS: tuple[Formulation, ...] = ("spatial", "temporal", "temporal_with_time")
"""∂Q/∂z = f_θ(Q, S), ∂Q/∂t = f_θ(Q) and ∂Q/∂t = f_θ(Q, t)."""


@dataclass(frozen=True, eq=False, repr=False)
class FormulationResult(Displayed):
    """Flow and areas of one formulation for several cases.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s; NaN where the equation diverged.
    slope : array of shape (case, time, z)
        ∂Q/∂z, mL/s/cm, by second-order differences.
    continuity_area : array of shape (case, time, z)
        S, cm², from the 1D continuity equation alone, in the last cycle from S_u.
    area : array of shape (case, time, z)
        S, cm², from the two area stages, fitted to this flow on the training cases.
    """

    flow: Array
    slope: Array
    continuity_area: Array
    area: Array


@dataclass(frozen=True, eq=False, repr=False)
class FormulationStudy(Displayed):
    """Results of the formulations on the training and test cases.

    Attributes
    ----------
    cases : mapping of str to Cases
        The truth: ``"train"`` and, if given, ``"test"``.
    results : mapping of (str, str) to FormulationResult
        Result for each formulation and subset; ``("truth", subset)`` holds the true flow,
        its slope, and the areas that the same equations give for it.
    outcomes : mapping of str to str
        For each formulation ``"trained"``, or where it diverged.
    history : DataFrame
        Every iteration of training, with a column ``formulation``.
    """

    cases: Mapping[str, Cases]
    results: Mapping[tuple[str, str], FormulationResult]
    outcomes: Mapping[str, str]
    history: pd.DataFrame

    def to_frame(self) -> pd.DataFrame:
        """Return errors and smoothness, a row for each formulation and subset.

        Returns
        -------
        DataFrame
            ``*_error`` is ‖Y − Y_GT‖/‖Y_GT‖, for areas without their ends.
            ``*_variation`` is the total variation along z, Σ|Y(z_{i+1}) − Y(z_i)|, over the
            truth's, of ∂Q/∂z and of S − S_u: 1 is as smooth as the 3D data, more is rougher.
        """
        rows = []
        for (formulation, subset), found in self.results.items():
            cases = self.cases[subset]
            slope = flow_slope(cases.flow, cases.z)
            row: dict[str, Any] = {
                "formulation": formulation,
                "set": subset,
                "flow_error": relative_error(found.flow, cases.flow),
                "slope_error": relative_error(found.slope, slope),
                "slope_variation": variation(found.slope) / variation(slope),
            }
            truth = compared("area", cases.area)
            start = compared("area", cases.area_undeformed[:, None])
            for name in ("continuity_area", "area"):
                area = compared("area", getattr(found, name))
                row[f"{name}_error"] = relative_error(area, truth)
                row[f"{name}_variation"] = variation(area - start) / variation(truth - start)
            rows.append(row | {"outcome": self.outcomes.get(formulation, "")})
        return pd.DataFrame(rows)


def flow_slope(flow: Array, z: Array) -> Array:
    """Return ∂Q/∂z, mL/s/cm, of Q (case, time, z) by second-order differences."""
    return np.gradient(flow, z, axis=2, edge_order=2)


def variation(values: Array) -> float:
    """Return the total variation along z, averaged over cases and time points."""
    return float(np.abs(np.diff(values, axis=2)).sum(axis=2).mean())


def compare_formulations(
    train: Cases,
    test: Cases | None = None,
    formulations: tuple[Formulation, ...] = FORMULATIONS,
    config: PCNDEConfig | str = PAPER,
    engine: EngineChoice = "auto",
    *,
    seed: int = 0,
    progress: bool | Callable[[Iteration], None] = True,
) -> FormulationStudy:
    """Train the momentum equation in space and in time, and compare the results.

    All are trained on the same batches, by BFGS on the mean squared error of Q, without
    coupling: the spatial one uses S = S_u.  The temporal ones start from the true flow at
    the first time point.

    Parameters
    ----------
    train, test : Cases
        Training cases, and optionally test cases.
    formulations : tuple of {'spatial', 'temporal', 'temporal_with_time'}
        Formulations to compare.
    config : PCNDEConfig or str
        Networks, epochs and iterations: the groups ``flow`` and ``temporal_flow``.
    engine : {'auto', 'julia', 'jax'} or Engine
        Compute engine.
    seed : int
        Random seed for the initial weights and the batches.
    progress : bool or callable
        Whether to show progress, or a function that is called with every
        :class:`~pcnde_bridge.training.history.Iteration`.

    Returns
    -------
    FormulationStudy
        Results, which are NaN for a formulation that diverged.

    Raises
    ------
    InputError
        If an argument is invalid, or the test cases are not on the training cases' grid.
    """
    if not formulations or not set(formulations) <= set(FORMULATIONS):
        raise InputError(f"Give at least one formulation of {FORMULATIONS}; got {formulations}.")
    seed, config = whole("seed", seed), resolve_pcnde_config(config)
    if test is not None:
        check_grid(train.grid, test.grid, "train")
    chosen = select_engine(engine)
    subsets = {"train": train} if test is None else {"train": train, "test": test}
    procedures = {name: _FormulationTraining(name, train, config, chosen) for name in formulations}
    starts = {name: procedure.start(seed) for name, procedure in procedures.items()}
    total = sum(p.count_iterations(starts[name]) for name, p in procedures.items())

    outcomes: dict[str, str] = {}
    frames = []
    # The true flow shows the errors of the equations alone.
    true_flows = {subset: cases.flow for subset, cases in subsets.items()}
    results = next(iter(procedures.values())).evaluate("truth", true_flows, subsets)
    with training_session(progress, total) as session:
        for name, procedure in procedures.items():
            steps = len(procedure.steps(starts[name]))
            *_, state = train_until_divergence(procedure, starts[name], session, steps)
            outcomes[name] = describe_outcome(state, steps)
            frames.append(histories.to_frame(state.history).assign(formulation=name))
            try:
                flows = {k: procedure.solve(state, cases) for k, cases in subsets.items()}
            except SolveError as error:
                outcomes[name] = f"diverged: {error}"
                flows = {k: np.full_like(cases.flow, np.nan) for k, cases in subsets.items()}
            results |= procedure.evaluate(name, flows, subsets)
    history = pd.concat(frames, ignore_index=True)
    return FormulationStudy(subsets, results, outcomes, history)


@dataclass(frozen=True, kw_only=True)
class _FormulationState(RunState):
    """State of a formulation's training: the batches and the network's parameters."""

    batches: tuple[Positions, ...]
    parameters: Array


class _FormulationTraining(Procedure[_FormulationState]):
    """Training procedure of one formulation: BFGS on every batch in every epoch."""

    config: PCNDEConfig

    def __init__(self, name: Formulation, cases: Cases, config: PCNDEConfig, engine: Engine):
        self.cases, self.engine, self._in_space = cases, engine, name == "spatial"
        self.config = config.replace(temporal_flow={"time_input": name == "temporal_with_time"})
        self._stage: Stage = engine.flow if self._in_space else engine.temporal_flow
        self._settings = config.flow if self._in_space else config.temporal_flow

    def start(self, seed: int) -> _FormulationState:
        """Return the state with seeded batches and parameters."""
        config, n_points = self.config, self.cases.n_points
        if self._in_space:
            first = initial_parameters(config, self.cases.n_times, n_points, seed).flow
        else:
            first = initial_temporal_flow(config, n_points, seed)
        batches = minibatch.random_batches(self.cases, config, seed)
        return _FormulationState(seed=seed, batches=batches, parameters=first)

    def steps(self, state: _FormulationState) -> list[Step]:
        """Return one step for each epoch and batch."""
        epochs, batches = range(1, self._settings.epochs + 1), range(1, len(state.batches) + 1)
        return [Step("flow", epoch, batch) for epoch in epochs for batch in batches]

    def count_iterations(self, state: _FormulationState) -> int:
        """Count the iterations of all steps, if no fit ends early."""
        return len(self.steps(state)) * self._settings.iterations

    def fit(self, step: Step, state: _FormulationState, recorder: Recorder) -> _FormulationState:
        """Return the state with the network fitted to a batch."""
        cases, batch = self.cases, state.batches[step.batch - 1]
        inputs = minibatch.select(self._inputs(cases), batch)
        data = FitData(inputs, cases.flow[batch], cases.grid, self.config)
        optimize = partial(self._stage.fit, state.parameters, data, self._settings.iterations)
        return replace(state, parameters=recorder.run(*step, optimize))

    def solve(self, state: _FormulationState, cases: Cases) -> Array:
        """Return Q (case, time, z), mL/s, of any cases on the same grid."""
        inputs = self._inputs(cases)
        return self._stage.solve(state.parameters, inputs, self.cases.grid, self.config)

    def _inputs(self, cases: Cases) -> StageInputs:
        if self._in_space:
            return cases.inflow, undeformed(cases.area_undeformed, cases.n_times)
        return cases.inflow, cases.flow[:, 0]

    def evaluate(
        self, name: str, flows: Mapping[str, Array], subsets: Mapping[str, Cases]
    ) -> dict[tuple[str, str], FormulationResult]:
        """Return slopes and areas for the flow of each subset, by formulation and subset."""
        train, grid, config, engine = self.cases, self.cases.grid, self.config, self.engine

        def fit(stage: str, inputs: Any, target: Array) -> Array:
            data = FitData(inputs, target, grid, config)
            return fit_area_stage(getattr(engine, stage), data).parameters

        uncorrected = np.repeat([1.0, 0.0], train.n_points)
        parameters = initial_parameters(config, train.n_times, train.n_points, 0)
        if np.isfinite(flows["train"]).all():
            fitted = fit_area(flows["train"], train, engine, config, fit)
            parameters = parameters.replace(**fitted)
        results = {}
        for subset, cases in subsets.items():
            flow, start = flows[subset], cases.area_undeformed
            inputs = flow, start
            by_continuity = engine.intermediate_area.solve(uncorrected, inputs, grid, config)
            area = solve_area(engine, parameters, flow, start, grid, config)
            slope, last = flow_slope(flow, cases.z), by_continuity[:, -cases.n_times :]
            results[name, subset] = FormulationResult(flow, slope, last, area)
        return results
