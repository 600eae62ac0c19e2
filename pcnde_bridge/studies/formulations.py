"""The momentum equation in space and in time, side by side (sections 2.3 and 3.1).

In time every point has an equation of its own, and nothing but the training ties a point
to its neighbours: Q can be accurate while ∂Q/∂z, and so the area from continuity, is not
smooth.  In space Q is a smooth function of z by its equation.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.config import (
    PAPER,
    PCNDEConfig,
    resolve_pcnde_config,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import check_grid
from pcnde_bridge.engines import EngineName, select_engine
from pcnde_bridge.engines.parameters import initial_parameters, initial_temporal_flow
from pcnde_bridge.engines.protocol import Engine, Stage
from pcnde_bridge.engines.staged import solve_area, undeformed
from pcnde_bridge.engines.types import FlowInputs, IntermediateAreaInputs, TemporalFlowInputs
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.model.metrics import compared, relative_error
from pcnde_bridge.training import full_batch as all_at_once
from pcnde_bridge.training import history as histories
from pcnde_bridge.training.history import Iteration, Recorder
from pcnde_bridge.training.progress import listening
from pcnde_bridge.training.trainer import TrainingState

Formulation = Literal["spatial", "temporal", "temporal_with_time"]

FORMULATIONS: tuple[Formulation, ...] = ("spatial", "temporal", "temporal_with_time")
"""∂Q/∂z = f_θ(Q, S), ∂Q/∂t = f_θ(Q) and ∂Q/∂t = f_θ(Q, t)."""


@dataclass(frozen=True, eq=False)
class FormulationResult:
    """What one formulation gives for some cases.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s; NaN where the equation diverged.
    slope : array of shape (case, time, z)
        ∂Q/∂z, mL/s/cm, by second-order differences.
    continuity_area : array of shape (case, time, z)
        S, cm², from the 1D continuity equation alone: the last cycle, from S_u.
    area : array of shape (case, time, z)
        S, cm², from the method's two area stages, fitted to this flow on the training cases.
    """

    flow: Array
    slope: Array
    continuity_area: Array
    area: Array


@dataclass(frozen=True, eq=False)
class FormulationStudy:
    """The formulations' results on the training and the test cases.

    Attributes
    ----------
    cases : mapping of str to Cases
        ``"train"`` and, if given, ``"test"``: the truth.
    results : mapping of (str, str) to FormulationResult
        For each formulation and set; ``("truth", set)`` holds the true flow, its slope, and
        the areas that the same equations make of it.
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
        """Errors and smoothness, one row for each formulation and set.

        Returns
        -------
        DataFrame
            ``*_error`` is ‖Y − Y_GT‖/‖Y_GT‖, of areas without their ends.
            ``*_variation`` is the total variation along z, Σ|Y(z_{i+1}) − Y(z_i)|, over the
            truth's, of ∂Q/∂z and of S − S_u: 1 is as smooth as the 3D data, more is rougher.
        """
        rows = []
        for (formulation, part), found in self.results.items():
            truth = self.cases[part]
            start = truth.area_undeformed[:, None]
            true_slope = flow_slope(truth.flow, truth.z)
            row: dict[str, Any] = {"formulation": formulation, "set": part}
            row["flow_error"] = relative_error(found.flow, truth.flow)
            row["slope_error"] = relative_error(found.slope, true_slope)
            row["slope_variation"] = variation(found.slope) / variation(true_slope)
            for name, area in (
                ("continuity_area", found.continuity_area),
                ("area", found.area),
            ):
                row[f"{name}_error"] = relative_error(
                    compared("area", area), compared("area", truth.area)
                )
                row[f"{name}_variation"] = variation(compared("area", area - start)) / variation(
                    compared("area", truth.area - start)
                )
            row["outcome"] = self.outcomes.get(formulation, "")
            rows.append(row)
        return pd.DataFrame(rows)


def flow_slope(flow: Array, z: Array) -> Array:
    """∂Q/∂z, mL/s/cm, of Q (case, time, z) by second-order differences."""
    slope: Array = np.gradient(flow, z, axis=2, edge_order=2)
    return slope


def variation(values: Array) -> float:
    """Total variation along z, in the mean over cases and instants."""
    return float(np.abs(np.diff(values, axis=2)).sum(axis=2).mean())


