"""What a computing engine is: stages, each of which can solve, judge and fit.

Everything that crosses this border is a plain float64 array in (case, time, z)
order or a flat parameter vector (see :mod:`pcnde_bridge.engines.parameters`).  The
training loop and the model know nothing else about an engine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.parameters import Parameters

if TYPE_CHECKING:
    from pcnde_bridge.engines.closure_protocol import Closures


@dataclass(frozen=True)
class FlowInputs:
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


@dataclass(frozen=True)
class TemporalFlowInputs:
    """Inputs of the momentum equation in time.

    Attributes
    ----------
    inflow : array of shape (case, time)
        Q(z=0, t), mL/s; linear in time between the instants.
    initial_flow : array of shape (case, z)
        Q at the first instant, mL/s.
    """

    inflow: Array
    initial_flow: Array


@dataclass(frozen=True)
class IntermediateAreaInputs:
    """Inputs of the continuity equation.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s, periodic and linear in time between the instants.
    area_undeformed : array of shape (case, z)
        S_u, cm², the initial condition.
    """

    flow: Array
    area_undeformed: Array


@dataclass(frozen=True)
class FourierAreaInputs:
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


@dataclass(frozen=True)
class TemporalPressureInputs:
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


@dataclass(frozen=True)
class SpatialPressureInputs:
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


@dataclass(frozen=True)
class Fit:
    """Result of one run of the optimizer.

    Attributes
    ----------
    parameters : array of shape (size,)
        The last accepted iterate.
    losses : array of shape (iterations + 1,)
        Loss at the start and after each iteration.
    converged : bool
        Whether the gradient tolerance ended the run before its last iteration.
    message : str
        Why it ended.
    """

    parameters: Array
    losses: Array
    converged: bool
    message: str


class Solution(NamedTuple):
    """What a whole model predicts.

    Attributes
    ----------
    flow, area : array of shape (case, time, z)
        Q, mL/s, and S, cm².
    pressure : array of shape (case, time, z) or None
        p, dyn/cm²; None if the parameters have no pressure stages.
    """

    flow: Array
    area: Array
    pressure: Array | None


OnIteration = Callable[[int, float], None]
"""Called with the iteration's number, from 1, and its loss; it may raise to stop."""

Objective = Callable[[Array], tuple[float, Array]]
"""Loss and gradient at a parameter vector; the loss is infinite where the equation diverges."""

OnAccepted = Callable[[Array, float], None]
"""Called with each iterate, which is its own, and its loss; StopIteration ends the fit."""

LBFGS = Callable[[Objective, Array, int, int, OnAccepted], None]
"""See :meth:`Engine.lbfgs`."""

InputsT = TypeVar("InputsT", contravariant=True)


