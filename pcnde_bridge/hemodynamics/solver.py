"""One-dimensional blood flow in an elastic vessel: the paper's section 2.1.

Equations, for flow Q(z, t), area S(z, t) and pressure p(S) from a wall law:

    ∂S/∂t = −∂Q/∂z
    ∂Q/∂t = −(1 + δ) ∂(Q²/S)/∂z − S/ρ ∂p/∂z + N Q/S + ν ∂²Q/∂z²

with δ = 1/(1 + ζ) and N = −2πν(ζ + 2) for the velocity profile 1 − (r/R)^ζ
(Hughes and Lubliner 1973); the parabola ζ = 2 gives the paper's 1/3 and −8πν.
Inlet: Q = Q_in(t).  Outlet: a resistance or three-element Windkessel.

**Space.**  Finite volumes on a staggered grid (Harlow and Welch 1965): areas in
cells, flows on their faces, so that the inlet flow is imposed at the inlet and volume
is conserved to round-off.  The area on a face is the harmonic mean of its cells: the
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
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.discretization import (
    Labels,
    Problem,
    discretize,
    on_grid,
    stenosis_fits,
    upstream_area,
)
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.settings import TubeSettings
from pcnde_bridge.hemodynamics.waveform import Waveform

_log = logging.getLogger(__name__)

_NOT_PERIODIC = 1e-3


@dataclass(frozen=True)
class Tube1D(TubeSettings):
    """One-dimensional solver with its settings.

    Attributes
    ----------
    wall : LinearWall or OlufsenWall
        Wall law; the paper's artery, undeformed at zero pressure, by default.
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
        Recorded time points per cycle.
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
    >>> from pcnde_bridge.hemodynamics import Stenosis, Tube1D, Vessel, Windkessel, coronary
    >>> vessels = [Vessel(), Vessel((Stenosis(0.7),))]
    >>> cases = Tube1D().simulate(vessels, [coronary()] * 2, Windkessel(1e5))  # doctest: +SKIP
    """

    def simulate(
        self,
        vessels: Sequence[Vessel],
        waveforms: Sequence[Waveform],
        outlet: Windkessel,
        *,
        n_points: int = 101,
        initial_pressure: float | None = None,
        labels: Labels = None,
    ) -> Cases:
        """Solve idealized vessels, each with its waveform.

        Parameters
        ----------
        vessels : sequence of Vessel, n_cases
            Vessels of the same length.
        waveforms : sequence of Waveform, n_cases
            Inlet flows of the same period.
        outlet, initial_pressure, labels
            See :meth:`solve`.  The label ``blockage`` is the vessel's by default.  Without
            labels, a pair of vessel and waveform that is repeated, at another outlet, is
            another geometry.
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
        given = on_grid(vessels, waveforms, n_points, labels)
        given |= {"waveforms": waveforms, "outlet": outlet, "initial_pressure": initial_pressure}
        return self.solve_problem(discretize(self, **given))

    def solve(
        self,
        z: npt.ArrayLike,
        area_undeformed: npt.ArrayLike,
        waveforms: Sequence[Waveform],
        outlet: Windkessel,
        *,
        stenoses: Sequence[Sequence[Stenosis]] | None = None,
        initial_pressure: float | None = None,
        labels: Labels = None,
    ) -> Cases:
        """Solve vessels given by their undeformed area.

        Every case starts from rest (Q = 0).  Periodicity and volume balance of
        each case are returned as labels, and logged at level DEBUG.  A slow outlet, or a soft wall,
        needs many cycles to fill, unless ``initial_pressure`` is near the mean.

        Parameters
        ----------
        z : array_like, shape (n_points,)
            Equally spaced points from the inlet to the outlet, cm.
        area_undeformed : array_like, shape (n_cases, n_points)
            S_u, cm².
        waveforms : sequence of Waveform, n_cases
            Inlet flows of the same period.
        outlet : Windkessel
            Outlet common to all cases, or with one value per case.
        stenoses : sequence of sequences of Stenosis, n_cases
            Stenoses in which the Seeley–Young drop acts; none by default.  Position, length
            and blockage are used; S_D is S_u at the last point before the stenosis.
        initial_pressure : float, optional
            Pressure at rest, in the vessel and in the Windkessel's capacitor,
            dyn/cm².  By default the wall's reference pressure, so that S = S_u.
        labels : DataFrame or mapping, optional
            See :class:`~pcnde_bridge.data.cases.Cases`.

        Returns
        -------
        Cases
            The last cycle at ``n_times`` time points from t = 0 and the points z, with
            two more labels.  ``periodicity`` is the largest of the relative changes
            ‖last − previous cycle‖/‖last cycle‖ of flow, area and pressure, divided by
            1 − exp(−T/τ) (NaN with one cycle).  ``volume_balance`` is the change of
            volume in the last cycle minus the net inflow, divided by the volume.
            With τ = R_d·C + (R + R_d)·∫dS/dp dz, in which Windkessel and vessel
            fill, ``periodicity`` is the distance of the cycles to the periodic one.

        Raises
        ------
        InputError
            If the input is not usable; nothing has been computed then.
        SolveError
            If a case diverges; names the case, the time and the place.
        """
        given = z, area_undeformed, waveforms, outlet, stenoses, initial_pressure, labels
        return self.solve_problem(discretize(self, *given))

    def solve_problem(self, problem: Problem) -> Cases:
        """Solve a problem that is already checked and discretized; see :meth:`solve`."""
        with double_precision():
            from pcnde_bridge.hemodynamics.tr_bdf2 import run

            last, previous, volume_balance = run(self.wall, problem, self.cycles)
        periodicity = _periodicity(last, previous) / self._settling(problem, last[1])
        _report(periodicity, volume_balance)
        flow, area, pressure = last
        time = np.arange(self.n_times) * (problem.period / self.n_times)
        labels = problem.labels.assign(periodicity=periodicity, volume_balance=volume_balance)
        z, period, s_u = problem.z, problem.period, problem.area_undeformed
        fields = flow, area, pressure, s_u, time, z
        return Cases(*fields, period=period, labels=labels, check=False)

    def _settling(self, problem: Problem, area: Array) -> Array:
        """Fraction of its distance to the periodic state that a cycle covers, (case,)."""
        proximal, distal, delay, _ = problem.tube.outlet
        slope = self.wall.pressure_slope(area.mean(axis=1), problem.area_undeformed)
        compliance = (1.0 / slope).mean(axis=1) * (problem.z[-1] - problem.z[0])
        # The sum of both times is an upper bound of the slower of two that are coupled.
        slowest = delay + (proximal + distal) * compliance
        with np.errstate(divide="ignore"):
            return np.asarray(-np.expm1(-problem.period / slowest))

    def solve_like(
        self,
        cases: Cases,
        outlet: Windkessel | None = None,
        *,
        stenosis_length: float = 0.5,
        initial_pressure: float | None = None,
    ) -> Cases:
        """Solve the cases of a data set: the 1D baseline of the paper's table.

        Inlet flow and undeformed area are those of the data.  For the paper's own wall law
        give the solver ``LinearWall(reference_pressure=PAPER_REFERENCE_PRESSURE)``.
        The column "1D FEM" of the paper's table is reproduced with three quarters of its
        Young modulus: svOneDSolver's linear wall takes 4/3·E·h/r₀ as one number, and
        E·h/r₀ seems to have been given.

        Parameters
        ----------
        cases : Cases
            Data with the solver's ``n_times`` time points per cycle from t = 0.
        outlet : Windkessel, optional
            By default the resistance that fits the data best, see
            :func:`~pcnde_bridge.hemodynamics.outlet.outlet_resistance`.
        stenosis_length : float
            L_s of the Seeley–Young drop, cm.  Its throat is where S_u is smallest
            relative to a vessel that tapers evenly, S_u = a·exp(b·z), from end to end,
            if the stenosis fits there.  A vessel that is nowhere 1 % narrower
            than that has no stenosis.
        initial_pressure : float, optional
            See :meth:`solve`.

        Returns
        -------
        Cases
            Result at the time points and points of the data, with their labels and two
            more, see :meth:`solve`.

        Raises
        ------
        InputError
            If the data do not suit the solver.
        SolveError
            If a case diverges.
        """
        if cases.n_times != self.n_times:
            raise InputError(
                f"The data have {cases.n_times} time points per cycle, the solver {self.n_times}; "
                f"use Tube1D(n_times={cases.n_times}, steps={10 * cases.n_times})."
            )
        if abs(float(cases.time[0])) > 1e-9 * cases.period:
            raise InputError(
                f"The data start at {cases.time[0]:g} s; subtract the first time point."
            )
        return self.solve(
            cases.z,
            cases.area_undeformed,
            [Waveform.from_samples(q, period=cases.period, n_terms=None) for q in cases.inflow],
            outlet or Windkessel(outlet_resistance(cases)),
            stenoses=[_find_stenosis(cases.z, s, stenosis_length) for s in cases.area_undeformed],
            initial_pressure=initial_pressure,
            labels=cases.labels.drop(columns=list(SOLVER_LABELS), errors="ignore"),
        )


def _find_stenosis(z: Array, area_undeformed: Array, length: float) -> tuple[Stenosis, ...]:
    # An even taper is no stenosis, nor is a cone, which lies above it.
    taper = np.geomspace(area_undeformed[0], area_undeformed[-1], len(z))
    narrowing = area_undeformed / taper
    inside = [stenosis_fits(Stenosis(0.0, position, length), z) for position in z]
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
        return np.asarray(np.sqrt((y**2).sum(axis=(1, 2))))

    pairs = zip(last, previous, strict=True)
    return np.asarray(np.max([norm(a - b) / np.maximum(norm(a), 1e-300) for a, b in pairs], axis=0))


def _report(periodicity: Array, volume_balance: Array) -> None:
    _log.debug("Periodicity %s, volume balance %s.", periodicity, volume_balance)
    if len(late := np.flatnonzero(periodicity > _NOT_PERIODIC)):
        _log.warning(
            "%d of %d cases are not periodic yet, case %d is %.1e away; use more cycles, or an "
            "initial_pressure nearer the mean.",
            *(len(late), len(periodicity), late[0], periodicity[late[0]]),
        )