def compare_formulations(
    train: Cases,
    test: Cases | None = None,
    formulations: tuple[Formulation, ...] = FORMULATIONS,
    config: PCNDEConfig | str = PAPER,
    engine: EngineName | Engine = "auto",
    *,
    seed: int = 0,
    progress: bool | Callable[[Iteration], None] = True,
) -> FormulationStudy:
    """Train the momentum equation in space and in time, and compare what they give.

    All are trained on the same batches, by BFGS on the mean squared error of Q, without
    coupling: the spatial one sees S = S_u.  The temporal ones start from the true flow at
    the first instant.

    Parameters
    ----------
    train, test : Cases
        Test cases are optional.
    formulations : tuple of {'spatial', 'temporal', 'temporal_with_time'}
        Which to compare.
    config : PCNDEConfig or str
        Networks, epochs and iterations: the groups ``flow`` and ``temporal_flow``.
    engine : {'auto', 'julia', 'jax'} or Engine
        Who computes.
    seed : int
        Of the first weights and the batches.
    progress : bool or callable
        Show progress, or call with every :class:`~pcnde_bridge.training.history.Iteration`.

    Returns
    -------
    FormulationStudy
        A formulation that diverged has NaN for its results.

    Raises
    ------
    InputError
        If an argument is not usable, or the test cases are not on the training cases' grid.
    """
    unknown = set(formulations) - set(FORMULATIONS)
    if unknown:
        raise InputError(f"Unknown formulations {sorted(unknown)}; choose from {FORMULATIONS}.")
    if not formulations:
        raise InputError(f"Give at least one formulation of {FORMULATIONS}.")
    seed, config = whole("seed", seed), resolve_pcnde_config(config)
    if test is not None:
        check_grid(train.grid, test.grid, "train")
    chosen = select_engine(engine)
    sets = {"train": train} if test is None else {"train": train, "test": test}
    batches = TrainingState.start(train, config.replace(training="minibatch"), seed).batches
    stages = {name: _Trained(name, train, config, chosen, seed) for name in formulations}
    total = len(batches) * sum(s.epochs * s.iterations for s in stages.values())

    outcomes: dict[str, str] = {}
    frames = []
    # What the true flow gives: the equations' own errors.
    results = _results("truth", {part: c.flow for part, c in sets.items()}, sets, chosen, config)
    with listening(progress, total) as on_record:
        for name, stage in stages.items():
            recorder = Recorder(time.perf_counter(), on_record)
            outcomes[name] = stage.fit(batches, recorder)
            frames.append(histories.to_frame(recorder.iterations).assign(formulation=name))
            try:
                flows = {part: stage.solve(cases) for part, cases in sets.items()}
            except SolveError as error:
                outcomes[name] = f"diverged: {error}"
                flows = {part: np.full_like(cases.flow, np.nan) for part, cases in sets.items()}
            results |= _results(name, flows, sets, chosen, config)
    history = pd.concat(frames, ignore_index=True)
    return FormulationStudy(sets, results, outcomes, history)


class _Trained:
    """One formulation's stage, settings and parameters."""

    def __init__(
        self, name: Formulation, train: Cases, config: PCNDEConfig, engine: Engine, seed: int
    ) -> None:
        self._train, self._in_space = train, name == "spatial"
        self._config = config.replace(temporal_flow={"time_input": name == "temporal_with_time"})
        self._stage: Stage[Any] = engine.flow if self._in_space else engine.temporal_flow
        self._grid = train.grid
        settings = config.flow if self._in_space else config.temporal_flow
        self.epochs, self.iterations = settings.epochs, settings.iterations
        if self._in_space:
            first = initial_parameters(config, train.n_times, train.n_points, seed).flow
        else:
            first = initial_temporal_flow(self._config, train.n_points, seed)
        self.parameters = first

    def _inputs(self, cases: Cases) -> FlowInputs | TemporalFlowInputs:
        if self._in_space:
            return FlowInputs(cases.inflow, undeformed(cases.area_undeformed, cases.n_times))
        return TemporalFlowInputs(cases.inflow, cases.flow[:, 0])

    def fit(self, batches: tuple[npt.NDArray[np.int64], ...], recorder: Recorder) -> str:
        """Train on all batches, all epochs; say how it ended."""
        inputs = self._inputs(self._train)
        for epoch in range(1, self.epochs + 1):
            for number, batch in enumerate(batches, 1):
                arrays = {k: v[batch] for k, v in vars(inputs).items()}
                try:
                    self.parameters = self._stage.fit(
                        self.parameters,
                        dataclasses.replace(inputs, **arrays),
                        self._train.flow[batch],
                        self._grid,
                        self._config,
                        self.iterations,
                        recorder("flow", epoch, number),
                    ).parameters
                except SolveError:
                    return f"diverged in epoch {epoch}, batch {number}"
        return "trained"

    def solve(self, cases: Cases) -> Array:
        """Q of any cases on the same grid."""
        return self._stage.solve(self.parameters, self._inputs(cases), self._grid, self._config)


def _results(
    name: str,
    flows: Mapping[str, Array],
    sets: Mapping[str, Cases],
    engine: Engine,
    config: PCNDEConfig,
) -> dict[tuple[str, str], FormulationResult]:
    """Slopes and areas of a formulation's flows."""
    train = sets["train"]
    grid = train.grid
    uncorrected = np.repeat([1.0, 0.0], train.n_points)
    parameters = initial_parameters(config, train.n_times, train.n_points, 0)
    if np.isfinite(flows["train"]).all():
        intermediate, fourier = all_at_once.fit_area(flows["train"], train, engine, config)
        parameters = parameters.replace(intermediate_area=intermediate, fourier_area=fourier)
    results = {}
    for part, cases in sets.items():
        flow, start = flows[part], cases.area_undeformed
        inputs = IntermediateAreaInputs(flow, start)
        by_continuity = engine.intermediate_area.solve(uncorrected, inputs, grid, config)
        results[name, part] = FormulationResult(
            flow,
            flow_slope(flow, cases.z),
            by_continuity[:, -cases.n_times :],
            solve_area(engine, parameters, flow, start, grid, config),
        )
    return results
