"""Baselines that a model must beat.

* :class:`Unchanged`: no change along the vessel.
* :class:`Solver1D`: the 1D solver with a fitted outlet resistance.
* :class:`ResponseSurface`: polynomials in principal components of the inputs.
* :class:`StenosisLoss`: no change but a published pressure loss across the stenosis.
* :class:`DropRegression`: a fitted, quasi-steady pressure drop across the stenosis.

Units are CGS; arrays are (case, time, z).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from math import ceil
from typing import Protocol, Self, TypeVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid, check_grid
from pcnde_bridge.data.indices import poiseuille_wall_shear_stress, pressure_drop
from pcnde_bridge.data.stenosis import areas_at_throats, check_length, measuring_positions, throats
from pcnde_bridge.engines.shared_terms import rate as rate_of
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics import pressure_losses
from pcnde_bridge.hemodynamics.outlet import Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.tube_laws import PAPER_REFERENCE_PRESSURE, LinearWall

_Fitted = TypeVar("_Fitted")

_DENSITY, _VISCOSITY = 1.06, 0.04  # blood of the paper, g/cm³ and poise
_ARTERY = LinearWall()
FEM_WALL = LinearWall(0.75 * 1.5e7, reference_pressure=PAPER_REFERENCE_PRESSURE)
"""Wall of the paper's column "1D FEM", as far as it can be inferred.

