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

from dataclasses import replace

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.engines.types import LBFGS, Fit, OnIteration
from pcnde_bridge.training.lbfgs import minimize
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import ForwardPass, HiddenLayers
from pcnde_bridge.training.whitening import Whitening

__all__ = ["Collocation"]


class _Subset:
    """Inputs and target of some cases.

    The design matrix of the least squares has a row for each case and point.
    """

    def __init__(self, flow: Array, area: Array, weight: Array, z: Array) -> None:
        self.z = z - z[0]
        seen = np.concatenate([flow, area], axis=1)
        self.inputs = np.moveaxis(seen, 1, 2).reshape(-1, seen.shape[1])
        gained = np.moveaxis(flow - flow[:, :, :1], 1, 2)
        self.shape = gained.shape[:2]
        # Rows have the root of the weight, so that their squares have the weight.
        self._root = np.repeat(np.sqrt(weight), z.size)[:, None]
        self.target: Array = self._root * gained.reshape(-1, gained.shape[2])

    def design(self, hidden: Array) -> Array:
        """Return ∫h dz' and z − z₀ by the trapezoidal rule, weighted, (case·z, hidden + 1)."""
        from scipy.integrate import cumulative_trapezoid

        h = hidden.reshape(*self.shape, -1)
        integral = cumulative_trapezoid(h, self.z, axis=1, initial=0)
        z = np.broadcast_to(self.z[:, None], (*self.shape, 1))
        design: Array = np.concatenate([integral, z], axis=2).reshape(len(self.inputs), -1)
        return self._root * design

    def design_gradient(self, gradient: Array) -> Array:
        """Return the gradient with respect to h, given that with respect to ∫h dz'."""
        g = (self._root * gradient).reshape(*self.shape, -1)
        # An interval between two points contributes to all points behind it.
        behind = np.cumsum(g[:, :0:-1], axis=1)[:, ::-1] * np.diff(self.z)[:, None] / 2
        result = np.zeros_like(g)
        result[:, 1:] += behind
        result[:, :-1] += behind
        return result.reshape(len(self.inputs), -1)


class Collocation:
    """Fit of the flow network on the reference flow.

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

    def __init__(
        self,
        flow: Array,
        area: Array,
        weight: Array,
        z: Array,
        selection: tuple[Positions, ...],
        whitening: Whitening,
        config: PCNDEConfig,
    ) -> None:
        self._settings = config.full_batch
        self._whitening = whitening
        self._subsets = [_Subset(flow[c], area[c], weight[c], z) for c in selection]
        self._inputs = [whitening.inputs(subset.inputs) for subset in self._subsets]
        hidden = config.flow.hidden
        self._hidden = HiddenLayers((self._inputs[0].shape[1], *hidden), config.flow.activation)
        self._last = (hidden[-1] + 1) * flow.shape[1]  # parameters of the last layer
        target = self._subsets[0].target
        self._scale = 1.0 if config.flow.loss == "sum" else 1 / target.size
        self._unit = self._scale * float(np.sum(flow[selection[0]] ** 2))
        self._decay = self._settings.weight_decay * self._unit
        self._square = self._scale * float(np.sum(target**2))

    def fit(self, start: Array, on_iteration: OnIteration | None, lbfgs: LBFGS) -> Fit:
        """Fit the network from given parameters.

        The loss is that of the flow, with the decay of the last layer.
        """
        found = minimize(
            self._objective,
            self._whitening.coordinates(start)[: -self._last],
            self._settings,
            self._settings.collocation_iterations,
            self._unit,
            self._validation_error if len(self._subsets) > 1 else None,
            on_iteration,
            lbfgs=lbfgs,
        )
        _, _, layer, _ = self._project(found.parameters)
        coordinates = np.concatenate([found.parameters, layer.ravel()])
        return replace(found, parameters=self._whitening.parameters(coordinates))

    def _project(self, coordinates: Array) -> tuple[ForwardPass, Array, Array, float]:
        """Return the forward pass, design matrix, W and c (hidden + 1, time), and the loss."""
        subset = self._subsets[0]
        passed = self._hidden(coordinates, self._inputs[0])
        design = subset.design(passed.last)
        normal = self._scale * design.T @ design + self._decay * np.eye(design.shape[1])
        right = self._scale * design.T @ subset.target
        layer = solve_normal(normal, right.T).T
        loss = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))
        return passed, design, layer, loss

    def _objective(self, coordinates: Array) -> tuple[float, Array]:
        subset = self._subsets[0]
        passed, design, layer, loss = self._project(coordinates)
        weights = layer[:-1].T
        # The residual times the weights, without the residual at every time point.
        back = design @ (layer @ weights) - subset.target @ weights
        back = subset.design_gradient(2 * self._scale * back)
        return loss, self._hidden.gradient(passed, back)

    def _validation_error(self, coordinates: Array) -> float:
        subset, inputs = self._subsets[1], self._inputs[1]
        _, _, layer, _ = self._project(coordinates)
        found = subset.design(self._hidden(coordinates, inputs).last) @ layer
        return float(np.mean((found - subset.target) ** 2))
