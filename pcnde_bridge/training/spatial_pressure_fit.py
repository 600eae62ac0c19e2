"""Fit of the spatial pressure on all cases at once, all but its steepness by least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.shared_terms import (
    STEEPNESS,
    flow_at_stenosis,
    stenosis_drop,
    step_profile,
)
from pcnde_bridge.engines.types import LBFGS, Fit, OnIteration, SpatialPressureInputs
from pcnde_bridge.training.lbfgs import minimize
from pcnde_bridge.training.least_squares import solve_normal


class SpatialPressureFit:
    """Fit of a₁, a₂, b₁(t) and b₂(t) by least squares.

    In p* = p̂* + a₁ − (Δp₀ + a₂·Δp₁ + b₁)·σ the step σ(t, z), shaped by b₂, is the same for all
    cases, so that sums over these are enough.  With the residual w = p*_ref − p̂*, ``drop`` and
    ``more`` stand for Δp₀ and Δp₁, per time point.

    Parameters
    ----------
    inputs : SpatialPressureInputs
        Inputs of the cases to fit.
    target : array of shape (case, time, z)
        Reference p/p_ref.
    z : array of shape (z,)
        Points, cm.
    config : PCNDEConfig
        Settings.
    """

    def __init__(
        self, inputs: SpatialPressureInputs, target: Array, z: Array, config: PCNDEConfig
    ) -> None:
        physics, settings = config.physics, config.full_batch.replace(weight_decay=0.0)
        self._limits = settings, settings.pressure_iterations, float(np.mean(target**2))
        at_stenosis = flow_at_stenosis(inputs.flow, z, physics)
        drop, with_more = (
            stenosis_drop(at_stenosis, inputs.area_undeformed, coefficient, physics)
            for coefficient in (physics.turbulent_coefficient, physics.turbulent_coefficient + 1)
        )
        more = (with_more - drop) / physics.reference_pressure
        drop = drop / physics.reference_pressure
        wanted = target - inputs.temporal.mean(axis=2, keepdims=True)
        self._height, distance = step_profile(z, config)
        self._inside = STEEPNESS * distance
        self._cases, self._size = float(len(target)), target.size
        self._wanted = wanted.sum(axis=0)
        self._wanted_square = float(np.sum(wanted**2))
        self._more_wanted = np.einsum("nt,ntz->tz", more, wanted)
        self._drop_wanted = np.einsum("nt,ntz->tz", drop, wanted)
        self._more, self._drop = more.sum(axis=0), drop.sum(axis=0)
        self._more_more, self._more_drop = (more * more).sum(axis=0), (more * drop).sum(axis=0)
        self._drop_drop = (drop * drop).sum(axis=0)

    def fit(self, start: Array, lbfgs: LBFGS, on_iteration: OnIteration | None = None) -> Fit:
        """Fit the vector a₁, a₂, b₁, b₂, of shape (2 + 2·time,), from a given one."""
        first = start[2 + len(self._drop) :]
        found = minimize(self.objective, first, *self._limits, lbfgs, on_iteration)
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