The linear wall of svOneDSolver takes 4/3·E·h/r₀ as one number.  With the paper's E·h/r₀
in its place, which is three quarters of Young's modulus, the 1D solver here gives 0.0208,
0.0491 and 0.0360 for the column's 0.0204, 0.0498 and 0.0365; with the wall as the paper
prints it, 0.0351, 0.0502 and 0.0607.
"""

Loss = Callable[[Cases, float], Array]
"""Pressure drop of each case, dyn/cm², (case, time), from its inflow, S_u and the length L_s."""


class Baseline(Protocol):
    """Method that is fitted on cases and predicts others from their inputs."""

    def fit(self, train: Cases) -> Baseline:
        """Fit the method on training cases, and return it.

        Raises
        ------
        InputError
            If the method is not applicable to the cases.
        """
        ...

    def predict(self, cases: Cases) -> dict[str, Array]:
        """Predict cases from their inflow and undeformed area alone.

        Returns
        -------
        dict of str to array of shape (case, time, z)
            ``flow`` (mL/s), ``area`` (cm²), ``pressure`` and, if the method gives it,
            ``wall_shear_stress`` (dyn/cm²).

        Raises
        ------
        InputError
            If the method has not been fitted, or is not applicable to the cases.
        """
        ...


class _WithOutlet:
    """Baseline whose only fitted parameter is the resistance of the outlet."""

    _resistance: float | None = None

    def fit(self, train: Cases) -> Self:
        """Fit the resistance by least squares on the outlets; see :class:`Baseline`."""
        self._resistance = outlet_resistance(train)
        return self


class Unchanged(_WithOutlet):
    """No change along the vessel: Q = Q_in, S = S_u and p = R·Q_in.

    The resistance R of the outlet is fitted on the training cases by least squares.  The wall
    shear stress is Poiseuille's, 4·μ·Q/(π·r³).
    """

    def predict(self, cases: Cases) -> dict[str, Array]:
        """Predict the inflow and the undeformed area; see :class:`Baseline`."""
        resistance = _fitted(self._resistance)
        flow = np.repeat(cases.inflow[:, :, None], cases.n_points, axis=2)
        area = np.repeat(cases.area_undeformed[:, None, :], cases.n_times, axis=1)
        stress = poiseuille_wall_shear_stress(flow, area)
        found = {"flow": flow, "area": area, "pressure": resistance * flow}
        return found | {"wall_shear_stress": stress}


@dataclass(eq=False)
class Solver1D(_WithOutlet):
    """One-dimensional solver with a resistance outlet that is fitted on the training cases.

    Parameters
    ----------
    wall : LinearWall
        Tube law.  By default the paper's artery, undeformed at zero pressure, as in the
        data.  ``LinearWall(reference_pressure=PAPER_REFERENCE_PRESSURE)`` is the law as
        the paper prints it, :data:`FEM_WALL` that of its column "1D FEM".
    stenosis_length : float
        Length L_s of the stenosis in the pressure drop, cm.  The points must be at most a
        quarter of it apart.  The throat is located by
        :meth:`~pcnde_bridge.hemodynamics.solver.Tube1D.solve_like`.
    """

    wall: LinearWall = _ARTERY
    stenosis_length: float = 0.5

    def predict(self, cases: Cases) -> dict[str, Array]:
        """Solve all cases in one batch; see :class:`Baseline`.

        Raises
        ------
        InputError
            If the baseline has not been fitted, or the solver is not applicable: points
            must be equally spaced and the cycle must start at 0.
        SolveError
            If a case diverges.
        """
        outlet = Windkessel(_fitted(self._resistance))
        # As many steps per cycle as the solver's default, a multiple of the time points.
        steps = cases.n_times * max(5, ceil(Tube1D.steps / cases.n_times))
        tube = Tube1D(wall=self.wall, n_times=cases.n_times, steps=steps)
        solved = tube.solve_like(cases, outlet, stenosis_length=self.stenosis_length)
        return solved.variables()


def seeley_young(cases: Cases, length: float) -> Array:
    """Return the drop of Seeley and Young (1976) as the paper prints it; see :data:`Loss`."""
    check_length(cases.z, cases.area_undeformed, length)
    return np.asarray(pressure_losses.pressure_drop(cases.inflow, *_areas(cases), length))


def young_tsai(cases: Cases, length: float) -> Array:
    """Return the drop of Young and Tsai (1973); see :data:`Loss`."""
    check_length(cases.z, cases.area_undeformed, length)
    rate = rate_of(cases.inflow, cases.period)
    drop = pressure_losses.unsteady_pressure_drop(cases.inflow, rate, *_areas(cases), length)
    return np.asarray(drop)


def mirramezani(cases: Cases, length: float) -> Array:
    """Return the drop of Mirramezani et al. (2019), without L_s; see :data:`Loss`."""
    resistance, _ = _elements(cases)
    drop = pressure_losses.profile_pressure_drop(cases.inflow, resistance, *_areas(cases))
    return np.asarray(drop)


def itu(cases: Cases, length: float) -> Array:
    """Return the drop of Itu et al. (2013), without L_s; see :data:`Loss`."""
    flow, rate = cases.inflow, rate_of(cases.inflow, cases.period)
    healthy, throat = _areas(cases)
    womersley = np.sqrt(2 * healthy * _DENSITY / (_VISCOSITY * cases.period))
    drop = pressure_losses.unsteady_profile_pressure_drop(
        flow, rate, flow.mean(axis=1, keepdims=True), *_elements(cases), healthy, throat, womersley
    )
    return np.asarray(drop)


@dataclass(eq=False)
class StenosisLoss(Unchanged):
    """No change along the vessel but a pressure loss across its narrowest stenosis.

    The loss is added to the pressure from the inlet to the throat (see
    :func:`pcnde_bridge.data.stenosis.throats`); the flow is the inflow.

    Parameters
    ----------
    loss : callable
        Function of cases and L_s (cm), which returns the drop, dyn/cm², of shape (case, time):
        :func:`seeley_young` by default, :func:`young_tsai`, :func:`mirramezani`, :func:`itu`
        or your own.
    stenosis_length : float
        Length L_s of the stenosis, cm.
    """

    loss: Loss = seeley_young
    stenosis_length: float = 0.5

    def predict(self, cases: Cases) -> dict[str, Array]:
        """Predict the inflow, the undeformed area and the loss; see :class:`Baseline`."""
        found = super().predict(cases)
        drop = self.loss(cases, self.stenosis_length)
        return found | {"pressure": found["pressure"] + _upstream(drop, cases)}


@dataclass(eq=False)
class ResponseSurface:
    """Polynomial for each value on the grid, in principal components of the inputs.

    The inputs are the inflow waveform and the undeformed area.  Each is described by the
    scores of its principal components (SVD of the training cases).  The variables of the
    training cases at each time point and point are polynomials in the scores, fitted by
    least squares.

    Parameters
    ----------
    waveform_degree, geometry_degree : int
        Total degree in the scores of the waveform and of the area; the terms are all
        products of a term of one with a term of the other.
    waveform_components, geometry_components : int, optional
        Number of scores of each input; by default as many as explain 99 % of the variance
        of the training cases.  The published data need one of each.

    Raises
    ------
    InputError
        If a number is negative.
    """

    waveform_degree: int = 3
    geometry_degree: int = 3
    waveform_components: int | None = None
    geometry_components: int | None = None
    _axes: tuple[_Axis, _Axis] | None = field(default=None, init=False, repr=False)
    _grid: Grid | None = field(default=None, init=False, repr=False)
    _coefficients: dict[str, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for axis in ("waveform", "geometry"):
            whole(f"{axis}_degree", getattr(self, f"{axis}_degree"))
            whole(f"{axis}_components", getattr(self, f"{axis}_components") or 0)

    def fit(self, train: Cases) -> ResponseSurface:
        """Fit all coefficients; see :class:`Baseline`.

        Raises
        ------
        InputError
            If there are fewer cases than coefficients, or too few different waveforms or
            geometries for the degree.
        """
        axes = (
            _Axis("inflow", train, self.waveform_degree, self.waveform_components),
            _Axis("area_undeformed", train, self.geometry_degree, self.geometry_components),
        )
        features = _products(axes, train)
        rank, n_terms = np.linalg.matrix_rank(features), features.shape[1]
        if rank < n_terms:
            waveforms, geometries = (
                len(np.unique(array, axis=0)) for array in (train.inflow, train.area_undeformed)
            )
            raise InputError(
                f"This polynomial has {n_terms} coefficients, but the {len(train)} training cases "
                f"({waveforms} different waveforms, {geometries} different geometries) suffice for "
                f"{rank} only: use smaller degrees, fewer components or more cases."
            )
        inverse = np.linalg.pinv(features)
        self._axes, self._grid = axes, train.grid
        self._coefficients = {
            name: np.tensordot(inverse, values, axes=1)
            for name, values in train.variables().items()
        }
        return self

    def predict(self, cases: Cases) -> dict[str, Array]:
        """Evaluate the polynomials; see :class:`Baseline`.

        Raises
        ------
        InputError
            If the baseline has not been fitted, or the cases have another grid.
        """
        axes = _fitted(self._axes)
        check_grid(_fitted(self._grid), cases.grid, "train")
        features = _products(axes, cases)
        return {
            name: np.tensordot(features, values, axes=1)
            for name, values in self._coefficients.items()
        }


@dataclass(eq=False)
class DropRegression:
    """Quasi-steady pressure drop across the stenosis, fitted on the training cases.

    The drop is a linear combination of Q, Q·|Q|^½, Q·|Q| and ∂Q/∂t at the throat, each times
    the powers 0 … ``degree`` of the area ratio S_D/S_s.  The power 3/2 is that of a developing
    boundary layer.  The coefficients are fitted by least squares to the training cases' drop
    (:meth:`pcnde_bridge.Cases.pressure_drop`) with their flow at the throat.  Another
    baseline predicts flow and area; its pressure upstream of the throat is shifted so that it
    has the drop of the regression.

    Parameters
    ----------
    degree : int
        Largest power of the area ratio.
    base : Baseline, optional
        The other baseline; by default :class:`ResponseSurface`.

    Raises
    ------
    InputError
        If the degree is not a whole number of 0 or more.
    """

    degree: int = 3
    base: Baseline = field(default_factory=ResponseSurface)
    _coefficients: Array | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        whole("degree", self.degree)

    def fit(self, train: Cases) -> DropRegression:
        """Fit the other baseline and the coefficients of the drop; see :class:`Baseline`.

        Raises
        ------
        InputError
            If the training cases have too few different geometries or waveforms.
        """
        self.base.fit(train)
        features = self._features(train.flow, train)
        rows = features.reshape(-1, features.shape[-1])
        size = np.maximum(np.abs(rows).max(axis=0), np.finfo(float).tiny)
        if np.linalg.matrix_rank(rows / size) < rows.shape[1]:
            raise InputError(
                f"The training cases have too few different geometries or waveforms for "
                f"{rows.shape[1]} coefficients of the pressure drop; use a smaller degree."
            )
        drop = train.pressure_drop().ravel()
        self._coefficients = np.linalg.lstsq(rows / size, drop, rcond=None)[0] / size
        return self

    def predict(self, cases: Cases) -> dict[str, Array]:
        """Predict with the other baseline, then correct the drop; see :class:`Baseline`."""
        coefficients = _fitted(self._coefficients)
        found = self.base.predict(cases)
        ends = measuring_positions(cases.z, cases.area_undeformed)
        missing = self._features(found["flow"], cases) @ coefficients
        missing -= pressure_drop(found["pressure"], cases.z, *ends)
        return found | {"pressure": found["pressure"] + _upstream(missing, cases)}

    def _features(self, flow: Array, cases: Cases) -> Array:
        """Return the terms of the regression, (case, time, term)."""
        points, _ = throats(cases.z, cases.area_undeformed)
        flow = flow[np.arange(len(cases)), :, points]
        healthy, throat = _areas(cases)
        rate = rate_of(flow, cases.period)
        terms = np.stack([flow, flow * abs(flow) ** 0.5, flow * abs(flow), rate], axis=-1)
        powers = (healthy / throat)[..., None, None] ** np.arange(self.degree + 1)
        return (terms[..., None] * powers).reshape(*flow.shape, -1)


def _areas(cases: Cases) -> tuple[Array, Array]:
    """Return the healthy area S_D at the throat and the throat's S_s, cm², each (case, 1)."""
    healthy, throat = areas_at_throats(cases.z, cases.area_undeformed)
    return healthy[:, None], throat[:, None]


