"""Fit of the pressure network on all cases at once, its last layer by least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.equations import network_inputs, pressure_scale
from pcnde_bridge.engines.parameters import layer_sizes
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import Fit, OnIteration, TemporalPressureInputs
from pcnde_bridge.training.lbfgs import minimize
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import HiddenLayers
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
    settings, n_points = config.full_batch, target.shape[2]
    widths = layer_sizes("temporal_pressure", config, 0, n_points)
    last = (widths[-2] + 1) * n_points  # parameters of the last layer
    subsets = [_Subset(inputs, target, positions, config) for positions in selection]
    whitening = Whitening(subsets[0].inputs, widths[1], settings.whitening)
    whitened = [whitening.inputs(subset.inputs) for subset in subsets]
    widths = whitened[0].shape[1], *widths[1:-1]
    hidden = HiddenLayers(widths, config.temporal_pressure.activation)

    def objective(coordinates: Array) -> tuple[float, Array]:
        passed = hidden(coordinates, whitened[0])
        layer, loss = subsets[0].last_layer(passed.last)
        return loss, hidden.gradient(passed, subsets[0].gradient(passed.last, layer))

    def validation_error(coordinates: Array) -> float:
        layer, _ = subsets[0].last_layer(hidden(coordinates, whitened[0]).last)
        return subsets[1].error(hidden(coordinates, whitened[1]).last, layer)

    found = minimize(
        objective,
        whitening.coordinates(start[:-last]),
        settings.replace(weight_decay=settings.pressure_weight_decay),
        settings.pressure_iterations,
        float(np.mean(target**2)),
        validation_error if len(selection) > 1 else None,
        on_iteration,
        lbfgs=engine.lbfgs,
    )
    layer, _ = subsets[0].last_layer(hidden(found.parameters, whitened[0]).last)
    parameters = np.concatenate([whitening.parameters(found.parameters), layer.ravel()])
    return replace(found, parameters=parameters)


class _Subset:
    """Inputs and target of some cases, with a row for each case and time point."""

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

    def last_layer(self, hidden: Array) -> tuple[Array, float]:
        """Return W and c as one matrix (hidden + 1, z), and the smallest loss."""
        size = self._target.size
        design = np.column_stack([hidden, np.ones(len(hidden))])
        normal = (self._scale**2 * design).T @ design
        normal += np.diag([_RIDGE * size] * hidden.shape[1] + [0.0])
        right = np.einsum("nk,nz->kz", design, self._scaled_target)  # too narrow for BLAS to gain
        layer = solve_normal(normal, right.T).T
        loss = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))
        return layer, loss / size

    def gradient(self, hidden: Array, layer: Array) -> Array:
        """Return the gradient with respect to the hidden layer at constant W and c."""
        weights, bias = layer[:-1], layer[-1]
        # s·(s·(W·h + c) − y)·Wᵀ without the residual at every point.
        fit = hidden @ (weights @ weights.T) + bias @ weights.T
        missed = self._scale**2 * fit - np.einsum("nz,kz->nk", self._scaled_target, weights)
        gradient: Array = (2 / self._target.size) * missed
        return gradient

    def error(self, hidden: Array, layer: Array) -> float:
        """Return the mean square error with a given last layer."""
        found = self._scale * (hidden @ layer[:-1] + layer[-1])
        return float(np.mean((found - self._target) ** 2))
