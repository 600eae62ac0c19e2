"""Collocation of the flow network on the reference flow: no equation has to be solved.

The momentum equation ∂Q/∂z = W·h(Q, S) + c, with h the network up to its last layer, is
integrated with the reference flow as the network's input:

    Q(z) − Q_in = W·∫ h(Q_ref, S) dz' + c·(z − z₀).

This is linear in W and c, which are found by least squares for all time points at once, so
that only the hidden layers are sought (:mod:`pcnde_bridge.training.variable_projection`).
Errors of Q do not feed back into the network, and an evaluation costs little compared with a
solution of the equation: the minimum is reached in few iterations, nearly the same from every
start.  It lies near the minimum of the equation itself, whose fit starts there.  Fitting
differential equations by their integrals along the data goes back to Himmelblau, Jones and
Bischoff (1967); Roesch, Rackauckas and Stumpf (2021) start neural ones in this way.
"""

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.engines.types import FitData
from pcnde_bridge.training.lbfgs import Options
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import Projection, VariableProjection
from pcnde_bridge.training.whitening import Whitening


class Collocation(VariableProjection):
    """Fit of the flow network on the reference flow, with the decay of the last layer.

    Each case and point is a row of the design matrix.

    Parameters
    ----------
    data : FitData
        Area that the network sees, among the stage's inputs; reference Q of all training cases;
        points; network and settings.
    weight : array of shape (case,)
        Weight of each case's squared error.
    whitening : Whitening
        Coordinates of the network's first layer.
    """

    def __init__(self, data: FitData, weight: Array, whitening: Whitening) -> None:
        (_, area), flow, grid, config = data
        settings, z = config.full_batch, grid.z
        self._z = z - z[0]
        self._scale = 1.0 if config.flow.loss == "sum" else 1 / flow.size
        unit = self._scale * float(np.sum(flow**2))
        self._decay = settings.weight_decay * unit
        seen = np.concatenate([flow, area], axis=1)
        inputs = np.moveaxis(seen, 1, 2).reshape(-1, seen.shape[1])
        limits = settings.memory, settings.weight_decay, settings.collocation_iterations
        super().__init__(inputs, whitening, config.flow, flow.shape[1], Options(*limits, unit))
        gained = np.moveaxis(flow - flow[:, :, :1], 1, 2)
        self._shape = gained.shape[:2]
        # Rows have the root of the weight, so that their squares have the weight.
        self._root = np.repeat(np.sqrt(weight), z.size)[:, None]
        self._target = self._root * gained.reshape(-1, gained.shape[2])
        self._square = self._scale * float(np.sum(self._target**2))

    def project(self, hidden: Array) -> Projection:
        """Find W and c, (hidden + 1, time), for the output of the hidden layers."""
        design = self._design(hidden)
        normal = self._scale * design.T @ design + self._decay * np.eye(design.shape[1])
        right = self._scale * design.T @ self._target
        layer = solve_normal(normal, right.T).T
        loss = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))
        weights = layer[:-1].T
        # The residual times the weights, without the residual at every time point.
        missed = design @ (layer @ weights) - self._target @ weights
        return layer, loss, self._design_gradient(2 * self._scale * missed)

    def _design(self, hidden: Array) -> Array:
        """Return ∫h dz' and z − z₀ by the trapezoidal rule, weighted, (case·z, hidden + 1)."""
        from scipy.integrate import cumulative_trapezoid

        h = hidden.reshape(*self._shape, -1)
        integral = cumulative_trapezoid(h, self._z, axis=1, initial=0)
        z = np.broadcast_to(self._z[:, None], (*self._shape, 1))
        return self._root * np.concatenate([integral, z], axis=2).reshape(len(self._root), -1)

    def _design_gradient(self, gradient: Array) -> Array:
        """Return the gradient with respect to h, given that with respect to ∫h dz'."""
        g = (self._root * gradient).reshape(*self._shape, -1)
        # An interval between two points contributes to all points behind it.
        behind = np.cumsum(g[:, :0:-1], axis=1)[:, ::-1] * np.diff(self._z)[:, None] / 2
        result = np.zeros_like(g)
        result[:, 1:] += behind
        result[:, :-1] += behind
        return result.reshape(len(self._root), -1)
