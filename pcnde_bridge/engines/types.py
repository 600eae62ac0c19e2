"""Arrays that go into the stages of an engine and come out of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from pcnde_bridge._typing import Array
from pcnde_bridge.data.grid import Grid

OnIteration = Callable[[int, float], None]
"""Callback with an iteration's number, from 1, and its loss; it may raise to stop."""

Objective = Callable[[Array], tuple[float, Array]]
"""Loss and gradient at a parameter vector; the loss is infinite where the equation diverges."""

OnIterate = Callable[[Array, float], None]
"""Callback with an accepted parameter vector and its loss; it may raise to stop."""

LBFGS = Callable[[Objective, Array, int, int, OnIterate], None]
"""Signature of :meth:`pcnde_bridge.engines.protocol.Engine.lbfgs`."""

StageInputs = tuple[Array, ...]
"""Inputs of a stage, one of the tuples below; all arrays are of shape (case, ...)."""

Problem = Callable[[Array], tuple[Array, Array]]
"""Value of a closure and its Jacobian (one more axis) at the closure's parameters."""


class FlowInputs(NamedTuple):
    """Inputs of the momentum equation.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Q(z=0, t), mL/s.
    area : array of shape (case, time, z)
        S, cm²; linear in z between the points.
    """

    inflow: Array
    area: Array


class TemporalFlowInputs(NamedTuple):
    """Inputs of the momentum equation in time.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Q(z=0, t), mL/s; linear in time between the time points.
    initial_flow : array of shape (case, z)
        Q at the first time point, mL/s.
    """

    inflow: Array
    initial_flow: Array


class IntermediateAreaInputs(NamedTuple):
    """Inputs of the continuity equation.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s, periodic and linear in time between the time points.
    area_undeformed : array of shape (case, z)
        S_u, cm², the initial condition.
    """

    flow: Array
    area_undeformed: Array


class FourierAreaInputs(NamedTuple):
    """Inputs of the periodic area.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s.
    initial_area : array of shape (case, z)
        Ŝ(z, t=0), cm², from the intermediate area.
    """

    flow: Array
    initial_area: Array


class TemporalPressureInputs(NamedTuple):
    """Inputs of the first pressure stage.

    Attributes
    ----------
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """

    flow: Array
    area: Array
    area_undeformed: Array


class SpatialPressureInputs(NamedTuple):
    """Inputs of the second pressure stage.

    Attributes
    ----------
    temporal : array of shape (case, time, z)
        p̂*, the first stage's result.
    flow : array of shape (case, time, z)
        Q, mL/s.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """

    temporal: Array
    flow: Array
    area_undeformed: Array


class ModelInputs(NamedTuple):
    """Inputs of a whole model.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Q_in, mL/s.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    grid : Grid
        Grid of inputs and results.
    """

    inflow: Array
    area_undeformed: Array
    grid: Grid


@dataclass(frozen=True)
class Fit:
    """Result of one run of BFGS.

    Attributes
    ----------
    parameters : array of shape (size,)
        The last accepted iterate.
    losses : array of shape (iterations + 1,)
        Loss at the start and after each iteration.
    converged : bool
        Whether the run met a tolerance.
    message : str
        Reason why the run ended.
    """

    parameters: Array
    losses: Array
    converged: bool
    message: str


class Solution(NamedTuple):
    """Prediction of a whole model.

    Attributes
    ----------
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    pressure : array of shape (case, time, z) or None
        p, dyn/cm²; None if the parameters have no pressure stages.
    wall_shear_stress : array of shape (case, time, z) or None
        τ, dyn/cm²; None if the equations do not give it.
    """

    flow: Array
    area: Array
    pressure: Array | None = None
    wall_shear_stress: Array | None = None
