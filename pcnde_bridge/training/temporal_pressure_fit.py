"""Fit of the pressure network on all cases at once, its last layer by least squares."""

from __future__ import annotations

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.parameters import layer_sizes
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.shared_terms import network_inputs, pressure_scale
from pcnde_bridge.engines.types import Fit, OnIteration, TemporalPressureInputs
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import Projection, VariableProjection
from pcnde_bridge.training.whitening import Whitening

_RIDGE = 1e-9  # on the last layer, p_ref²


def fit_temporal_pressure(
    start: Array,
    inputs: TemporalPressureInputs,
    target: Array,
    selection: tuple[Positions, ...],
    engine: Engine,
    config: PCNDEConfig,
    on_iteration: OnIteration | None = None,
) -> Fit:
    """Fit the pressure network.

    With the last hidden layer h and the scale s = E·h_w/(r₀·p_ref) of a case,
    p̂* − 1 = s·(W·h + c).  For given hidden layers W and c are the minimum of the loss, so the
    gradient with respect to the hidden layers is the one at constant W and c.

    Parameters
    ----------
    start : array of shape (size,)
        Parameters of the network to start from.
    inputs : TemporalPressureInputs
        Inputs of all training cases.
    target : array of shape (case, time, z)
        Reference p/p_ref.
    selection : tuple of arrays of int
        Positions of the cases to fit and, if given, of the validation cases, whose error
        ends the fit.
    engine, config
        Engine that runs L-BFGS, and settings.
    on_iteration : callable, optional
        Called with the number and loss of each iteration.

    Returns
    -------
    Fit
        Parameters of the network.
    """
    settings = config.full_batch
    widths = layer_sizes("temporal_pressure", config, target.shape[1], target.shape[2])
    subsets = [_Subset(inputs, target, positions, config) for positions in selection]
    whitening = Whitening(subsets[0].inputs, widths[1], settings.whitening)
    network = whitening, widths, config.temporal_pressure.activation
    run = settings.replace(weight_decay=settings.pressure_weight_decay)
    limits = settings.pressure_iterations, float(np.mean(target**2))
    fit = VariableProjection(subsets, *network, run, *limits)
    return fit.fit(start, on_iteration, engine.lbfgs)


class _Subset:
    """Some cases, with a row for each case and time point."""

    def __init__(
        self,
        inputs: TemporalPressureInputs,
        target: Array,
        positions: Positions,
        config: PCNDEConfig,
    ) -> None:
        flow, area = inputs.flow[positions], inputs.area[positions]
        area_undeformed, target = inputs.area_undeformed[positions], target[positions]
        seen = network_inputs(flow, area, area_undeformed, config)
        self.inputs = seen.reshape(-1, seen.shape[2])
        scale = pressure_scale(area_undeformed, config.physics)
        self._scale = np.repeat(scale, target.shape[1])[:, None]
        self._target = (target - 1).reshape(-1, target.shape[2])
        self._scaled_target = self._scale * self._target
        self._square = float(np.sum(self._target**2))

    def project(self, hidden: Array) -> Projection:
        """Find W and c, (hidden + 1, z), for the output of the hidden layers."""
        size = self._target.size
        design = np.column_stack([hidden, np.ones(len(hidden))])
        normal = (self._scale**2 * design).T @ design
        normal += np.diag([_RIDGE * size] * hidden.shape[1] + [0.0])
        right = np.einsum("nk,nz->kz", design, self._scaled_target)  # too narrow for BLAS to gain
        layer = solve_normal(normal, right.T).T
        squares = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))

        def gradient() -> Array:
            weights, bias = layer[:-1], layer[-1]
            # s·(s·(W·h + c) − y)·Wᵀ without the residual at every point.
            fit = hidden @ (weights @ weights.T) + bias @ weights.T
            wanted = np.einsum("nz,kz->nk", self._scaled_target, weights)
            result: Array = (2 / size) * (self._scale**2 * fit - wanted)
            return result

        return Projection(layer, squares / size, gradient)

    def error(self, hidden: Array, layer: Array) -> float:
        """Return the mean square error with given W and c."""
        found = self._scale * (hidden @ layer[:-1] + layer[-1])
        return float(np.mean((found - self._target) ** 2))
