"""Residuals of the closures on parts of the cases, which workers can hold.

A part returns, for residuals r and their Jacobian J, the triangle R of the QR decomposition
[J r] = Q·R, which has the same products: its columns take the place of J and r.  Triangles of
parts, one above the other, are decomposed once more: no part needs the values of another.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, ComplexArray
from pcnde_bridge._utils.workers import Parts, Worker
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.indices import values_at
from pcnde_bridge.data.stenosis import measuring_positions
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.shared_terms import rate
from pcnde_bridge.engines.types import ModelInputs, Problem

LARGEST_PART = 64
"""Largest number of cases whose values and Jacobian are in memory at once."""

_VALUES = 400
"""Number of cases times time points to which losses, wall and wall shear stress are fitted."""

_FEWEST_TIMES, _MOST_TIMES = 4, 25
"""Time points of a case: without memory, few are enough."""

_DROP_WEIGHT = 10.0
"""Weight of the drop across the stenosis, relative to the pressure at one point."""

_FLOW_POINTS = 5
"""Points, beside the inlet, on which the flow is compared: it is smooth along the vessel."""

_GOLDEN_RATIO = (1 + 5**0.5) / 2
"""Its multiples modulo 1 are spread evenly, whatever their number."""


@dataclass
class ClosurePart(ABC):
    """Residual of one closure on a range of cases.

    Attributes
    ----------
    closures, config, grid
        Equations of an engine, settings, and the grid of the cases.
    rows : slice
        The cases among all.
    target : array of shape (case, time, z)
        Reference values.
    area_undeformed : array of shape (case, z)
        S_u, cm².
    """

    closures: Closures
    config: ClosureConfig
    grid: Grid
    rows: slice
    target: Array
    area_undeformed: Array
    _prepared: tuple[bytes, Problem] | None = field(default=None, init=False)

    @abstractmethod
    def problem(self, others: ClosureParameters | None) -> Problem:
        """Prepare the closure's value and Jacobian."""

    def __call__(
        self, parameters: Array, weight: Array, others: ClosureParameters | None = None
    ) -> Array:
        """Return the triangle.

        Parameters
        ----------
        parameters : array of shape (n,)
            Parameters of the closure.
        weight : array of shape (case,)
            Factor of the residuals of all cases.
        others : ClosureParameters, optional
            Other closures that this one depends on.
        """
        key = b"".join(vector.tobytes() for _, vector in others or ())
        if self._prepared is None or self._prepared[0] != key:
            self._prepared = key, self.problem(others)
        value, jacobian = self._prepared[1](parameters)
        factor = weight[self.rows, None, None]
        error, jacobian = factor * (value - self.target), factor[..., None] * jacobian
        return triangle(*self.residuals(error, jacobian))

    def residuals(self, error: Array, jacobian: Array) -> tuple[Array, Array]:
        """Return the residuals and their Jacobian for those of the value."""
        return error, jacobian


@dataclass
class _Losses(ClosurePart):
    """p − p(L) with the reference flow, and the drop across the stenosis."""

    flow: Array
    flow_rate: Array

    def problem(self, others: ClosureParameters | None) -> Problem:
        del others
        fields = self.flow, self.flow_rate, self.area_undeformed
        return self.closures.losses(*fields, self.grid, self.config)

    @cached_property
    def drop(self) -> Array:
        """Weights of the points in the drop of each case, (case, z)."""
        z, count = self.grid.z, len(self.target)
        points = np.broadcast_to(np.eye(z.size), (count, z.size, z.size))
        proximal, distal = measuring_positions(z, self.area_undeformed)
        return values_at(points, z, proximal) - values_at(points, z, distal)

    def residuals(self, error: Array, jacobian: Array) -> tuple[Array, Array]:
        drop_error = _DROP_WEIGHT * np.einsum("ctz,cz->ct", error, self.drop)
        drop_jacobian = _DROP_WEIGHT * np.einsum("ctzn,cz->ctn", jacobian, self.drop)
        return (
            np.concatenate([error.ravel(), drop_error.ravel()]),
            np.concatenate([a.reshape(-1, a.shape[-1]) for a in (jacobian, drop_jacobian)]),
        )


@dataclass
class _Wall(ClosurePart):
    """S with the reference pressure."""

    pressure: Array

    def problem(self, others: ClosureParameters | None) -> Problem:
        del others
        return self.closures.area(self.pressure, self.area_undeformed, self.grid, self.config)


