"""The flow network fitted along the flow that is known: no equation needs to be solved.

The momentum equation ∂Q/∂z = W·h(Q, S) + c, with h the network up to its last layer, is
integrated with the data's flow in the place of Q that the network sees:

    Q(z) − Q_in = W·∫ h(Q_data, S) dz' + c·(z − z₀).

This is linear in W and c, which are found by least squares for all instants at once, so
that only the layers before them are sought
(:mod:`pcnde_bridge.training.variable_projection`).  Errors of
Q do not feed back into the network, and a pass costs little beside a solution of the
equation: the minimum is reached in few iterations, nearly the same from every start.  It
lies next to that of the equation itself, whose fit goes on from there.  To fit differential
equations by their integrals along the data is an old idea (Himmelblau, Jones and Bischoff
1967); Roesch, Rackauckas and Stumpf (2021) start neural ones by it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.types import LBFGS, OnIteration
from pcnde_bridge.training.lbfgs import Whitening, minimise
from pcnde_bridge.training.least_squares import solve_normal
from pcnde_bridge.training.variable_projection import HiddenLayers, Passed

__all__ = ["KnownFlow"]


class _Part:
    """Some cases: what the network sees, and what it should make of it.

    The design matrix of the least squares has a row for each case and point.
    """

    def __init__(self, flow: Array, area: Array, weight: Array, z: Array) -> None:
        self.z = z - z[0]
        seen = np.concatenate([flow, area], axis=1)
        self.inputs = np.moveaxis(seen, 1, 2).reshape(-1, seen.shape[1])
        gained = np.moveaxis(flow - flow[:, :, :1], 1, 2)
        self.shape = gained.shape[:2]
        # Of rows, so that squares have the weight itself.
        self._root = np.repeat(np.sqrt(weight), z.size)[:, None]
        self.target: Array = self._root * gained.reshape(-1, gained.shape[2])

    def design(self, hidden: Array) -> Array:
        """∫ h dz' and z − z₀, (case·z, hidden + 1), by the trapezoidal rule, weighted."""
        from scipy.integrate import cumulative_trapezoid

        h = hidden.reshape(*self.shape, -1)
        integral = cumulative_trapezoid(h, self.z, axis=1, initial=0)
        z = np.broadcast_to(self.z[:, None], (*self.shape, 1))
        design: Array = np.concatenate([integral, z], axis=2).reshape(len(self.inputs), -1)
        return self._root * design

    def design_gradient(self, gradient: Array) -> Array:
        """By h, from that by ∫ h dz'."""
        g = (self._root * gradient).reshape(*self.shape, -1)
        # What a step between two points receives is the sum of all points behind it.
        behind = np.cumsum(g[:, :0:-1], axis=1)[:, ::-1] * np.diff(self.z)[:, None] / 2
        result = np.zeros_like(g)
        result[:, 1:] += behind
        result[:, :-1] += behind
        return result.reshape(len(self.inputs), -1)


class KnownFlow:
    """The fit of the flow network along the data's flow.

    Parameters
    ----------
    flow : array of shape (case, time, z)
        Q of all training cases, mL/s.
    area : array of shape (case, time, z)
        S that the network sees, cm².
    weight : array of shape (case,)
        Of each case's squares.
    z : array of shape (z,)
        Points, cm.
    selection : tuple of arrays of int
        Cases to fit, and, if given, cases whose error ends the fit.
    whitening : Whitening
        Of the network's first layer.
    config : PCNDEConfig
        The network and the settings.
    """

    def __init__(
        self,
        flow: Array,
        area: Array,
        weight: Array,
        z: Array,
        selection: tuple[npt.NDArray[np.int64], ...],
        whitening: Whitening,
        config: PCNDEConfig,
    ) -> None:
        self._settings = config.full_batch
        self._whitening = whitening
        self._parts = [_Part(flow[c], area[c], weight[c], z) for c in selection]
        self._seen = [whitening.inputs(part.inputs) for part in self._parts]
        hidden = config.flow.hidden
        self._hidden = HiddenLayers((self._seen[0].shape[1], *hidden), config.flow.activation)
        self._last = (hidden[-1] + 1) * flow.shape[1]  # numbers in the last layer
        target = self._parts[0].target
        self._scale = 1.0 if config.flow.loss == "sum" else 1 / target.size
        self._unit = self._scale * float(np.sum(flow[selection[0]] ** 2))
        self._decay = self._settings.weight_decay * self._unit
        self._square = self._scale * float(np.sum(target**2))

    def fit(self, start: Array, on_iteration: OnIteration | None, lbfgs: LBFGS) -> Array:
        """Return the network's parameters, from others before.

        The loss is that of the flow, with the last layer's decay.
        """
        coordinates = self._whitening.coordinates(start)[: -self._last]
        fitted = minimise(
            self._objective,
            coordinates,
            self._settings,
            self._settings.collocation_iterations,
            self._unit,
            self._validation(),
            on_iteration,
            lbfgs=lbfgs,
        )
        _, _, layer, _ = self._passed(fitted)
        return self._whitening.parameters(np.concatenate([fitted, layer.ravel()]))

    def _passed(self, coordinates: Array) -> tuple[Passed, Array, Array, float]:
        """Pass all through; design matrix, W and c (hidden + 1, time), and the least loss."""
        part = self._parts[0]
        passed = self._hidden(coordinates, self._seen[0])
        design = part.design(passed.last)
        normal = self._scale * design.T @ design + self._decay * np.eye(design.shape[1])
        right = self._scale * design.T @ part.target
        layer = solve_normal(normal, right.T).T
        loss = self._square + float(np.sum(layer * (normal @ layer - 2 * right)))
        return passed, design, layer, loss

    def _objective(self, coordinates: Array) -> tuple[float, Array]:
        part = self._parts[0]
        passed, design, layer, loss = self._passed(coordinates)
        weights = layer[:-1].T
        # The residual times the weights, without the residual at every instant.
        back = design @ (layer @ weights) - part.target @ weights
        back = part.design_gradient(2 * self._scale * back)
        return loss, self._hidden.gradient(passed, back)

    def _validation(self) -> Callable[[Array], float] | None:
        if len(self._parts) == 1:
            return None
        part, seen = self._parts[1], self._seen[1]

        def error(coordinates: Array) -> float:
            _, _, layer, _ = self._passed(coordinates)
            found = part.design(self._hidden(coordinates, seen).last) @ layer
            return float(np.mean((found - part.target) ** 2))

        return error