def _elements(cases: Cases) -> tuple[Array, Array]:
    """Return R = 8πμ·∫dz/S_u² and L = ρ·∫dz/S_u of the measured section, each (case, 1).

    Units are dyn·s/cm⁵ and dyn·s²/cm⁵; see
    :func:`pcnde_bridge.data.stenosis.measuring_positions`.
    """
    from scipy.integrate import cumulative_trapezoid

    positions = np.stack(measuring_positions(cases.z, cases.area_undeformed), axis=1)

    def integral(values: Array) -> Array:
        total = cumulative_trapezoid(values, cases.z, initial=0)
        pairs = zip(positions, total, strict=True)
        return np.array([np.diff(np.interp(ends, cases.z, along)) for ends, along in pairs])

    area = cases.area_undeformed
    return 8 * np.pi * _VISCOSITY * integral(area**-2), _DENSITY * integral(1 / area)


def _upstream(drop: Array, cases: Cases) -> Array:
    """Return a drop (case, time) up to the throat and 0 behind it, (case, time, z)."""
    points, _ = throats(cases.z, cases.area_undeformed)
    upstream = np.arange(cases.n_points) <= points[:, None]
    return np.asarray(drop[:, :, None] * upstream[:, None, :])


class _Axis:
    """Principal components of one input, and polynomial terms in their scores."""

    def __init__(self, name: str, train: Cases, degree: int, components: int | None) -> None:
        self._name, values = name, getattr(train, name)
        self._mean = values.mean(axis=0)
        _, sizes, directions = np.linalg.svd(values - self._mean, full_matrices=False)
        # Differences within round-off do not count.
        varies = int(np.count_nonzero(sizes > 1e-10 * np.linalg.norm(values)))
        if components is None:
            explained = np.cumsum(sizes[:varies] ** 2) / np.sum(sizes[:varies] ** 2)
            components = int(np.searchsorted(explained, 0.99)) + 1 if varies else 0
        self._directions = directions[: min(components, varies)]
        scores = (values - self._mean) @ self._directions.T
        # Scores of about 1 keep the least squares well conditioned.
        self._size = np.abs(scores).max(axis=0)
        self._degree = degree

    def features(self, cases: Cases) -> Array:
        """Return all monomials of the scores up to the total degree, (case, term)."""
        scores = (getattr(cases, self._name) - self._mean) @ self._directions.T / self._size
        columns = [
            np.prod(scores[:, list(which)], axis=1)
            for degree in range(self._degree + 1)
            for which in combinations_with_replacement(range(scores.shape[1]), degree)
        ]
        return np.stack(columns, axis=1)


