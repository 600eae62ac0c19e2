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

from __future__ import annotations

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.parameters import layer_sizes
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import Projection, VariableProjection
from pcnde_bridge.training.whitening import Whitening

__all__ = ["collocation"]


class _Subset:
    """Some cases, with a row of the design matrix for each case and point.

    ``scale`` multiplies the squares, and ``decay`` the squared parameters of the last layer.
    """

    def __init__(
        self, flow: Array, area: Array, weight: Array, z: Array, scale: float, decay: float
    ) -> None:
        self._z, self._scale, self._decay = z - z[0], scale, decay
        seen = np.concatenate([flow, area], axis=1)
        self.inputs = np.moveaxis(seen, 1, 2).reshape(-1, seen.shape[1])
        gained = np.moveaxis(flow - flow[:, :, :1], 1, 2)
        self._shape = gained.shape[:2]
        # Rows have the root of the weight, so that their squares have the weight.
        self._root = np.repeat(np.sqrt(weight), z.size)[:, None]
        self._target: Array = self._root * gained.reshape(-1, gained.shape[2])
        self._square = scale * float(np.sum(self._target**2))

    def project(self, hidden: Array) -> Projection:
        """Find W and c, (hidden + 1, time), for the output of the hidden layers."""
        design = self._design(hidden)
        normal = self._scale * design.T @ design + self._decay * np.eye(design.shape[1])
        right = self._scale * design.T @ self._target
        layer = solve_normal(normal, right.T).T
        loss = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))

        def gradient() -> Array:
            weights = layer[:-1].T
            # The residual times the weights, without the residual at every time point.
            missed = design @ (layer @ weights) - self._target @ weights
            return self._design_gradient(2 * self._scale * missed)

        return Projection(layer, loss, gradient)

    def error(self, hidden: Array, layer: Array) -> float:
        """Return the mean square error with given W and c."""
        return float(np.mean((self._design(hidden) @ layer - self._target) ** 2))

    def _design(self, hidden: Array) -> Array:
        """Return ∫h dz' and z − z₀ by the trapezoidal rule, weighted, (case·z, hidden + 1)."""
        from scipy.integrate import cumulative_trapezoid

        h = hidden.reshape(*self._shape, -1)
        integral = cumulative_trapezoid(h, self._z, axis=1, initial=0)
        z = np.broadcast_to(self._z[:, None], (*self._shape, 1))
        design: Array = np.concatenate([integral, z], axis=2).reshape(len(self.inputs), -1)
        return self._root * design

    def _design_gradient(self, gradient: Array) -> Array:
        """Return the gradient with respect to h, given that with respect to ∫h dz'."""
        g = (self._root * gradient).reshape(*self._shape, -1)
        # An interval between two points contributes to all points behind it.
        behind = np.cumsum(g[:, :0:-1], axis=1)[:, ::-1] * np.diff(self._z)[:, None] / 2
        result = np.zeros_like(g)
        result[:, 1:] += behind
        result[:, :-1] += behind
        return result.reshape(len(self.inputs), -1)


def collocation(
    flow: Array,
    area: Array,
    weight: Array,
    z: Array,
    selection: tuple[Positions, ...],
    whitening: Whitening,
    config: PCNDEConfig,
) -> VariableProjection:
    """Return the fit of the flow network on the reference flow.

    The loss is that of the flow, with the decay of the last layer.

    Parameters
    ----------
    flow : array of shape (case, time, z)
        Reference Q of all training cases, mL/s.
    area : array of shape (case, time, z)
        S that the network sees, cm².
    weight : array of shape (case,)
        Weight of each case's squared error.
    z : array of shape (z,)
        Points, cm.
    selection : tuple of arrays of int
        Positions of the cases to fit and, if given, of the validation cases.
    whitening : Whitening
        Coordinates of the network's first layer.
    config : PCNDEConfig
        Network and settings.
    """
    settings, fitted = config.full_batch, flow[selection[0]]
    scale = 1.0 if config.flow.loss == "sum" else 1 / fitted.size
    unit = scale * float(np.sum(fitted**2))
    decay = settings.weight_decay * unit
    subsets = [_Subset(flow[c], area[c], weight[c], z, scale, decay) for c in selection]
    widths, activation = layer_sizes("flow", config, flow.shape[1], z.size), config.flow.activation
    iterations = settings.collocation_iterations
    return VariableProjection(subsets, whitening, widths, activation, settings, iterations, unit)
