"""Fit of the area stages on all cases at once: exact least squares, point by point."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine, Stage
from pcnde_bridge.engines.staged import anchor
from pcnde_bridge.engines.types import Fit, FitData, OnIteration, ignore
from pcnde_bridge.training.least_squares import solve_per_point

FitStage = Callable[[str, Any, Array], Array]
"""Fits a stage, given its name, inputs and target; returns its parameters."""


def fit_area_stage(stage: Stage, data: FitData, on_iteration: OnIteration = ignore) -> Fit:
    """Fit a, b of S = known + a(z)·f + b(z)·g to the last cycle.

    The stage itself gives known, f and g.

    Parameters
    ----------
    stage : Stage
        Stage of an engine.
    data, on_iteration
        Arguments of its ``fit``.

    Returns
    -------
    Fit
        a and b, each of shape (z,), as one vector.
    """
    inputs, target, grid, config = data
    n_times, n_points = target.shape[1:]

    def solve(a: float, b: float) -> Array:
        return stage.solve(np.repeat([a, b], n_points), inputs, grid, config)[:, -n_times:]

    known = solve(0.0, 0.0)
    columns = [solve(1.0, 0.0) - known, solve(0.0, 1.0) - known]
    unknowns, loss = solve_per_point(columns, target - known)
    on_iteration(1, loss)
    return Fit(unknowns.ravel(), np.array([loss]), True, "least squares")


def fit_area(
    flow: Array, cases: Cases, engine: Engine, config: PCNDEConfig, fit: FitStage
) -> dict[str, Array]:
    """Fit both area stages on a flow (case, time, z).

    Parameters
    ----------
    flow, cases, engine, config
        Flow, mL/s, training cases, compute engine and settings.
    fit : callable
        Fits one stage, given its name, inputs and target; returns its parameters.

    Returns
    -------
    dict of arrays
        Parameters by the names of the stages.
    """
    inputs = flow, cases.area_undeformed
    intermediate = fit("intermediate_area", inputs, cases.area)
    cycles = engine.intermediate_area.solve(intermediate, inputs, cases.grid, config)
    start = cycles[:, anchor(cases.n_times, config)]
    fourier = fit("fourier_area", (flow, start), cases.area)
    return {"intermediate_area": intermediate, "fourier_area": fourier}