def _products(axes: tuple[_Axis, _Axis], cases: Cases) -> Array:
    """Return each term of one axis times each term of the other, (case, terms)."""
    first, second = (axis.features(cases) for axis in axes)
    return (first[:, :, None] * second[:, None, :]).reshape(len(first), -1)


def _fitted(value: _Fitted | None) -> _Fitted:
    if value is None:
        raise InputError("The baseline has not been fitted; call fit(train) first.")
    return value


def standard_baselines() -> dict[str, Baseline]:
    """Return the baselines of ``pcnde bench`` by name, unfitted and with default settings.

    They are :class:`Unchanged`; :class:`Solver1D` undeformed at zero pressure, undeformed at
    the paper's reference pressure of 100 mmHg, and with :data:`FEM_WALL`;
    :class:`ResponseSurface` of degrees 3 and 3; :class:`StenosisLoss` with the drops of Seeley
    and Young, Young and Tsai, Mirramezani et al. and Itu et al.; and :class:`DropRegression`.
    """
    return {
        "no change": Unchanged(),
        "1D solver": Solver1D(),
        "1D, 100 mmHg": Solver1D(LinearWall(reference_pressure=PAPER_REFERENCE_PRESSURE)),
        "1D, as paper": Solver1D(FEM_WALL),
        "polynomial": ResponseSurface(),
        "Seeley-Young": StenosisLoss(),
        "Young-Tsai": StenosisLoss(young_tsai),
        "Mirramezani": StenosisLoss(mirramezani),
        "Itu": StenosisLoss(itu),
        "drop regression": DropRegression(),
    }
