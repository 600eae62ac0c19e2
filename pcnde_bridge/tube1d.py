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

import functools
import logging
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from pcnde_bridge.case_checks import UnitsWarning
from pcnde_bridge.cases import Cases
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.precision import double_precision
from pcnde_bridge.stenosis import effective_length, turbulent_drop, viscous_drop
from pcnde_bridge.validation import whole
from pcnde_bridge.vessel import Stenosis, Vessel
from pcnde_bridge.wall import LinearWall, OlufsenWall
from pcnde_bridge.waveform import Waveform

if TYPE_CHECKING:
    import pandas as pd

Array = npt.NDArray[np.float64]
StenosisLoss = Literal["none", "paper", "effective_length"]

_log = logging.getLogger(__name__)

# TR-BDF2 as a diagonally implicit Runge–Kutta method with an explicit first stage:
# every implicit stage weighs its own slope by _GAMMA/2, and the last stage weighs
# the two before it by _WEIGHT each.
_GAMMA = 2.0 - math.sqrt(2.0)
_OWN = _GAMMA / 2
_WEIGHT = math.sqrt(2.0) / 4

_MAX_NEWTON = 20
_NEWTON_TOLERANCE = 1e-6  # of the last update; convergence is quadratic
_LARGEST_AREA_RATIO = 2.5  # of S_u between neighbouring points
_STEPS_PER_HARMONIC = 8  # time steps per period of the highest harmonic
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
        vessel widens.
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
    >>> from pcnde_bridge.tube1d import Tube1D, Windkessel
    >>> from pcnde_bridge.vessel import Stenosis, Vessel
    >>> from pcnde_bridge.waveform import coronary
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
        for name in ("density", "viscosity", "profile_exponent"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"Tube1D.{name} must be positive, got {value!r}.")
        if not (math.isfinite(self.turbulent_coefficient) and self.turbulent_coefficient >= 0.0):
            raise InputError(
                "Tube1D.turbulent_coefficient must not be negative, "
                f"got {self.turbulent_coefficient!r}."
            )
        for name, least in (("n_times", 4), ("steps", 1), ("cycles", 1)):
            value = whole(f"Tube1D.{name}", getattr(self, name), least)
            object.__setattr__(self, name, value)
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
            See :meth:`solve`; the label ``blockage`` is the vessel's by default.
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
        if not vessels:
            raise InputError("There is no vessel to solve; give at least one.")
        for i, vessel in enumerate(vessels):
            if vessel.length != vessels[0].length:
                raise InputError(
                    f"Vessel {i} is {vessel.length:g} cm long, vessel 0 {vessels[0].length:g} cm; "
                    "solve different lengths in different batches."
                )
        z = vessels[0].grid(n_points)
        if labels is None:
            # One geometry per different vessel, one waveform label per different waveform.
            shapes = list(dict.fromkeys(vessels))
            inlets = list(dict.fromkeys(waveforms))
            labels = {
                "geometry": [shapes.index(v) for v in vessels],
                "waveform": [inlets.index(w) for w in waveforms],
                "blockage": [v.blockage for v in vessels],
            }
        return self.solve(
            z,
            np.array([vessel.area_undeformed(z) for vessel in vessels]),
            waveforms,
            outlet,
            stenoses=[vessel.stenoses for vessel in vessels],
            initial_pressure=initial_pressure,
            labels=labels,
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
        each case are logged and returned as labels.

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
            See :class:`~pcnde_bridge.cases.Cases`.

        Returns
        -------
        Cases
            The last cycle, ``n_times`` instants from t = 0 and the points z, with
            two more labels: ``periodicity``, the largest of the relative changes
            ‖last − previous cycle‖/‖last cycle‖ of flow, area and pressure (NaN
            with one cycle), and ``volume_balance``, the change of volume in the
            last cycle less what flowed in and out, over the volume.

        Raises
        ------
        InputError
            If the input is not usable; nothing has been computed then.
        SolveError
            If a case diverges; names the case, the time and the place.
        """
        problem = _check(
            self, z, area_undeformed, waveforms, outlet, stenoses, initial_pressure, labels
        )
        with double_precision():
            last, previous, volume_balance = _run(self, problem)
        periodicity = _periodicity(last, previous)
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
            L_s of the Seeley–Young drop, cm.  Its throat is where S_u is smallest;
            a vessel whose S_u varies by less than 1 % has none.
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
    throat = int(np.argmin(area_undeformed))
    position = float(z[throat])
    upstream = _upstream_area(z, area_undeformed, position - length / 2)
    blockage = float(1.0 - area_undeformed[throat] / upstream)
    return () if blockage < 0.01 else (Stenosis(blockage, position, length),)


# ---- checking the input ------------------------------------------------------------


@dataclass(frozen=True)
class _Problem:
    """Checked input; the points are the faces of n cells."""

    z: Array  # (n + 1,)
    area_undeformed: Array  # (case, n + 1)
    inflow: Array  # of one cycle, (instant, step, stage, case)
    outlet: tuple[Array, ...]  # R, R_d, R_d·C, p_d (case,)
    viscous: Array  # pressure loss per length and per Q around a face, at S = S_u (case, n)
    turbulent: Array  # … per length and per Q·|Q|
    initial_pressure: float
    period: float
    labels: pd.DataFrame


def _check(
    tube: Tube1D,
    z: npt.ArrayLike,
    area_undeformed: npt.ArrayLike,
    waveforms: Sequence[Waveform],
    outlet: Windkessel,
    stenoses: Sequence[Sequence[Stenosis]] | None,
    initial_pressure: float | None,
    labels: pd.DataFrame | Mapping[str, Any] | None,
) -> _Problem:
    """Refuse what cannot be solved; bring the rest to the solver's grid."""
    points = _points(z)
    area = _finite("area_undeformed", area_undeformed)
    if area.ndim != 2 or area.shape[1] != len(points) or not len(area):
        raise InputError(
            f"area_undeformed must have the shape (n_cases, {len(points)}), got {area.shape}."
        )
    n_cases = len(area)
    for i, k in np.argwhere(area <= 0.0)[:1]:
        raise InputError(f"area_undeformed[{i}, {k}] = {area[i, k]:g} cm² is not positive.")
    ratio = np.exp(np.abs(np.diff(np.log(area), axis=1)))
    for i, k in np.argwhere(ratio > _LARGEST_AREA_RATIO)[:1]:
        raise InputError(
            f"The grid is too coarse: area_undeformed of case {i} changes {ratio[i, k]:.1f}-fold "
            f"between z = {points[k]:g} and {points[k + 1]:g} cm, {_LARGEST_AREA_RATIO:g}-fold at "
            "most can be resolved; use more points."
        )
    period = _period(waveforms, n_cases)
    all_stenoses = [()] * n_cases if stenoses is None else stenoses
    if len(all_stenoses) != n_cases:
        raise InputError(f"stenoses has {len(all_stenoses)} entries for {n_cases} cases.")
    _check_steps(tube, points, area, waveforms)

    rest = tube.wall.reference_pressure if initial_pressure is None else initial_pressure
    with np.errstate(divide="ignore"):
        area_at_rest = tube.wall.area(rest, area)
    slope = tube.wall.pressure_slope(area_at_rest, area)
    if not (np.isfinite(slope) & (slope > 0.0)).all() or not math.isfinite(rest):
        raise InputError(f"initial_pressure = {rest!r} dyn/cm² is outside the wall law's range.")
    if not np.allclose(tube.wall.pressure(area_at_rest, area), rest, atol=1.0):
        raise InputError(f"initial_pressure = {rest:g} dyn/cm² would collapse or burst the wall.")

    viscous, turbulent = _losses(tube, points, area, all_stenoses)
    return _Problem(
        points,
        area,
        _stage_inflow(tube, waveforms, period),
        _outlet(outlet, n_cases),
        viscous,
        turbulent,
        float(rest),
        period,
        _labels(points, area, labels),
    )


def _labels(
    z: Array, area_undeformed: Array, labels: pd.DataFrame | Mapping[str, Any] | None
) -> pd.DataFrame:
    """Labels as the data set wants them, found wrong now rather than after computing."""
    instants = 4
    area = np.repeat(area_undeformed[:, None], instants, axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitsWarning)
        rest = Cases(
            0 * area, area, 0 * area, area_undeformed, np.arange(instants), z, labels=labels
        )
    return rest.labels


def _finite(name: str, values: npt.ArrayLike) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of numbers: {error}.") from error
    for index in np.argwhere(~np.isfinite(array))[:1]:
        raise InputError(f"{name}{index.tolist()} is {array[tuple(index)]}; it must be finite.")
    return array


def _points(z: npt.ArrayLike) -> Array:
    points = _finite("z", z)
    if points.ndim != 1 or len(points) < 4:
        raise InputError(
            f"The grid is too coarse: z has shape {points.shape}, at least 4 points are needed."
        )
    steps = np.diff(points)
    mean = (points[-1] - points[0]) / len(steps)
    for k in np.flatnonzero(~(np.abs(steps - mean) <= 1e-6 * abs(mean)) | (steps <= 0.0))[:1]:
        raise InputError(
            f"z must increase in equal steps (cm), but z[{k + 1}] − z[{k}] = {steps[k]:g} "
            f"with a mean step of {mean:g}."
        )
    return points


def _period(waveforms: Sequence[Waveform], n_cases: int) -> float:
    if len(waveforms) != n_cases:
        raise InputError(f"There are {len(waveforms)} waveforms for {n_cases} cases.")
    for i, waveform in enumerate(waveforms):
        if not isinstance(waveform, Waveform):
            raise InputError(f"waveforms[{i}] must be a Waveform, got {type(waveform).__name__}.")
        if not math.isclose(waveform.period, waveforms[0].period, rel_tol=1e-12):
            raise InputError(
                f"waveforms[{i}] has a period of {waveform.period:g} s, waveforms[0] of "
                f"{waveforms[0].period:g} s; solve different periods in different batches."
            )
    return waveforms[0].period


def _check_steps(
    tube: Tube1D, z: Array, area_undeformed: Array, waveforms: Sequence[Waveform]
) -> None:
    """Refuse a time step or a flow that the scheme is not made for."""
    for i, waveform in enumerate(waveforms):
        amplitude = np.hypot(waveform.cosine, waveform.sine)
        audible = np.flatnonzero(amplitude > 1e-3 * (abs(waveform.mean) + amplitude.max(initial=0)))
        highest = int(audible[-1]) + 1 if len(audible) else 0
        if tube.steps < _STEPS_PER_HARMONIC * highest:
            raise InputError(
                f"The time step is too long: waveforms[{i}] has {highest} harmonics, which need "
                f"at least {_STEPS_PER_HARMONIC * highest} steps per cycle, not {tube.steps}."
            )
        peak = np.abs(waveform.samples(tube.steps)).max()
        narrowest = int(np.argmin(area_undeformed[i]))
        smallest = area_undeformed[i, narrowest]
        speed = peak / smallest
        where = f"case {i} at z = {z[narrowest]:g} cm"
        wave_speed = float(tube.wall.wave_speed(smallest, smallest, tube.density))
        if speed >= wave_speed:
            raise InputError(
                f"The flow would be faster than the pulse wave: {speed:.0f} cm/s against "
                f"{wave_speed:.0f} cm/s in {where}; lower the flow or the blockage."
            )


def _outlet(outlet: Windkessel, n_cases: int) -> tuple[Array, ...]:
    values = []
    for name in ("resistance", "distal_resistance", "capacitance", "distal_pressure"):
        value = _finite(f"outlet.{name}", getattr(outlet, name))
        if value.ndim > 1 or value.size not in (1, n_cases):
            raise InputError(
                f"outlet.{name} must be one number or one for each of {n_cases} cases, "
                f"got shape {value.shape}."
            )
        if name != "distal_pressure" and (value < 0.0).any():
            raise InputError(f"outlet.{name} must not be negative, got {value.min():g}.")
        values.append(np.broadcast_to(value, (n_cases,)))
    proximal, distal, capacitance, pressure = values
    return proximal, distal, distal * capacitance, pressure


def _losses(
    tube: Tube1D, z: Array, area_undeformed: Array, stenoses: Sequence[Sequence[Stenosis]]
) -> tuple[Array, Array]:
    """Loss of pressure per length around each face, per Q and per Q·|Q|.

    Wall friction N·Q/S is written as the pressure gradient −ρ·N·Q/S², so that it
    widens with the vessel as a stenosis's loss does, and takes its place.
    """
    n = len(z) - 1
    dz = (z[-1] - z[0]) / n
    # The momentum of a face is balanced from cell centre to cell centre, and on the
    # last face from the last centre to the outlet.
    left = z[1:] - dz / 2
    right = np.append(z[1:-1] + dz / 2, z[-1])
    # Mean of 1/S_u² over that stretch, if linear between the points.
    inverse = area_undeformed**-2.0
    mean = 0.75 * inverse[:, 1:]
    mean[:, :-1] += (inverse[:, :-2] + inverse[:, 2:]) / 8
    mean[:, -1] += inverse[:, -2] / 4
    viscous = -tube.density * tube.friction * mean
    turbulent = np.zeros_like(viscous)
    for i, several in enumerate(stenoses):
        for stenosis in several:
            if stenosis.start < z[0] + dz / 2 or stenosis.end > z[-1]:
                raise InputError(
                    f"A stenosis of case {i} reaches from {stenosis.start:g} to {stenosis.end:g} "
                    f"cm, too close to the ends of the tube ({z[0]:g} … {z[-1]:g} cm)."
                )
            if stenosis.length < 4 * dz:
                raise InputError(
                    f"The grid is too coarse: the stenosis of case {i} at {stenosis.position:g} "
                    f"cm is {stenosis.length:g} cm long, less than 4 cells of {dz:g} cm; use more "
                    "points."
                )
        if tube.stenosis_loss == "none":
            continue
        shares = [_share(left, right, stenosis) for stenosis in several]
        viscous[i] *= 1.0 - np.minimum(sum(shares), 1.0)
        for stenosis in several:
            healthy = _upstream_area(z, area_undeformed[i], stenosis.start)
            throat = healthy * (1.0 - stenosis.blockage)
            length = stenosis.length
            if tube.stenosis_loss == "effective_length":
                length = effective_length(length, throat)
            spread = _spread(left, right, stenosis)
            viscous[i] += spread * viscous_drop(1.0, healthy, throat, length, tube.viscosity)
            turbulent[i] += spread * turbulent_drop(
                1.0, healthy, throat, tube.density, tube.turbulent_coefficient
            )
    return viscous, turbulent


def _share(left: Array, right: Array, stenosis: Stenosis) -> Array:
    """Share of each stretch from left to right that lies in the stenosis."""
    overlap = np.minimum(right, stenosis.end) - np.maximum(left, stenosis.start)
    share: Array = np.maximum(overlap, 0.0) / (right - left)
    return share


def _spread(left: Array, right: Array, stenosis: Stenosis) -> Array:
    """Share of the stenosis's loss that falls on each stretch, per length.

    The loss grows with (1 + cos 2πx/L_s)/L_s, the shape of the narrowing itself; its
    integral is exact, so that the whole loss is felt on any grid.
    """

    def upstream_of(z: Array) -> Array:
        x = np.clip((z - stenosis.position) / stenosis.length, -0.5, 0.5)
        part: Array = 0.5 + x + np.sin(2.0 * np.pi * x) / (2.0 * np.pi)
        return part

    spread: Array = (upstream_of(right) - upstream_of(left)) / (right - left)
    return spread


def _upstream_area(z: Array, area_undeformed: Array, start: float) -> float:
    """S_D: S_u at the last point that is not inside the stenosis that starts there."""
    point = int(np.searchsorted(z, start + 1e-9 * (z[-1] - z[0]), side="right")) - 1
    return float(area_undeformed[max(point, 0)])


def _stage_inflow(tube: Tube1D, waveforms: Sequence[Waveform], period: float) -> Array:
    """Inlet flow at both stages of every step of a cycle, (instant, step, stage, case)."""
    dt = period / tube.steps
    stages = dt * (np.arange(tube.steps)[:, None] + np.array([_GAMMA, 1.0]))
    inflow = np.stack([waveform.flow(stages) for waveform in waveforms], axis=-1)
    return inflow.reshape(tube.n_times, tube.steps // tube.n_times, 2, len(waveforms))


# ---- computing ---------------------------------------------------------------------


class _Fields(NamedTuple):
    """Unknowns of all cases at one instant, or their slopes in time; n is the number of cells."""

    area: Any  # S in the cells (case, n)
    flow: Any  # Q at the faces (case, n + 1); the first is the inlet
    capacitor: Any  # p_c of the Windkessel (case,)


class _State(NamedTuple):
    """All that one time step hands to the next."""

    now: _Fields
    slope: _Fields
    inflow: Any  # volume that came in less what went out in this cycle (case,)
    broken: Any  # step and cell at which a case failed, or −1 (case, 2)


def _run(tube: Tube1D, problem: _Problem) -> tuple[list[Array], list[Array] | None, Array]:
    """Last cycle, the one before it, and the volume balance of the last."""
    cycle = _compiled_cycle(tube.wall)
    n_cases, n_faces = problem.area_undeformed.shape
    n = n_faces - 1
    cells = 0.5 * (problem.area_undeformed[:, :-1] + problem.area_undeformed[:, 1:])
    dz = float(problem.z[-1] - problem.z[0]) / n
    dt = problem.period / tube.steps
    rest = _Fields(
        area=np.asarray(tube.wall.area(problem.initial_pressure, cells)),
        flow=np.zeros((n_cases, n_faces)),
        capacitor=np.full(n_cases, problem.initial_pressure),
    )
    state = _State(
        now=rest,
        slope=_Fields(*(np.zeros_like(values) for values in rest)),
        inflow=np.zeros(n_cases),
        broken=np.full((n_cases, 2), -1),
    )
    vessel = (
        cells,
        problem.area_undeformed[:, -1],
        problem.viscous,
        problem.turbulent,
        problem.outlet,
    )
    blood = (tube.density, tube.kinematic_viscosity, 1.0 + tube.delta)
    last: list[Array] = []
    for number in range(tube.cycles):
        previous = last
        before = np.asarray(state.now.area).sum(axis=1) * dz
        state = state._replace(inflow=np.zeros(n_cases))
        state, records = cycle(state, problem.inflow, vessel, blood, dz, dt)
        _refuse_broken(np.asarray(state.broken), number, tube, problem)
        flow, pressure = (np.moveaxis(np.array(record), 0, 1) for record in records)
        area = np.asarray(tube.wall.area(pressure, problem.area_undeformed[:, None, :]))
        last = [flow, area, pressure]
    after = np.asarray(state.now.area).sum(axis=1) * dz
    volume_balance = np.abs(after - before - np.asarray(state.inflow)) / after
    return last, previous or None, volume_balance


def _refuse_broken(broken: Array, cycle: int, tube: Tube1D, problem: _Problem) -> None:
    failed = np.flatnonzero(broken[:, 0] >= 0)
    if not len(failed):
        return
    case = int(failed[np.argmin(broken[failed, 0])])
    step, cell = (int(v) for v in broken[case])
    time = cycle * problem.period + (step + 1) * problem.period / tube.steps
    named = ", ".join(f"{k} {problem.labels[k][case]}" for k in ("geometry", "waveform"))
    others = f" ({len(failed)} of {len(broken)} cases diverged)" if len(failed) > 1 else ""
    raise SolveError(
        f"Case {case} ({named}) diverged at t = {time:.4g} s, near z = {problem.z[cell]:.4g} cm"
        f"{others}: the wall collapsed or the flow found no balance there. Check its inlet flow, "
        "wall stiffness and outlet, or use more steps per cycle."
    )


@functools.lru_cache(maxsize=16)
def _compiled_cycle(
    wall: LinearWall | OlufsenWall,
) -> Callable[..., tuple[_State, tuple[Any, Any]]]:
    """Compile the function that advances all cases by one cycle, for this wall."""
    import jax
    import jax.numpy as jnp
    from jax.lax.linalg import tridiagonal_solve

    def harmonic_mean(a: Any, b: Any) -> Any:
        return 2.0 / (1.0 / a + 1.0 / b)

    def cycle(state: _State, inflow: Any, vessel: Any, blood: Any, dz: Any, dt: Any) -> Any:
        rho, nu, convection = blood
        cells, end, viscous, turbulent, (proximal, distal, delay, pressure_d) = vessel
        n = cells.shape[1]
        own = _OWN * dt
        # Area on the faces behind the inlet, the last at the outlet itself.
        faces = harmonic_mean(cells, jnp.concatenate([cells[:, 1:], end[:, None]], axis=1))
        # Distance over which a face's momentum is balanced.
        width = jnp.full(n, dz).at[-1].set(dz / 2)
        # Share of a cell's area that leaves with a unit of flow through its face.
        k = own / dz

        def capacitor(pressure: Any, flow: Any) -> Any:
            """Implicit p_c of a stage, from its explicit part and the outflow."""
            return (delay * pressure + own * (pressure_d + distal * flow)) / (delay + own)

        def balance(flow: Any, area: Any, capacitor_part: Any) -> tuple[Any, ...]:
            """∂Q/∂t on the faces behind the inlet, and its derivatives by the flows.

            Derivatives are by the flow at the face before, at the face itself, and at
            the face behind, where a flow also changes the areas of its two cells.
            """
            q = flow[:, 1:]
            # Area, pressure and momentum Q²/S of a cell, each with its derivatives by
            # the flow that enters it and by the flow that leaves it.
            centre = 0.5 * (flow[:, :-1] + q)
            p, m = wall.pressure(area, cells), centre**2 / area
            p_enter = k * wall.pressure_slope(area, cells)
            m_enter, m_leave = (centre - k * m) / area, (centre + k * m) / area

            # What lies behind a face: the next cell, or the outlet, which follows from q.
            q_out = q[:, -1:]
            p_out = (capacitor(capacitor_part, q[:, -1]) + proximal * q[:, -1])[:, None]
            p_out_q = (proximal + own * distal / (delay + own))[:, None]
            s_out = wall.area(p_out, end[:, None])
            s_out_q = p_out_q / wall.pressure_slope(s_out, end[:, None])
            m_out = q_out**2 / s_out

            def behind(cell: Any, outlet: Any) -> Any:
                return jnp.concatenate([cell[:, 1:], outlet], axis=1)

            s_b, p_b, m_b = behind(area, s_out), behind(p, p_out), behind(m, m_out)
            s_b_q = behind(jnp.full_like(area, k), s_out_q)
            p_b_q = behind(p_enter, p_out_q)
            m_b_q = behind(m_enter, (2.0 * q_out - m_out * s_out_q) / s_out)
            nothing = jnp.zeros_like(q_out)
            s_b_next = behind(jnp.full_like(area, -k), nothing)
            p_b_next, m_b_next = behind(-p_enter, nothing), behind(m_leave, nothing)

            s = harmonic_mean(area, s_b)
            gradient = (p_b - p) / width
            widening = (faces / s) ** 2
            loss = (viscous + turbulent * jnp.abs(q)) * q * widening
            bend = jnp.diff(flow, 2, axis=1) / dz**2
            bend = jnp.concatenate([bend, bend[:, -1:]], axis=1)
            rate = -convection * (m_b - m) / width - s / rho * (gradient + loss) + nu * bend

            rate_s = (loss - gradient) / rho
            s_before, s_behind = 0.5 * (s / area) ** 2, 0.5 * (s / s_b) ** 2
            resistance = (viscous + 2.0 * turbulent * jnp.abs(q)) * widening
            stiff, inert, diffusion = s / (rho * width), convection / width, nu / dz**2
            before = inert * m_enter + stiff * p_enter + rate_s * s_before * k + diffusion
            own_face = (
                inert * (m_leave - m_b_q)
                - stiff * (p_enter + p_b_q)
                + rate_s * (s_behind * s_b_q - s_before * k)
                - s / rho * resistance
                - 2.0 * diffusion
            )
            next_face = -inert * m_b_next - stiff * p_b_next + rate_s * s_behind * s_b_next
            return rate, before, own_face, next_face + diffusion

        def solve(known: _Fields, q_in: Any, guess: Any) -> Any:
            """Solve y = known + own·f(y) for the flows; the areas follow from them."""

            def unfold(q: Any) -> Any:
                flow = jnp.concatenate([q_in[:, None], q], axis=1)
                return flow, known.area - k * jnp.diff(flow, axis=1)

            def newton(carry: Any) -> Any:
                q, _, iteration = carry
                flow, area = unfold(q)
                rate, before, own_face, next_face = balance(flow, area, known.capacitor)
                residual = q - known.flow[:, 1:] - own * rate
                update = tridiagonal_solve(
                    (-own * before).at[:, 0].set(0.0),
                    1.0 - own * own_face,
                    (-own * next_face).at[:, -1].set(0.0),
                    -residual[:, :, None],
                )[:, :, 0]
                q = q + update
                # Relative to the case's own flow.
                scale = jnp.abs(q).max(axis=1, keepdims=True) + 1e-3
                return q, jnp.abs(update) / scale, iteration + 1

            def unfinished(carry: Any) -> Any:
                _, update, iteration = carry
                return (iteration < _MAX_NEWTON) & jnp.any(update.max(axis=1) > _NEWTON_TOLERANCE)

            start = (guess, jnp.full_like(guess, jnp.inf), 0)
            q, update, _ = jax.lax.while_loop(unfinished, newton, start)
            flow, area = unfold(q)
            # NaN compares false, so that it counts as bad.
            good = (area > 0.0) & (update <= _NEWTON_TOLERANCE)
            return _Fields(area, flow, capacitor(known.capacitor, q[:, -1])), good.all(axis=1)

        # Of both implicit stages: how the slopes at the start of the step and at the
        # stage before weigh in, and the time since the stage before.
        w = _WEIGHT * dt
        weigh_start, weigh_before = jnp.array([own, w]), jnp.array([0.0, w])
        elapsed = jnp.array([2.0 * own, dt - 2.0 * own])

        def step(state: _State, inputs: Any) -> Any:
            number, q_in = inputs

            def stage(latest: tuple[_Fields, _Fields], inputs: Any) -> Any:
                at_start, at_before, time, q_in = inputs
                before, slope = latest
                known = jax.tree.map(
                    lambda y, k_start, k_before: y + at_start * k_start + at_before * k_before,
                    state.now,
                    state.slope,
                    slope,
                )
                # As if the tube were rigid, its whole flow follows the inlet's: a guess
                # that holds for a sudden start, too.
                guess = before.flow + time * slope.flow
                guess = guess[:, 1:] + (q_in[:, None] - guess[:, :1])
                found, good = solve(known, q_in, guess)
                slope = jax.tree.map(lambda y, y_known: (y - y_known) / own, found, known)
                return (found, slope), (good, net_inflow(found))

            (now, slope), (good, net) = jax.lax.scan(
                stage, (state.now, state.slope), (weigh_start, weigh_before, elapsed, q_in)
            )
            inflow = state.inflow + w * (net_inflow(state.now) + net[0]) + own * net[1]
            # The place of a failure: where the state before it was strained most.
            strain = jnp.abs(jnp.log(jnp.abs(state.now.area / cells)))
            place = jnp.stack([jnp.full(len(cells), number), jnp.argmax(strain, axis=1)], axis=1)
            first = ~good.all(axis=0) & (state.broken[:, 0] < 0)
            broken = jnp.where(first[:, None], place, state.broken)
            return _State(now, slope, inflow, broken), None

        def net_inflow(fields: _Fields) -> Any:
            return fields.flow[:, 0] - fields.flow[:, -1]

        def instant(state: _State, inputs: Any) -> Any:
            flow = state.now.flow
            out = state.now.capacitor + proximal * flow[:, -1]
            p = wall.pressure(state.now.area, cells)
            inner = 0.5 * (p[:, :-1] + p[:, 1:])
            first = 1.5 * p[:, :1] - 0.5 * p[:, 1:2]
            record = (flow, jnp.concatenate([first, inner, out[:, None]], axis=1))
            state, _ = jax.lax.scan(step, state, inputs)
            return state, record

        numbers = jnp.arange(inflow.shape[0] * inflow.shape[1]).reshape(inflow.shape[:2])
        return jax.lax.scan(instant, state, (numbers, inflow))

    compiled: Callable[..., tuple[_State, tuple[Any, Any]]] = jax.jit(cycle)
    return compiled


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
            "%d of %d cases still change from cycle to cycle, case %d by %.1e; use more cycles.",
            len(late),
            len(periodicity),
            int(late[0]),
            float(periodicity[late[0]]),
        )
