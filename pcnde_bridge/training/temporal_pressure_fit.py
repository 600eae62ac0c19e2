"""Fit of the pressure network on all cases at once, its last layer by least squares."""

from __future__ import annotations

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.parameters import layer_sizes
from pcnde_bridge.engines.shared_terms import network_inputs, pressure_scale
from pcnde_bridge.engines.types import TemporalPressureInputs
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import Projection, VariableProjection
from pcnde_bridge.training.whitening import Whitening

_RIDGE = 1e-9  # on the last layer, p_ref²


class TemporalPressureFit(VariableProjection):
    """Fit of the pressure network, a row for each case and time point.

    With the last hidden layer h and the scale s = E·h_w/(r₀·p_ref) of a case,
    p̂* − 1 = s·(W·h + c).  For given hidden layers W and c are the minimum of the loss, so the
    gradient with respect to the hidden layers is the one at constant W and c.

    Parameters
    ----------
    inputs : TemporalPressureInputs
        Inputs of all training cases.
    target : array of shape (case, time, z)
        Reference p/p_ref.
    config : PCNDEConfig
        Network and settings.
    """

    def __init__(self, inputs: TemporalPressureInputs, target: Array, config: PCNDEConfig) -> None:
        settings, network = config.full_batch, config.temporal_pressure
        seen = network_inputs(inputs.flow, inputs.area, inputs.area_undeformed, config)
        seen = seen.reshape(-1, seen.shape[2])
        widths = layer_sizes("temporal_pressure", config, target.shape[1], target.shape[2])
        whitening = Whitening(seen, widths[1], settings.whitening)
        run = settings.replace(weight_decay=settings.pressure_weight_decay)
        limits = run, settings.pressure_iterations, float(np.mean(target**2))
        super().__init__(seen, whitening, widths, network.activation, *limits)
        scale = pressure_scale(inputs.area_undeformed, config.physics)
        self._scale = np.repeat(scale, target.shape[1])[:, None]
        flat = (target - 1).reshape(-1, target.shape[2])
        self._scaled_target, self._size = self._scale * flat, target.size
        self._square = float(np.sum(flat**2))

    def project(self, hidden: Array) -> Projection:
        """Find W and c, (hidden + 1, z), for the output of the hidden layers."""
        design = np.column_stack([hidden, np.ones(len(hidden))])
        normal = (self._scale**2 * design).T @ design
        normal += np.diag([_RIDGE * self._size] * hidden.shape[1] + [0.0])
        right = np.einsum("nk,nz->kz", design, self._scaled_target)  # too narrow for BLAS to gain
        layer = solve_normal(normal, right.T).T
        squares = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))
        weights, bias = layer[:-1], layer[-1]
        # s·(s·(W·h + c) − y)·Wᵀ without the residual at every point.
        fit = hidden @ (weights @ weights.T) + bias @ weights.T
        wanted = np.einsum("nz,kz->nk", self._scaled_target, weights)
        gradient = (2 / self._size) * (self._scale**2 * fit - wanted)
        return layer, squares / self._size, gradient