class Stage(Protocol[InputsT]):
    """One stage of the method, as an engine offers it."""

    def solve(self, parameters: Array, inputs: InputsT, grid: Grid, config: PCNDEConfig) -> Array:
        """Evaluate the stage for every case on its own.

        A case's result does not depend on the cases beside it.

        Returns
        -------
        array of shape (case, time, z)
            Flow, area, or pressure over p_ref; the intermediate area has
            ``cycles`` times as many instants.

        Raises
        ------
        SolveError
            If the equation cannot be integrated to the end.
        """
        ...

    def loss_and_gradient(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> tuple[float, Array]:
        """Squared error against ``target`` (case, time, z), and its gradient.

        The flow stage controls its step by the error of all cases together.
        The loss is infinite where the equation cannot be integrated.
        """
        ...

    def losses(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """Squared error of :meth:`loss_and_gradient` at many parameter vectors at once.

        Parameters
        ----------
        parameters : array of shape (vector, size)
            One parameter vector in each row.

        Returns
        -------
        array of shape (vector,)
            Infinite where the equation cannot be integrated.
        """
        ...

    def objective(
        self, inputs: InputsT, target: Array, weight: Array, grid: Grid, config: PCNDEConfig
    ) -> Objective:
        """Make :meth:`loss_and_gradient` ready for many evaluations.

        Parameters
        ----------
        inputs, target, grid, config
            As of :meth:`loss_and_gradient`.
        weight : array of shape (case,)
            Of each case's squares; a case of weight 0 does not count.

        Returns
        -------
        callable
            Of the parameters: loss and gradient.
        """
        ...

    def fit(
        self,
        parameters: Array,
        inputs: InputsT,
        target: Array,
        grid: Grid,
        config: PCNDEConfig,
        iterations: int,
        on_iteration: OnIteration | None = None,
    ) -> Fit:
        """Minimise :meth:`loss_and_gradient` by BFGS.

        Parameters
        ----------
        parameters : array of shape (size,)
            Where to start.
        inputs, target, grid, config
            As of :meth:`loss_and_gradient`.
        iterations : int
            At most so many.
        on_iteration : callable, optional
            Called with the number and loss of each iteration; may raise to stop.

        Returns
        -------
        Fit
            Parameters, losses, and whether it converged.

        Raises
        ------
        SolveError
            If the loss is not finite at the start.
        """
        ...


class Engine(Protocol):
    """A computing engine: the stages, and the five of the paper in their order.

    It can be pickled: another process starts its own.

    Attributes
    ----------
    name : str
        ``"julia"`` or ``"jax"``.
    versions : mapping of str to str
        What computes: packages and their versions.
    closures : Closures
        What the ``physics`` preset needs.
    flow, intermediate_area, fourier_area, temporal_pressure, spatial_pressure
        The five stages of the paper.
    temporal_flow
        The momentum equation in time, in the place of ``flow``.
    """

    name: str

    @property
    def versions(self) -> Mapping[str, str]:
        """What computes."""
        ...

    @property
    def flow(self) -> Stage[FlowInputs]:
        """Momentum equation."""
        ...

    @property
    def intermediate_area(self) -> Stage[IntermediateAreaInputs]:
        """Continuity equation over some cycles."""
        ...

    @property
    def fourier_area(self) -> Stage[FourierAreaInputs]:
        """Periodic continuity equation."""
        ...

    @property
    def temporal_pressure(self) -> Stage[TemporalPressureInputs]:
        """Pressure network."""
        ...

    @property
    def spatial_pressure(self) -> Stage[SpatialPressureInputs]:
        """Pressure drop along the vessel."""
        ...

    @property
    def temporal_flow(self) -> Stage[TemporalFlowInputs]:
        """Momentum equation in time."""
        ...

    @property
    def closures(self) -> Closures:
        """What the ``physics`` preset needs."""
        ...

    def lbfgs(
        self, objective: Objective, start: Array, memory: int, iterations: int, after: OnAccepted
    ) -> None:
        """Minimise a function by L-BFGS without restarts, until its loss falls no more.

        Parameters
        ----------
        objective : callable
            Loss, always finite, and gradient.
        start : array of shape (n,)
            First iterate; the first trial step from it has length one.
        memory : int
            Pairs of steps and gradient changes that are kept.
        iterations : int
            At most so many.
        after : callable
            Called with each accepted iterate and its loss; what it raises ends the fit
            and, but for StopIteration, is raised on.
        """
        ...

    def predict(
        self,
        parameters: Parameters,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        config: PCNDEConfig,
    ) -> Solution:
        """Run all coupling passes and the pressure stages, every case on its own.

        The same as :func:`pcnde_bridge.engines.staged.predict_by_stages`, which an
        engine may simply call, or do quicker.

        Parameters
        ----------
        parameters : Parameters
            Of a trained model.
        inflow : array of shape (case, time)
            Q_in, mL/s.
        area_undeformed : array of shape (case, z)
            S_u, cm².

        Raises
        ------
        SolveError
            If the momentum equation cannot be integrated to the end.
        """
        ...
