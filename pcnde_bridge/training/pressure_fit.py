"""Fit of the pressure stages on all cases at once.

The last layer of the pressure network is found by least squares, and so are all parameters of
the spatial pressure but its steepness.
"""

from dataclasses import replace

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.engines import shared_terms as terms
from pcnde_bridge.engines.types import Fit, FitData, OnIteration, ignore
from pcnde_bridge.training.lbfgs import Options, minimize
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
    data : FitData
        Inputs of all training cases, reference p/p_ref, network and settings.
    """

    def __init__(self, data: FitData) -> None:
        (flow, area, area_undeformed), target, _, config = data
        settings, network = config.full_batch, config.temporal_pressure
        seen = terms.network_inputs(flow, area, area_undeformed, config)
        seen = seen.reshape(-1, seen.shape[2])
        whitening = Whitening(seen, network.hidden[0], settings.whitening)
        limits = settings.memory, settings.pressure_weight_decay, settings.pressure_iterations
        options = Options(*limits, float(np.mean(target**2)))
        super().__init__(seen, whitening, network, target.shape[2], options)
        scale = terms.pressure_scale(area_undeformed, config.physics)
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


class SpatialPressureFit:
    """Fit of a₁, a₂, b₁(t) and b₂(t) by least squares.

    In p* = p̂* + a₁ − (Δp₀ + a₂·Δp₁ + b₁)·σ the step σ(t, z), shaped by b₂, is the same for all
    cases, so that sums over these are enough.  With the residual w = p*_ref − p̂*, ``drop`` and
    ``more`` stand for Δp₀ and Δp₁, per time point.

    Parameters
    ----------
    data : FitData
        Inputs of the cases to fit, reference p/p_ref, points and settings.
    """

    def __init__(self, data: FitData) -> None:
        (temporal, flow, area_undeformed), target, grid, config = data
        physics, settings, z = config.physics, config.full_batch, grid.z
        limits = settings.memory, 0.0, settings.pressure_iterations
        self._options = Options(*limits, float(np.mean(target**2)))
        at_stenosis = terms.flow_at_stenosis(flow, z, physics)
        drop, with_more = (
            terms.stenosis_drop(at_stenosis, area_undeformed, coefficient, physics)
            for coefficient in (physics.turbulent_coefficient, physics.turbulent_coefficient + 1)
        )
        more = (with_more - drop) / physics.reference_pressure
        drop = drop / physics.reference_pressure
        wanted = target - temporal.mean(axis=2, keepdims=True)
        self._height, distance = terms.step_profile(z, config)
        self._inside = terms.STEEPNESS * distance
        self._cases, self._size = float(len(target)), target.size
        self._wanted = wanted.sum(axis=0)
        self._wanted_square = float(np.sum(wanted**2))
        self._more_wanted = np.einsum("nt,ntz->tz", more, wanted)
        self._drop_wanted = np.einsum("nt,ntz->tz", drop, wanted)
        self._more, self._drop = more.sum(axis=0), drop.sum(axis=0)
        self._more_more, self._more_drop = (more * more).sum(axis=0), (more * drop).sum(axis=0)
        self._drop_drop = (drop * drop).sum(axis=0)

    def fit(self, start: Array, on_iteration: OnIteration = ignore) -> Fit:
        """Fit the vector a₁, a₂, b₁, b₂, of shape (2 + 2·time,), from a given one."""
        first = start[2 + len(self._drop) :]
        found = minimize(self.objective, first, self._options, on_iteration)
        linear, _ = self.linear(self.step(found.parameters)[0])
        return replace(found, parameters=np.concatenate([linear, found.parameters]))

    def step(self, b2: Array) -> tuple[Array, Array]:
        """Return the step σ (time, z), and its derivative with respect to b₂."""
        tanh = np.tanh(b2[:, None] * self._inside)
        return self._height * tanh, self._height * self._inside * (1 - tanh**2)

    def linear(self, step: Array) -> tuple[Array, float]:
        """Return the best (a₁, a₂, b₁) for a step (time, z), and their sum of squares."""
        total, square = step.sum(axis=1), (step**2).sum(axis=1)
        n_times, n_points = step.shape
        size = 2 + n_times
        normal, right = np.zeros((size, size)), np.zeros(size)
        normal[0, 0] = self._cases * n_times * n_points
        normal[0, 1] = normal[1, 0] = -np.sum(self._more * total)
        normal[1, 1] = np.sum(self._more_more * square)
        normal[0, 2:] = normal[2:, 0] = -self._cases * total
        normal[1, 2:] = normal[2:, 1] = self._more * square
        normal[range(2, size), range(2, size)] = self._cases * square
        right[0] = self._wanted.sum() + np.sum(self._drop * total)
        right[1] = -np.sum(self._more_wanted * step) - np.sum(self._more_drop * square)
        right[2:] = -np.sum(self._wanted * step, axis=1) - self._drop * square
        known = self._wanted_square + 2 * np.sum(self._drop_wanted * step)
        known += np.sum(self._drop_drop * square)
        unknowns = solve_normal(normal, right)
        return unknowns, float(known - 2 * right @ unknowns + unknowns @ normal @ unknowns)

    def objective(self, b2: Array) -> tuple[float, Array]:
        """Return the mean square error at the best a₁, a₂, b₁, and its gradient."""
        step, slope = self.step(b2)
        unknowns, squares = self.linear(step)
        a1, a2, b1 = unknowns[0], unknowns[1], unknowns[2:]
        # With the factor f = Δp₀ + a₂·Δp₁ + b₁ of the step, e = w − a₁ + f·σ, and Σ e·f is:
        factor = self._drop + a2 * self._more + self._cases * b1
        factor_squared = (
            self._drop_drop
            + a2**2 * self._more_more
            + self._cases * b1**2
            + 2 * (a2 * self._more_drop + b1 * self._drop + a2 * b1 * self._more)
        )
        product = self._drop_wanted + a2 * self._more_wanted + b1[:, None] * self._wanted
        product = product - a1 * factor[:, None] + factor_squared[:, None] * step
        return squares / self._size, 2 * np.sum(product * slope, axis=1) / self._size
