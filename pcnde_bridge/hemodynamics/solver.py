"""One-dimensional blood flow in an elastic vessel: the paper's section 2.1.

Equations, for flow Q(z, t), area S(z, t) and pressure p(S) from a wall law:

    ∂S/∂t = −∂Q/∂z
    ∂Q/∂t = −(1 + δ) ∂(Q²/S)/∂z − S/ρ ∂p/∂z + N Q/S + ν ∂²Q/∂z²

with δ = 1/(1 + ζ) and N = −2πν(ζ + 2) for the velocity profile 1 − (r/R)^ζ
(Hughes and Lubliner 1973), unless α = 1 + δ is given; the parabola ζ = 2 gives the
paper's 1/3 and −8πν.
Inlet: Q = Q_in(t) or p = p_in(t).  Outlet: see :mod:`~pcnde_bridge.hemodynamics.outlet`.

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
waveforms are computed to 1e-5 of the flow and 1e-3 of the pressure, in the norm over a case and
up to a blockage of 85 %.  Single points near the throat have errors of the pressure of 1e-3
at a blockage of 70 %, 6e-3 at 85 % and 2e-2 at 90 %; they are of second order in Δz.

**Batches.**  All cases of a batch advance together in one program compiled by JAX
(float64).  Units are CGS throughout.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.hemodynamics.discretization import (
    Inlet,
    Inputs,
    Labels,
    Problem,
    discretize,
    on_grid,
    stenosis_fits,
    upstream_point,
)
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import Outlet, Windkessel, outlet_resistance
from pcnde_bridge.hemodynamics.settings import TubeSettings
from pcnde_bridge.hemodynamics.solution import Solution, failures, periodicity, report, summary
from pcnde_bridge.hemodynamics.waveform import Waveform

_GROUP = 32  # cases that are computed together


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
    momentum_correction : float, optional
        α of the convective term; by default the profile's (ζ + 2)/(ζ + 1) = 1 + δ.  A flat
        profile has 1, and no friction with the viscosity 0.
    n_times : int
        Recorded time points per cycle.
    steps : int
        Time steps per cycle, a multiple of ``n_times``.
    cycles : int
        Cycles computed at most; the last one is returned.
    tolerance : float, optional
        End before that when no case of a group is farther from its periodic cycle, as
        the label ``periodicity`` measures it (see :meth:`solve`).

    Raises
    ------
    InputError
        If a setting is not usable.

    Examples
    --------
    >>> from pcnde_bridge.hemodynamics import Stenosis, Tube1D, Vessel, Windkessel, coronary
    >>> vessels = [Vessel(), Vessel((Stenosis(0.7),))]
    >>> cases = Tube1D().solve(vessels, [coronary()] * 2, Windkessel(1e5))  # doctest: +SKIP
    """

    def solve(
        self,
        vessels: Sequence[Vessel] | npt.ArrayLike,
        waveforms: Sequence[Waveform],
        outlet: Outlet,
        *,
        n_points: int = 101,
        z: npt.ArrayLike | None = None,
        stenoses: Sequence[Sequence[Stenosis]] | None = None,
        initial_pressure: npt.ArrayLike | None = None,
        labels: Labels = None,
        inlet: Inlet = "flow",
    ) -> Cases:
        """Solve idealized vessels or undeformed areas, each with its waveform.

        Every case starts from rest (Q = 0).  Periodicity and volume balance of
        each case are returned as labels, and logged at level DEBUG.  A slow outlet, or a soft wall,
        needs many cycles to fill, unless ``initial_pressure`` is near the mean.
        :meth:`run` goes on from a state, and returns the other cases where some diverge.

        Parameters
        ----------
        vessels : sequence of Vessel, n_cases, or array_like of shape (n_cases, n_points)
            Idealized vessels of the same length, or S_u, cm², at the points z.
        waveforms : sequence of Waveform, n_cases
            Inlet flows, or pressures, of the same period.
        outlet : Outlet
            Outlet common to all cases, or with one value per case.
        n_points : int
            Points along idealized vessels.
        z : array_like, shape (n_points,), optional
            Equally spaced points from the inlet to the outlet, cm, of given areas.
        stenoses : sequence of sequences of Stenosis, n_cases
            Stenoses, in given areas, in which the Seeley–Young drop acts.  By default there are
            none: the pressure lost behind a narrowing is missing then.
            Position, length and blockage are used; S_D is S_u at the last point before.
        initial_pressure : float or array_like of shape (n_cases,), optional
            Pressure at rest, in the vessel and in the capacitances of the outlet,
            dyn/cm².  By default the wall's reference pressure, so that S = S_u.
        labels : DataFrame or mapping, optional
            See :class:`~pcnde_bridge.data.cases.Cases`.  By default idealized vessels and
            waveforms are numbered; a pair that is repeated, at another outlet, is another
            geometry.  The label ``blockage`` is the vessel's by default.
        inlet : {'flow', 'pressure'}
            Quantity of the waveforms: Q in mL/s, or p in dyn/cm².

        Returns
        -------
        Cases
            The last cycle at ``n_times`` time points from t = 0 and the points z, with
            the wall shear stress (ζ + 2)·μ·U/r of the velocity profile and two more labels.
            ``periodicity`` is the largest of the relative changes
            ‖last − previous cycle‖/‖last cycle‖ of flow, area and pressure, divided by
            1 − exp(−T/τ) (NaN with one cycle).  ``volume_balance`` is the change of
            volume in the last cycle minus the net inflow, divided by the volume.
            With τ = τ_o + R_o·∫dS/dp dz, the sum of the times in which outlet and vessel
            fill, ``periodicity`` is the distance of the cycles to the periodic one.  R_o
            is the resistance of the outlet and τ_o its longest time constant, R_d·C of
            a Windkessel.

        Raises
        ------
        InputError
            If the input is not usable; nothing has been computed then.
        SolveError
            If a case diverges; names the case, the time and the place.
        """
        given: dict[str, Any] = {"z": z, "area_undeformed": vessels}
        given |= {"stenoses": stenoses, "labels": labels}
        if z is None:
            given |= on_grid(given["area_undeformed"], waveforms, n_points, labels)
        options: Any = {"initial_pressure": initial_pressure, "inlet": inlet}
        problem = discretize(self, waveforms=waveforms, outlet=outlet, **given, **options)
        return self.run(problem).check()

    def run(self, problem: Problem, state: Any = None) -> Solution:
        """Solve a problem that is already checked and discretized.

        Cases are computed in groups of up to 32, one on each processor, so that few shapes are
        compiled and the arrays of a group stay in the processor's cache.

        Parameters
        ----------
        problem : Problem
            Of :func:`~pcnde_bridge.hemodynamics.discretization.discretize`.
        state : optional
            State of another solution, of as many cases and points, from which to go on; by
            default rest.

        Returns
        -------
        Solution
            The last cycle of the cases that did not diverge.

        Raises
        ------
        SolveError
            If all cases diverge.
        """
        n_cases, n_points = problem.inputs.area_undeformed.shape
        groups = np.split(np.arange(n_cases), range(_GROUP, n_cases, _GROUP))
        if state is not None and state[0] != (n_cases, n_points, problem.form):
            raise InputError("The state is of another number of cases or points, or of other laws.")
        states = [None] * len(groups) if state is None else state[1]
        run = partial(self._run_group, problem)
        if len(groups) == 1:
            parts = [run(groups[0], states[0])]
        else:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                parts = list(pool.map(run, groups, states))
        failed = {case: text for part in parts for case, text in part[2].items()}
        if len(failed) == n_cases:
            raise SolveError(summary(failed))
        kept = np.setdiff1d(np.arange(n_cases), list(failed))
        flow, area, pressure, distance, balance = (
            np.concatenate(values)[kept]
            for values in zip(*(part[0] for part in parts), strict=True)
        )
        report(distance, balance)
        labels = problem.labels.iloc[kept].reset_index(drop=True)
        labels = labels.assign(periodicity=distance, volume_balance=balance)
        time = np.arange(self.n_times) * (problem.period / self.n_times)
        fields = flow, area, pressure, problem.inputs.area_undeformed[kept], time, problem.z
        shear = (self.profile_exponent + 2.0) * self.viscosity * flow / area * np.sqrt(np.pi / area)
        more = {"period": problem.period, "labels": labels, "wall_shear_stress": shear}
        reached = (n_cases, n_points, problem.form), [part[1] for part in parts]
        return Solution(Cases(*fields, **more, check=False), reached, failed)

    def jax_function(self, problem: Problem) -> tuple[Callable[[Inputs], Any], Inputs]:
        """Return the solver as a pure JAX function, and its argument for a problem.

        The function may be used under ``jit``, ``vmap`` and ``grad``; its derivatives are those
        of the discrete equations.  It checks nothing and needs ``jax_enable_x64``.

        Parameters
        ----------
        problem : Problem
            Of :func:`~pcnde_bridge.hemodynamics.discretization.discretize`.

        Returns
        -------
        function : callable
            Takes :class:`~pcnde_bridge.hemodynamics.discretization.Inputs`: undeformed area,
            parameters of the wall, inlet, outlet and initial pressure.  Returns flow, area
            and pressure of the last of ``cycles`` cycles, each (case, time, z).
        inputs : Inputs
            Those of the problem, as arrays.
        """

        def function(inputs: Inputs) -> Any:
            from pcnde_bridge.hemodynamics import tr_bdf2

            given = problem.form, inputs, problem.narrowings, problem.blood
            state = tr_bdf2.start(*given)
            for _ in range(self.cycles):
                state, records, _ = tr_bdf2.cycle(*given, state)
            return records

        return function, problem.inputs

    def _run_group(self, problem: Problem, group: Any, state: Any) -> tuple[list[Any], Any, Any]:
        """Return the last cycle of several cases with its accuracy, its end, and the failures."""
        # The last case fills the group up to a power of two.
        size, count = 1 << (len(group) - 1).bit_length(), len(group)
        cases = np.append(group, np.full(size - count, group[-1]))
        with double_precision():
            import jax

            from pcnde_bridge.hemodynamics import tr_bdf2

            inputs, narrowings = jax.tree.map(
                lambda values: values[cases], (problem.inputs, problem.narrowings)
            )
            given = problem.form, inputs, narrowings, problem.blood
            state = tr_bdf2.compiled_start(*given) if state is None else state
            last, distance = None, np.full(count, np.nan)
            failed: dict[int, str] = {}
            for number in range(self.cycles):
                state, records, balance = tr_bdf2.compiled_cycle(*given, state)
                previous, last = last, [np.asarray(record)[:count] for record in records]
                failed = failures(problem, group, state, number) | failed
                if previous is not None:
                    distance = periodicity(problem, group, last, previous)
                alive = np.setdiff1d(np.arange(count), np.array(list(failed)) - group[0])
                done = self.tolerance is not None and distance[alive] <= self.tolerance
                if not len(alive) or np.all(done):
                    break
            state = jax.tree.map(np.asarray, state)
        assert last is not None  # there is at least one cycle
        return [*last, distance, np.asarray(balance)[:count]], state, failed

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
            cases.area_undeformed,
            [Waveform.from_samples(q, period=cases.period, n_terms=None) for q in cases.inflow],
            outlet or Windkessel(outlet_resistance(cases)),
            z=cases.z,
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
    upstream = area_undeformed[upstream_point(z, position - length / 2)]
    blockage = float(1.0 - area_undeformed[throat] / upstream)
    return () if blockage < 0.01 else (Stenosis(blockage, position, length),)
