"""One-dimensional blood flow in an elastic vessel: the paper's section 2.1.

Equations, for flow Q(z, t), area S(z, t) and pressure p(S) from a wall law:

    ∂S/∂t = −∂Q/∂z
    ∂Q/∂t = −(1 + δ) ∂(Q²/S)/∂z − S/ρ ∂p/∂z + N Q/S + ν ∂²Q/∂z²

with δ = 1/(1 + ζ) and N = −2πν(ζ + 2) for the velocity profile 1 − (r/R)^ζ
(Hughes and Lubliner 1973); the parabola ζ = 2 gives the paper's 1/3 and −8πν.
Inlet: Q = Q_in(t).  Outlet: a resistance or three-element Windkessel.

**Space.**  Finite volumes on a staggered grid (Harlow and Welch 1965): areas in
cells, flows on their faces, so that the inlet flow sits on the inlet and volume is
conserved to round-off.  The area on a face is the harmonic mean of its cells: the
convective and pressure terms of a steady flow then sum to −(1 + δ)·ρ/2·Δ(Q²/S²)
exactly, and the grid adds no loss of its own in a stenosis.  Second order.

**Time.**  TR-BDF2 (Bank et al. 1985; Hosea and Shampine 1996): the trapezoidal rule
to t + (2 − √2)·Δt, then the second-order backward difference, both implicit in all
terms.  Second order, and L-stable: pressure waves of 1500–2000 cm/s cross a cell in
some 20 µs, and the step may be a hundred times longer; waves that it does not resolve are
damped, not amplified.  There is no CFL condition: an explicit scheme would need
Δt < Δz/c, here the step need only resolve the inlet's harmonics.  Continuity is
linear, so each stage's areas are eliminated, and Newton's method solves a
tridiagonal system in the flows alone.

**Accuracy.**  With the default 101 points and 500 steps, the paper's vessels and
waveforms are computed to 1e-5 of the flow and 1e-3 of the pressure.

**Batches.**  All cases of a batch advance together in one program compiled by JAX
(float64).  Units are CGS throughout.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge._utils.validation import (
    finite,
    positive,
    whole,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.discretisation import (
    Problem,
    check,
    check_vessels,
    fits,
    upstream_area,
)
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.tr_bdf2 import run
from pcnde_bridge.hemodynamics.tube_laws import LinearWall, OlufsenWall
from pcnde_bridge.hemodynamics.waveform import Waveform

if TYPE_CHECKING:
    import pandas as pd

StenosisLoss = Literal["none", "paper", "effective_length"]

_log = logging.getLogger(__name__)

_NOT_PERIODIC = 1e-3


@dataclass(frozen=True)
class Windkessel:
    """Outlet: a resistance, or three elements, in front of a distal pressure.

    p = R·Q + p_c,  C·dp_c/dt = Q − (p_c − p_d)/R_d.  Without R_d this is the
    resistance outlet p = R·Q + p_d.

    Attributes
    ----------
    resistance : float or array_like, shape (n_cases,)
        R, dyn·s/cm⁵; the proximal one of three elements.
    distal_resistance : float or array_like, shape (n_cases,)
        R_d, dyn·s/cm⁵.
    capacitance : float or array_like, shape (n_cases,)
        C, cm⁵/dyn.
    distal_pressure : float or array_like, shape (n_cases,)
        p_d, dyn/cm².
    """

    resistance: npt.ArrayLike
    distal_resistance: npt.ArrayLike = 0.0
    capacitance: npt.ArrayLike = 0.0
    distal_pressure: npt.ArrayLike = 0.0


@dataclass(frozen=True)
class Tube1D:
    """The one-dimensional solver and its settings.

    Attributes
    ----------
    wall : LinearWall or OlufsenWall
        The wall law; the paper's artery, undeformed at zero pressure.
    stenosis_loss : {'paper', 'effective_length', 'none'}
        Seeley–Young pressure drop in each stenosis, spread over its length as the
        narrowing is, where it replaces the wall friction.  ``'paper'`` puts L_s into K_v,
        ``'effective_length'`` 0.83·L_s + 1.64·D_s.  The areas are the undeformed
        ones, and the drop is scaled by (S_u/S)², as both of its parts are when the
        vessel widens.  Its viscous part, Poiseuille's for the parabola, is scaled by
        (ζ + 2)/4, as the wall friction is.
    turbulent_coefficient : float
        K_t of that drop.
    density, viscosity : float
        ρ (g/cm³) and μ (poise).
    profile_exponent : float
        ζ of the velocity profile; 2 is the parabola.
    n_times : int
        Instants recorded per cycle.
    steps : int
        Time steps per cycle, a multiple of ``n_times``.
    cycles : int
        Cycles computed from rest; the last one is returned.

    Raises
    ------
    InputError
        If a setting is not usable.

    Examples
    --------
    >>> from pcnde_bridge.hemodynamics.solver import Tube1D, Windkessel
    >>> from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
    >>> from pcnde_bridge.hemodynamics.waveform import coronary
    >>> vessels = [Vessel(), Vessel((Stenosis(0.7),))]
    >>> cases = Tube1D().simulate(vessels, [coronary()] * 2, Windkessel(1e5))  # doctest: +SKIP
    """

    wall: LinearWall | OlufsenWall = field(default_factory=LinearWall)
    stenosis_loss: StenosisLoss = "paper"
    turbulent_coefficient: float = 1.52
    density: float = 1.06
    viscosity: float = 0.04
    profile_exponent: float = 2.0
    n_times: int = 100
    steps: int = 500
    cycles: int = 3

    def __post_init__(self) -> None:
        if not isinstance(self.wall, LinearWall | OlufsenWall):
            raise InputError(f"Tube1D.wall must be a wall law, got {self.wall!r}.")
        if self.stenosis_loss not in ("none", "paper", "effective_length"):
            raise InputError(
                "Tube1D.stenosis_loss must be 'none', 'paper' or 'effective_length', "
                f"got {self.stenosis_loss!r}."
            )
        for name, unit in (("density", "g/cm³"), ("viscosity", "poise"), ("profile_exponent", "")):
            value = positive(f"Tube1D.{name}", getattr(self, name), unit)
            object.__setattr__(self, name, value)
        coefficient = finite("Tube1D.turbulent_coefficient", self.turbulent_coefficient)
        object.__setattr__(self, "turbulent_coefficient", coefficient)
        if coefficient < 0.0:
            raise InputError(
                "Tube1D.turbulent_coefficient must not be negative, "
                f"got {self.turbulent_coefficient!r}."
            )
        for name, least in (("n_times", 4), ("steps", 1), ("cycles", 1)):
            number = whole(f"Tube1D.{name}", getattr(self, name), least)
            object.__setattr__(self, name, number)
        if self.steps % self.n_times:
            raise InputError(
                f"Tube1D.steps = {self.steps} is not a multiple of n_times = {self.n_times}, "
                "so that the instants recorded would fall between steps."
            )

    @property
    def kinematic_viscosity(self) -> float:
        """ν = μ/ρ, cm²/s."""
        return self.viscosity / self.density

    @property
    def delta(self) -> float:
        """δ of the momentum equation."""
        return 1.0 / (1.0 + self.profile_exponent)

    @property
    def friction(self) -> float:
        """N of the momentum equation, cm²/s."""
        return -2.0 * math.pi * self.kinematic_viscosity * (self.profile_exponent + 2.0)

    @property
    def friction_ratio(self) -> float:
        """Friction over that of the parabola, (ζ + 2)/4."""
        return (self.profile_exponent + 2.0) / 4.0

    def simulate(
        self,
        vessels: Sequence[Vessel],
        waveforms: Sequence[Waveform],
        outlet: Windkessel,
        *,
        n_points: int = 101,
        initial_pressure: float | None = None,
        labels: pd.DataFrame | Mapping[str, Any] | None = None,
    ) -> Cases:
        """Solve idealised vessels, each with its waveform.

        Parameters
        ----------
        vessels : sequence of Vessel, n_cases
            All of the same length.
        waveforms : sequence of Waveform, n_cases
            All of the same period.
        outlet, initial_pressure, labels
            See :meth:`solve`; the label ``blockage`` is the vessel's by default, and
            without labels a pair of vessel and waveform that comes again, at another
            outlet, is another geometry.
        n_points : int
            Points along the vessel.

        Returns
        -------
        Cases
            See :meth:`solve`.

        Raises
        ------
        InputError
            If the input is not usable; nothing has been computed then.
        SolveError
            If a case diverges.
        """
        return self._run(
            check_vessels(self, vessels, waveforms, outlet, n_points, initial_pressure, labels)
        )

    def solve(
        self,
        z: npt.ArrayLike,
        area_undeformed: npt.ArrayLike,
        waveforms: Sequence[Waveform],
        outlet: Windkessel,
        *,
        stenoses: Sequence[Sequence[Stenosis]] | None = None,
        initial_pressure: float | None = None,
        labels: pd.DataFrame | Mapping[str, Any] | None = None,
    ) -> Cases:
        """Solve vessels given by their undeformed area.

        Every case starts from rest (Q = 0).  Periodicity and volume balance of
        each case are logged and returned as labels.  A slow outlet, or a soft wall,
        needs many cycles to fill, unless ``initial_pressure`` is near the mean.

        Parameters
        ----------
        z : array_like, shape (n_points,)
            Equally spaced points from the inlet to the outlet, cm.
        area_undeformed : array_like, shape (n_cases, n_points)
            S_u, cm².
        waveforms : sequence of Waveform, n_cases
            Inlet flows, all of the same period.
        outlet : Windkessel
            Common to all cases, or with one value per case.
        stenoses : sequence of sequences of Stenosis, n_cases
            Where the Seeley–Young drop acts; none by default.  Position, length and
            blockage are used; S_D is S_u at the last point before it.
        initial_pressure : float, optional
            Pressure at rest, in the vessel and in the Windkessel's capacitor,
            dyn/cm².  By default the wall's reference pressure, so that S = S_u.
        labels : DataFrame or mapping, optional
            See :class:`~pcnde_bridge.data.cases.Cases`.

        Returns
        -------
        Cases
            The last cycle, ``n_times`` instants from t = 0 and the points z, with
            two more labels: ``periodicity``, the largest of the relative changes
            ‖last − previous cycle‖/‖last cycle‖ of flow, area and pressure, over
            1 − exp(−T/τ) (NaN with one cycle), and ``volume_balance``, the change of
            volume in the last cycle less what flowed in and out, over the volume.
            With τ = R_d·C + (R + R_d)·∫dS/dp dz, in which Windkessel and vessel
            fill, ``periodicity`` is how far the cycles still are from the periodic one.

        Raises
        ------
        InputError
            If the input is not usable; nothing has been computed then.
        SolveError
            If a case diverges; names the case, the time and the place.
        """
        return self._run(
            check(self, z, area_undeformed, waveforms, outlet, stenoses, initial_pressure, labels)
        )

    def _run(self, problem: Problem) -> Cases:
        with double_precision():
            last, previous, volume_balance = run(self, problem)
        periodicity = _periodicity(last, previous) / self._settling(problem, last)
        _report(periodicity, volume_balance)
        flow, area, pressure = last
        table = problem.labels.assign(periodicity=periodicity, volume_balance=volume_balance)
        return Cases(
            flow,
            area,
            pressure,
            problem.area_undeformed,
            np.arange(self.n_times) * (problem.period / self.n_times),
            problem.z,
            period=problem.period,
            labels=table,
        )

    def _settling(self, problem: Problem, last: list[Array]) -> Array:
        """Share of its distance to the periodic state that a cycle covers, (case,)."""
        proximal, distal, delay, _ = problem.outlet
        area_undeformed = problem.area_undeformed
        slope = self.wall.pressure_slope(last[1].mean(axis=1), area_undeformed)
        compliance = (1.0 / slope).mean(axis=1) * (problem.z[-1] - problem.z[0])
        # The sum of both times is an upper bound of the slower of two that are coupled.
        slowest = delay + (proximal + distal) * compliance
        with np.errstate(divide="ignore"):
            share: Array = -np.expm1(-problem.period / slowest)
        return share

    def solve_like(
        self,
        cases: Cases,
        outlet: Windkessel | None = None,
        *,
        stenosis_length: float = 0.5,
        initial_pressure: float | None = None,
    ) -> Cases:
        """Solve the cases of a data set: the 1D baseline of the paper's table.

        Inlet flow and undeformed area are the data's.  For the paper's own wall law
        give the solver ``LinearWall(reference_pressure=PAPER_REFERENCE_PRESSURE)``.
        The column "1D FEM" of the paper's table comes out with three quarters of its
        Young modulus: svOneDSolver's linear wall takes 4/3·E·h/r₀ as one number, and
        E·h/r₀ seems to have been given.

        Parameters
        ----------
        cases : Cases
            Data, of the solver's ``n_times`` instants per cycle from t = 0.
        outlet : Windkessel, optional
            By default the resistance that fits the data best, see
            :func:`outlet_resistance`.
        stenosis_length : float
            L_s of the Seeley–Young drop, cm.  Its throat is where S_u is smallest
            against a vessel that tapers evenly, S_u = a·exp(b·z), from end to end,
            as far as the stenosis fits in; a vessel that is nowhere 1 % narrower
            than that has none.
        initial_pressure : float, optional
            See :meth:`solve`.

        Returns
        -------
        Cases
            On the data's instants and points, with its labels and two more, see
            :meth:`solve`.

        Raises
        ------
        InputError
            If the data do not suit the solver.
        SolveError
            If a case diverges.
        """
        if cases.n_times != self.n_times:
            raise InputError(
                f"The data have {cases.n_times} instants per cycle, the solver {self.n_times}; "
                f"use Tube1D(n_times={cases.n_times}, steps={10 * cases.n_times})."
            )
        if abs(float(cases.time[0])) > 1e-9 * cases.period:
            raise InputError(f"The data's cycle starts at {cases.time[0]:g} s, not at 0; shift it.")
        labels = cases.labels.drop(columns=["periodicity", "volume_balance"], errors="ignore")
        return self.solve(
            cases.z,
            cases.area_undeformed,
            [Waveform.from_samples(q, period=cases.period, n_terms=None) for q in cases.inflow],
            outlet or Windkessel(outlet_resistance(cases)),
            stenoses=[_find_stenosis(cases.z, s, stenosis_length) for s in cases.area_undeformed],
            initial_pressure=initial_pressure,
            labels=labels,
        )


def outlet_resistance(cases: Cases) -> float:
    """Resistance R, dyn·s/cm⁵, that fits p = R·Q at the outlet of all cases best.

    Raises
    ------
    InputError
        If nothing flows out, or against the pressure.
    """
    flow, pressure = cases.flow[:, :, -1].ravel(), cases.pressure[:, :, -1].ravel()
    if not flow @ pressure > 0.0:
        raise InputError("The data's outlet flow and pressure give no resistance; give an outlet.")
    return float(flow @ pressure / (flow @ flow))


def _find_stenosis(z: Array, area_undeformed: Array, length: float) -> tuple[Stenosis, ...]:
    # An even taper is no stenosis, nor is a cone, which lies above it.
    taper = np.geomspace(area_undeformed[0], area_undeformed[-1], len(z))
    narrowing = area_undeformed / taper
    inside = [fits(Stenosis(0.0, position, length), z) for position in z]
    throat = int(np.argmin(np.where(inside, narrowing, np.inf)))
    if not inside[throat] or narrowing[throat] > 0.99:
        return ()
    position = float(z[throat])
    upstream = upstream_area(z, area_undeformed, position - length / 2)
    blockage = float(1.0 - area_undeformed[throat] / upstream)
    return () if blockage < 0.01 else (Stenosis(blockage, position, length),)


def _periodicity(last: list[Array], previous: list[Array] | None) -> Array:
    """Largest relative change of flow, area and pressure from cycle to cycle, (case,)."""
    if previous is None:
        return np.full(len(last[0]), np.nan)

    def norm(y: Array) -> Array:
        length: Array = np.sqrt((y**2).sum(axis=(1, 2)))
        return length

    changes = [
        norm(a - b) / np.maximum(norm(a), 1e-300) for a, b in zip(last, previous, strict=True)
    ]
    worst: Array = np.max(changes, axis=0)
    return worst


def _report(periodicity: Array, volume_balance: Array) -> None:
    for i, (change, balance) in enumerate(zip(periodicity, volume_balance, strict=True)):
        _log.info("Case %d: periodicity %.1e, volume balance %.1e.", i, change, balance)
    late = np.flatnonzero(periodicity > _NOT_PERIODIC)
    if len(late):
        _log.warning(
            "%d of %d cases are not periodic yet, case %d is %.1e away; use more cycles, or an "
            "initial_pressure nearer the mean.",
            len(late),
            len(periodicity),
            int(late[0]),
            float(periodicity[late[0]]),
        )
