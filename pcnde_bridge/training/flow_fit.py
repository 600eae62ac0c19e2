"""Fit of the flow network on all cases at once, first by collocation, then by its equation."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.staged import anchor
from pcnde_bridge.engines.types import Fit, FitData, OnIteration
from pcnde_bridge.training.collocation import Collocation
from pcnde_bridge.training.lbfgs import Options, minimize
from pcnde_bridge.training.whitening import Whitening

RunNumbered = Callable[[int, Callable[[OnIteration], Fit]], Array]
"""Runs and records a fit, given its number, from 1; returns its parameters."""

_SAMPLES = 4000  # about this number of the network's inputs gives their spread
_AGREEMENT = 0.5  # smallest squared correlation of stored volume and flow that gives â
_OF_MEDIAN, _OF_LARGEST = 0.3, 0.1  # amplitudes below these fractions count as these


def balanced_flow(cases: Cases, config: PCNDEConfig) -> Array:
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
    volume = trapezoid(area, z, axis=2)
    change = np.roll(volume, -1, axis=1) - np.roll(volume, 1, axis=1)
    stored = change * (cases.n_times / (2 * cases.period))
    gained = flow[:, :, -1] - flow[:, :, 0]
    gained = gained - gained.mean(axis=1, keepdims=True)
    shared, square = -float(np.sum(stored * gained)), float(np.sum(gained**2))
    agrees = shared > 0 and shared**2 >= _AGREEMENT * square * float(np.sum(stored**2))
    if config.full_batch.mean_flow == "data" or cycles == 0 or not agrees:
        return flow
    a_hat = shared / square
    change = area[:, 0] - cases.area_undeformed
    slope = -(change - change.mean(axis=0)) / (cycles * cases.period * a_hat)
    mean = cumulative_trapezoid(slope, z, axis=1, initial=0)
    current = flow.mean(axis=1) - flow[:, :, 0].mean(axis=1)[:, None]
    return flow + (mean - current)[:, None]


def amplitude_weight(inflow: Array, exponent: float) -> Array:
    """Return the weight of each case's squared error: weaker waveforms have smaller errors.

    The error that the model cannot remove grows with the amplitude, so that equal weights fit
    the residuals of the strongest waveforms at the cost of all others (weighted least squares).

    Parameters
    ----------
    inflow : array of shape (case, time)
        Q at the inlet, mL/s.
    exponent : float
        The weight is the inflow's range over time to the power −``exponent``; a range below
        0.3 of the median, 0.1 of the largest or the smallest counts as that.

    Returns
    -------
    array of shape (case,)
        Weights of mean 1; all are 1 if no inflow varies.
    """
    amplitude = np.ptp(inflow, axis=1)
    floor = max(_OF_MEDIAN * np.median(amplitude), _OF_LARGEST * amplitude.max(), amplitude.min())
    if floor == 0:
        return np.ones(len(inflow))
    weight = (np.maximum(amplitude, floor) / floor) ** -exponent  # the largest is 1
    return weight / weight.mean()


def fit_flow(
    start: Array, cases: Cases, data: FitData, engine: Engine, iterations: int, run: RunNumbered
) -> Array:
    """Fit the flow network.

    It is fitted on the reference flow (:mod:`pcnde_bridge.training.collocation`); the fit
    through the equation continues from there.  With physics terms, whose form only the engine
    knows, the equation alone is fitted, with the iterations of both.

    Parameters
    ----------
    start : array of shape (size,)
        Parameters to start from.
    cases : Cases
        All training cases.
    data : FitData
        Inputs of the stage, reference flow, grid and settings.
    engine : Engine
        Compute engine.
    iterations : int
        Largest number of iterations through the equation.
    run : callable
        Runs and records a fit, given its number, from 1; returns its parameters.

    Returns
    -------
    array of shape (size,)
        Parameters of the network.
    """
    config, settings = data.config, data.config.full_batch
    target = balanced_flow(cases, config)
    data = data._replace(target=target)
    weight = amplitude_weight(cases.inflow, settings.amplitude_exponent)
    whitening = _whitening(data)
    evaluate = engine.flow.objective(data, weight)
    unit = float(np.mean(target**2)) * (target.size if config.flow.loss == "sum" else 1)

    def objective(coordinates: Array) -> tuple[float, Array]:
        loss, gradient = evaluate(whitening.parameters(coordinates))
        return loss, whitening.gradient(gradient)

    def loss(parameters: Array) -> float:
        value, _ = objective(whitening.coordinates(parameters))
        return value if np.isfinite(value) else np.inf

    def fit_equation(start: Array, iterations: int, on_iteration: OnIteration) -> Fit:
        options = Options(settings.memory, settings.weight_decay, iterations, unit)
        found = minimize(objective, whitening.coordinates(start), options, on_iteration)
        return replace(found, parameters=whitening.parameters(found.parameters))

    if config.flow.terms:
        return run(1, partial(fit_equation, start, iterations + settings.collocation_iterations))
    found = run(1, partial(Collocation(data, weight, whitening).fit, start))
    # If the equation diverges with the result, it does not with the start.
    return run(2, partial(fit_equation, min(found, start, key=loss), iterations))


def _whitening(data: FitData) -> Whitening:
    """Return the whitened coordinates for inputs with Q = Q_in and the given area."""
    inflow, area = data.inputs
    seen = np.concatenate([np.broadcast_to(inflow[:, :, None], area.shape), area], axis=1)
    samples = np.moveaxis(seen, 1, 2).reshape(-1, seen.shape[1])
    samples = samples[:: max(1, len(samples) // _SAMPLES)]
    return Whitening(samples, data.config.flow.hidden[0], data.config.full_batch.whitening)
