"""Fit of the flow network on all cases at once, first by collocation, then by its equation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import anchor
from pcnde_bridge.engines.types import Fit, FlowInputs, OnIteration
from pcnde_bridge.errors import SolveError
from pcnde_bridge.training.collocation import collocation
from pcnde_bridge.training.lbfgs import minimize
from pcnde_bridge.training.whitening import Whitening

_SAMPLES = 4000  # about this number of the network's inputs gives their spread
_AGREEMENT = 0.5  # smallest squared correlation of stored volume and flow that gives â
_OF_MEDIAN, _OF_LARGEST = 0.3, 0.1  # amplitudes below these fractions count as these

RunFit = Callable[[int, Callable[[OnIteration], Fit]], Array]
"""Runs and records a fit, given its number, from 1; returns its parameters."""


def _unrecorded(_: int, fit: Callable[[OnIteration], Fit]) -> Array:
    return fit(lambda *_: None).parameters


def balanced_flow(cases: Cases, fitted: Positions, config: PCNDEConfig) -> Array:
    """Return the reference flow with a cycle mean that agrees with the reference area.

    The first area stage integrates −â·∂Q/∂z from S_u over n whole cycles of the period T, and
    its end anchors the periodic area.  Only the mean of Q over a cycle remains then:

        S(0) = S_u − n·T·(â·∂Q̄/∂z − b̂).

    In the data Q̄ is the same along the vessel but for errors of averaging, 0.1 % of it in the
    published cases, which would decide the largest error of the area.  So Q̄ is replaced by
    the solution of this equation, with b̂ from the mean over the cases and â from the volumes
    V that they store, Q(L) − Q_in = −(1/â)·∂V/∂t.

    Parameters
    ----------
    cases : Cases
        All training cases.
    fitted : array of int
        Positions of the cases that give â and b̂.
    config : PCNDEConfig
        Number of cycles and the anchor.  With the anchor ``undeformed``, or if flow and
        volume do not agree, the reference flow is returned.

    Returns
    -------
    array of shape (case, time, z)
        Q, mL/s; unchanged at the inlet.
    """
    from scipy.integrate import cumulative_trapezoid, trapezoid

    flow, area, z = cases.flow, cases.area, cases.z
    cycles = -(-anchor(cases.n_times, config) // cases.n_times)  # until the anchor, rounded up
    volume = trapezoid(area[fitted], z, axis=2)
    change = np.roll(volume, -1, axis=1) - np.roll(volume, 1, axis=1)
    stored = change * (cases.n_times / (2 * cases.period))
    gained = flow[fitted, :, -1] - flow[fitted, :, 0]
    gained = gained - gained.mean(axis=1, keepdims=True)
    shared, square = -float(np.sum(stored * gained)), float(np.sum(gained**2))
    agrees = shared > 0 and shared**2 >= _AGREEMENT * square * float(np.sum(stored**2))
    if config.full_batch.mean_flow == "data" or cycles == 0 or not agrees:
        return flow
    a_hat = shared / square
    change = area[:, 0] - cases.area_undeformed
    slope = -(change - change[fitted].mean(axis=0)) / (cycles * cases.period * a_hat)
    mean = cumulative_trapezoid(slope, z, axis=1, initial=0)
    current = flow.mean(axis=1) - flow[:, :, 0].mean(axis=1)[:, None]
    balanced: Array = flow + (mean - current)[:, None]
    return balanced


def amplitude_weight(inflow: Array, fitted: Positions, exponent: float) -> Array:
    """Return the weight of each case's squared error: weaker waveforms have smaller errors.

    The error that the model cannot remove grows with the amplitude, so that equal weights fit
    the residuals of the strongest waveforms at the cost of all others (weighted least squares).

    Parameters
    ----------
    inflow : array of shape (case, time)
        Q at the inlet, mL/s.
    fitted : array of int
        Positions of the cases whose weights have the mean 1.
    exponent : float
        The weight is the inflow's range over time to the power −``exponent``; a range below
        0.3 of the fitted cases' median, 0.1 of their largest or their smallest counts as that.

    Returns
    -------
    array of shape (case,)
        Ones if no fitted inflow varies.
    """
    amplitude = np.ptp(inflow, axis=1)
    seen = amplitude[fitted]
    floor = max(_OF_MEDIAN * np.median(seen), _OF_LARGEST * seen.max(), seen.min())
    if floor == 0:
        return np.ones(len(inflow))
    weight = (np.maximum(amplitude, floor) / floor) ** -exponent  # the largest fitted one is 1
    result: Array = weight / weight[fitted].mean()
    return result


def fit_flow(
    starts: Sequence[Array],
    cases: Cases,
    area: Array,
    selection: tuple[Positions, ...],
    engine: Engine,
    config: PCNDEConfig,
    iterations: int,
    run: RunFit = _unrecorded,
) -> Array:
    """Fit the flow network from some starts, and return the best.

    Each start is fitted on the reference flow (:mod:`pcnde_bridge.training.collocation`); the
    fit through the equation continues from the best of these.  With physics terms, whose form
    only the engine knows, the equation is fitted from each start, with the iterations of both.

    Parameters
    ----------
    starts : sequence of arrays of shape (size,)
        One or more parameter vectors to start from.
    cases : Cases
        All training cases.
    area : array of shape (case, time, z)
        S that the network sees, cm².
    selection : tuple of arrays of int
        Positions of the cases to fit and, if given, of the validation cases, whose error ends
        the fit; the best result has the smallest error on the last of these.
    engine, config
        Compute engine and settings.
    iterations : int
        Largest number of iterations through the equation.
    run : callable
        Runs and records each fit.

    Returns
    -------
    array of shape (size,)
        Parameters of the network.
    """
    settings = config.full_batch
    target = balanced_flow(cases, selection[0], config)
    weight = amplitude_weight(cases.inflow, selection[0], settings.amplitude_exponent)
    whitening = _whitening(cases, area[selection[0]], selection[0], config)
    equation = _Equation(cases, area, target, weight, selection, whitening, engine, config)
    first = 1
    if config.flow.terms:
        iterations += settings.collocation_iterations
    else:
        known = collocation(target, area, weight, cases.z, selection, whitening, config)
        ends = [
            run(number, partial(known.fit, start, lbfgs=engine.lbfgs))
            for number, start in enumerate(starts, first)
        ]
        first += len(starts)
        # If the equation diverges with all of these, it does not with the first start.
        starts = [equation.best([*ends, starts[0]])]
    ends = [
        run(number, partial(equation.fit, start, iterations))
        for number, start in enumerate(starts, first)
    ]
    return equation.best(ends)


def _whitening(cases: Cases, area: Array, fitted: Positions, config: PCNDEConfig) -> Whitening:
    """Return the whitened coordinates for inputs with Q = Q_in and the fitted cases' area."""
    inflow = np.broadcast_to(cases.inflow[fitted][:, :, None], area.shape)
    seen = np.concatenate([inflow, area], axis=1)
    samples = np.moveaxis(seen, 1, 2).reshape(-1, 2 * cases.n_times)
    samples = samples[:: max(1, len(samples) // _SAMPLES)]
    return Whitening(samples, config.flow.hidden[0], config.full_batch.whitening)


@dataclass
class _Equation:
    """Fit of the flow network through the momentum equation, in whitened coordinates."""

    cases: Cases
    area: Array
    target: Array
    weight: Array
    selection: tuple[Positions, ...]
    whitening: Whitening
    engine: Engine
    config: PCNDEConfig

    def __post_init__(self) -> None:
        self._inputs, self._grid = FlowInputs(self.cases.inflow, self.area), self.cases.grid
        fitted = self.selection[0]
        counted = np.zeros(len(self.cases))
        counted[fitted] = self.weight[fitted]
        data = self._inputs, self.target, counted, self._grid, self.config
        self._evaluate = self.engine.flow.objective(*data)
        self._unit = float(np.mean(self.target[fitted] ** 2))
        if self.config.flow.loss == "sum":
            self._unit *= self.target[fitted].size
        self._validate = self._validation_error if len(self.selection) > 1 else None

    def _objective(self, coordinates: Array) -> tuple[float, Array]:
        loss, gradient = self._evaluate(self.whitening.parameters(coordinates))
        return loss, self.whitening.gradient(gradient)

    def _validation_error(self, coordinates: Array) -> float:
        parameters, cases = self.whitening.parameters(coordinates), self.selection[1]
        flow = self.engine.flow.solve(parameters, self._inputs, self._grid, self.config)
        square = np.mean((flow[cases] - self.target[cases]) ** 2, axis=(1, 2))
        return float(np.mean(self.weight[cases] * square))

    def _error(self, vector: Array) -> float:
        coordinates = self.whitening.coordinates(vector)
        try:
            validate = self._validate or (lambda x: self._objective(x)[0])
            error = validate(coordinates)
        except SolveError:
            return np.inf
        return np.inf if np.isnan(error) else error

    def best(self, vectors: Sequence[Array]) -> Array:
        """Return the parameters of the smallest error; a diverging equation counts last."""
        return vectors[0] if len(vectors) == 1 else min(vectors, key=self._error)

    def fit(self, start: Array, iterations: int, on_iteration: OnIteration) -> Fit:
        """Fit by L-BFGS from given parameters."""
        first, lbfgs = self.whitening.coordinates(start), self.engine.lbfgs
        run = self.config.full_batch, iterations, self._unit, self._validate, on_iteration
        found = minimize(self._objective, first, *run, lbfgs=lbfgs)
        return replace(found, parameters=self.whitening.parameters(found.parameters))