@dataclass
class _Flow(ClosurePart):
    """Q at some points, with all closures coupled."""

    inflow: Array
    points: npt.NDArray[np.int64]
    outlet: ComplexArray | None

    def problem(self, others: ClosureParameters | None) -> Problem:
        assert others is not None
        inputs = ModelInputs(self.inflow, self.area_undeformed, self.grid)
        return self.closures.flow(others, inputs, self.points, self.config, self.outlet)


@dataclass
class HeldCases:
    """Parts of all cases for one closure.

    Attributes
    ----------
    parts : Parts
        Parts, on the workers or in this process.
    square : array of shape (case,)
        Sum of the squared reference values of each case.
    """

    parts: Parts
    square: Array

    def problem(
        self, weight: Array, others: ClosureParameters | None = None, *more: Problem
    ) -> Problem:
        """Return a small problem with the sum of squares of all cases and of other terms."""

        def residual(x: Array) -> tuple[Array, Array]:
            triangles = [*self.parts(x, weight, others), *(triangle(*term(x)) for term in more)]
            total = np.asarray(np.linalg.qr(np.concatenate(triangles), mode="r"))
            return total[:, -1], total[:, :-1]

        return residual


def triangle(error: Array, jacobian: Array) -> Array:
    """Return the triangle of residuals and their Jacobian, (n + 1, n + 1)."""
    columns = jacobian.reshape(error.size, -1), error.reshape(-1, 1)
    return np.asarray(np.linalg.qr(np.concatenate(columns, axis=1), mode="r"))


def hold_cases(
    name: str,
    closures: Closures,
    cases: Cases,
    config: ClosureConfig,
    workers: Sequence[Worker] = (),
    outlet: ComplexArray | None = None,
) -> HeldCases:
    """Divide the cases among workers, for the fits of one closure.

    Parameters
    ----------
    name : str
        ``"losses"``, ``"wall"`` or ``"correction"``.
    closures, cases, config
        Equations of an engine, training cases and settings.
    workers : sequence of Worker
        Processes that hold the cases; none for this one.
    outlet : array of shape (case, 2, harmonic), optional
        Outlet of all cases, for the correction.
    """
    square = np.empty(len(cases))
    points = np.unique(np.linspace(0, cases.n_points - 1, _FLOW_POINTS + 1).astype(int)[1:])

    def part(rows: slice, of: Cases) -> ClosurePart:
        def common(target: Array) -> tuple[Closures, ClosureConfig, Grid, slice, Array, Array]:
            return closures, config, of.grid, rows, target, of.area_undeformed

        if name == "correction":
            at_end = None if outlet is None else outlet[rows]
            return _Flow(*common(of.flow[:, :, points]), of.inflow, points, at_end)
        times = few_times(len(cases), cases.n_times)[rows]
        pressure = at_times(of.pressure, times)
        if name == "wall":
            return _Wall(*common(at_times(of.area, times)), pressure)
        fields = at_times(of.flow, times), at_times(flow_rate(of), times)
        return _Losses(*common(pressure - pressure[..., -1:]), *fields)

    def parts() -> Iterator[ClosurePart]:
        for rows, of in cases.batches(LARGEST_PART):
            made = part(rows, of)
            square[rows] = (made.target**2).sum(axis=(1, 2))
            yield made

    return HeldCases(Parts(parts(), workers), square)


def few_times(count: int, n_times: int) -> npt.NDArray[np.int64]:
    """Return the time points of each case that a fit uses, (case, few).

    The points are equally spaced, and start at another phase in each case: together the cases
    show all phases of the cycle.
    """
    most = min(_MOST_TIMES, n_times)
    few = int(np.clip(_VALUES // count, min(_FEWEST_TIMES, most), most))
    phase = np.arange(count) * _GOLDEN_RATIO % 1
    return ((np.arange(few) + phase[:, None]) * (n_times / few)).astype(int)


def at_times(values: Array, times: npt.NDArray[np.int64]) -> Array:
    """Return values (case, time, …) at the time points of each case."""
    index = times.reshape(*times.shape, *(1,) * (values.ndim - 2))
    return np.asarray(np.take_along_axis(values, index, axis=1))


def flow_rate(cases: Cases) -> Array:
    """Return ∂Q/∂t, mL/s², of shape (case, time, z)."""
    return np.moveaxis(rate(np.moveaxis(cases.flow, 1, -1), cases.period), -1, 1)
