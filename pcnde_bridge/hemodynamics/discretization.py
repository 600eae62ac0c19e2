"""Discretization of the 1D solver: checked input on its grid and at its time steps."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import (
    all_of,
    check_shape,
    check_values,
    finite,
    finite_array,
    finite_vector,
)
from pcnde_bridge.data.labels import check_labels
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import Outlet, check_outlet
from pcnde_bridge.hemodynamics.settings import TubeSettings
from pcnde_bridge.hemodynamics.waveform import Waveform

Labels = pd.DataFrame | Mapping[str, Any] | None
Inlet = Literal["flow", "pressure"]

GAMMA = 2.0 - math.sqrt(2.0)
"""Time of the first implicit stage of TR-BDF2, as a fraction of the step."""

_LARGEST_AREA_RATIO = 2.5  # of S_u between neighboring points
_PER_HARMONIC = 8  # time steps per period, and points per length, of the shortest wave
_SMALLEST_AMPLITUDE = 1e-3  # of the mean flow plus the largest amplitude


class Inputs(NamedTuple):
    """Vessels and boundary conditions of all cases: arrays that the compiled solver takes.

    Attributes
    ----------
    area_undeformed : array of shape (case, z)
        S_u, cm².
    wall : dict of arrays of shape (case, z)
        Parameters of the wall law.
    inlet : array of shape (case, stage)
        Flow, mL/s, or pressure, dyn/cm², at the inlet at both stages of every step of a cycle.
    outlet : dict of arrays of shape (case, 1) or (case, stage)
        Values of the outlet.
    initial_pressure : array of shape (case, 1)
        Pressure at rest, dyn/cm².
    """

    area_undeformed: Any
    wall: dict[str, Any]
    inlet: Any
    outlet: dict[str, Any]
    initial_pressure: Any


class Narrowings(NamedTuple):
    """Stenoses of all cases, s for each case; those that a case has not have no spread.

    Attributes
    ----------
    friction : array of shape (case, z)
        Fraction of the stretch around each face on which the wall's own friction acts.
    spread : array of shape (case, s, z)
        Fraction of the loss that falls on the stretch around each face, per length.
    upstream : integer array of shape (case, s)
        Index of the point at which S_u is S_D.
    blockage, length : array of shape (case, s)
        Fraction of area, and length, cm.
    """

    friction: Any
    spread: Any
    upstream: Any
    blockage: Any
    length: Any


class Blood(NamedTuple):
    """Numbers common to all cases, see :class:`~pcnde_bridge.hemodynamics.solver.Tube1D`."""

    density: Any
    viscosity: Any
    profile_exponent: Any
    convection: Any  # momentum correction α
    turbulent_coefficient: Any
    dz: Any  # length of a cell, cm
    dt: Any  # time step, s


class Form(NamedTuple):
    """Form of the equations, for which the solver is compiled."""

    wall: type[Any]
    outlet: type[Outlet]
    pressure_inlet: bool
    effective_length: bool
    n_times: int


@dataclass(frozen=True)
class Problem:
    """Checked input of the solver for several cases; the points are the faces of n cells.

    Attributes
    ----------
    z : array of shape (n + 1,)
        Points, cm.
    inputs, narrowings, blood, form
        Numbers and form of the discrete equations.
    period : float
        Length of the cycle, s.
    labels : DataFrame
        Labels of the cases.
    """

    z: Array
    inputs: Inputs
    narrowings: Narrowings
    blood: Blood
    form: Form
    period: float
    labels: pd.DataFrame


def case_name(case: int, labels: pd.DataFrame) -> str:
    """Name a case in a message."""
    known = ", ".join(f"{name} {labels[name][case]}" for name in ("geometry", "waveform"))
    return f"case {case} ({known})"


def on_grid(
    vessels: Sequence[Vessel], waveforms: Sequence[Waveform], n_points: int, labels: Labels = None
) -> dict[str, Any]:
    """Return idealized vessels, and their labels, as arguments of :func:`discretize`.

    Without labels, the different vessels are numbered from 1 and the waveforms from 0.  A vessel
    that is repeated with the same waveform, at another outlet, is another geometry each time.
    """
    vessels = all_of(Vessel, "vessels", vessels)
    waveforms = all_of(Waveform, "waveforms", waveforms)
    if not vessels:
        raise InputError("There is no vessel to solve; give at least one.")
    for i, vessel in enumerate(vessels):
        if vessel.length != vessels[0].length:
            lengths = f"{vessel.length:g} cm long, vessel 0 {vessels[0].length:g} cm"
            raise InputError(f"Vessel {i} is {lengths}; solve one length in a batch.")
    if labels is None:
        pairs = pd.DataFrame({"vessel": pd.Series(vessels), "waveform": pd.Series(waveforms)})
        pairs["copy"] = pairs.groupby(["vessel", "waveform"], sort=False).cumcount()
        labels = {
            "geometry": pairs.groupby(["vessel", "copy"], sort=False).ngroup() + 1,
            "waveform": pairs.groupby("waveform", sort=False).ngroup(),
        }
    if isinstance(labels, Mapping | pd.DataFrame) and "blockage" not in labels:
        labels = {**labels, "blockage": [vessel.blockage for vessel in vessels]}
    z = vessels[0].grid(n_points)
    area = np.array([vessel.area_undeformed(z) for vessel in vessels])
    stenoses = [vessel.stenoses for vessel in vessels]
    return {"z": z, "area_undeformed": area, "stenoses": stenoses, "labels": labels}


def discretize(
    tube: TubeSettings,
    z: npt.ArrayLike,
    area_undeformed: npt.ArrayLike,
    waveforms: Sequence[Waveform],
    outlet: Outlet,
    *,
    stenoses: Sequence[Sequence[Stenosis]] | None = None,
    initial_pressure: npt.ArrayLike | None = None,
    labels: Labels = None,
    inlet: Inlet = "flow",
) -> Problem:
    """Check the input of :meth:`~pcnde_bridge.hemodynamics.solver.Tube1D.solve`, discretize it.

    Raises
    ------
    InputError
        If the input is not usable, the grid too coarse, or the time step too long.
    """
    points = _check_points(z)
    area = finite_array("area_undeformed", area_undeformed)
    n_cases = max(len(area), 1) if area.ndim else 1
    check_shape("area_undeformed", area, (n_cases, len(points)), "case, z")
    check_values("area_undeformed", area, area <= 0.0, "areas must be positive (cm²)")
    waveforms = all_of(Waveform, "waveforms", waveforms)
    given = all_of(object, "stenoses", [()] * n_cases if stenoses is None else stenoses)
    narrowings = [all_of(Stenosis, f"stenoses[{i}]", several) for i, several in enumerate(given)]
    for name, count in (("waveforms", len(waveforms)), ("stenoses", len(narrowings))):
        if count != n_cases:
            raise InputError(f"{name} must have an entry for each of {n_cases} cases, got {count}.")
    table = _check_labels(labels, area)
    ratio = np.exp(np.abs(np.diff(np.log(area), axis=1)))
    for i, k in np.argwhere(ratio > _LARGEST_AREA_RATIO)[:1]:
        raise InputError(
            f"The grid is too coarse: area_undeformed of {case_name(i, table)} changes "
            f"{ratio[i, k]:.2f}-fold between z = {points[k]:g} and {points[k + 1]:g} cm, "
            f"{_LARGEST_AREA_RATIO:g}-fold at most can be resolved; use more points."
        )
    if inlet not in get_args(Inlet):
        raise InputError(f"inlet must be 'flow' or 'pressure', got {inlet!r}.")
    check_outlet(outlet)
    period = waveforms[0].period
    wall = _wall_parameters(tube, area)
    pressure, speed = _check_initial_pressure(tube, area, initial_pressure)
    for i, waveform in enumerate(waveforms):
        waveform.check_period(f"waveforms[{i}]", period)
        _check_resolution(tube, i, waveform, points, speed[i])
        if inlet == "flow":
            _check_speed(tube, points, area, waveform, i, table)
    dt = period / tube.steps
    stages = (dt * (np.arange(tube.steps)[:, None] + np.array([GAMMA, 1.0]))).ravel()
    impedance = tube.density * speed[:, -1] / tube.wall.area(pressure, area)[:, -1]
    boundary = outlet.values(n_cases, stages, period, impedance)
    driven = np.array([waveform.flow(stages) for waveform in waveforms])
    inputs = Inputs(area, wall, driven, boundary, pressure)
    losses = _narrowings(tube, points, narrowings, table)
    steps = (points[-1] - points[0]) / (len(points) - 1), dt
    flow = tube.density, tube.viscosity, tube.profile_exponent, tube.convection
    blood = Blood(*map(float, (*flow, tube.turbulent_coefficient, *steps)))
    effective = tube.stenosis_loss == "effective_length"
    form = Form(type(tube.wall), type(outlet), inlet == "pressure", effective, tube.n_times)
    return Problem(points, inputs, losses, blood, form, period, table)


def _check_labels(labels: Labels, area: Array) -> pd.DataFrame:
    for name in SOLVER_LABELS:
        if isinstance(labels, Mapping | pd.DataFrame) and name in labels:
            what = "which is the name of a column that the solver adds"
            raise InputError(f"labels has a column {name!r}, {what}; rename it.")
    return check_labels(labels, area)


def _wall_parameters(tube: TubeSettings, area: Array) -> dict[str, Array | None]:
    """Return the parameters of the wall law, each (case, z); a wall without viscosity has no τ."""
    found: dict[str, Array | None] = {}
    for field in fields(tube.wall):
        value = getattr(tube.wall, field.name)
        try:
            found[field.name] = None if value is None else np.broadcast_to(value, area.shape)
        except ValueError:
            raise InputError(
                f"wall.{field.name} has the shape {np.shape(value)}, which does not broadcast to "
                f"(case, z) = {area.shape}."
            ) from None
    if not np.any(found["retardation_time"]):
        found["retardation_time"] = None
    return found


def _check_points(z: npt.ArrayLike) -> Array:
    points = finite_vector("z", z)
    if len(points) < 4:
        raise InputError(f"The grid is too coarse: z must have 4 points, got {len(points)}.")
    steps, mean = np.diff(points), (points[-1] - points[0]) / (len(points) - 1)
    wrong = ~(np.abs(steps - mean) <= 1e-6 * abs(mean)) | (steps <= 0.0)
    rule = f"points must have equal steps; their mean is {mean:g} cm"
    check_values("z", points[1:], wrong, rule, offset=1)
    return points


def _check_resolution(
    tube: TubeSettings, i: int, waveform: Waveform, z: Array, wave_speed: Array
) -> None:
    """Raise if time step or grid does not resolve the highest harmonic."""
    amplitude = np.hypot(waveform.cosine, waveform.sine)
    smallest = _SMALLEST_AMPLITUDE * (abs(waveform.mean) + amplitude.max(initial=0))
    highest = 1 + int(np.max(np.flatnonzero(amplitude > smallest), initial=-1))
    if tube.steps < _PER_HARMONIC * highest:
        raise InputError(
            f"The time step is too long: waveforms[{i}] has {highest} harmonics, which need "
            f"at least {_PER_HARMONIC * highest} steps per cycle, not {tube.steps}."
        )
    length = float(wave_speed.min()) * waveform.period / max(highest, 1)
    least = math.ceil(_PER_HARMONIC * (z[-1] - z[0]) / length) + 1
    if highest and len(z) < least:
        raise InputError(
            f"The grid is too coarse: waveforms[{i}] has {highest} harmonics, the shortest with "
            f"waves of {length:.3g} cm, which need at least {least} points, not {len(z)}."
        )


def _check_speed(
    tube: TubeSettings, z: Array, areas: Array, waveform: Waveform, i: int, labels: pd.DataFrame
) -> None:
    """Raise if a flow is faster than the pulse wave, which the scheme does not support."""
    narrowest = int(np.argmin(areas[i]))
    speed = np.abs(waveform.samples(tube.steps)).max() / areas[i, narrowest]
    wave_speed = float(tube.wall.wave_speed(areas, areas, tube.density)[i, narrowest])
    if speed >= wave_speed:
        raise InputError(
            f"The flow would be faster than the pulse wave: {speed:.0f} against {wave_speed:.0f} "
            f"cm/s in {case_name(i, labels)} at z = {z[narrowest]:g} cm; lower the flow or the "
            "blockage."
        )


def _check_initial_pressure(
    tube: TubeSettings, area: Array, pressure: npt.ArrayLike | None
) -> tuple[Array, Array]:
    """Return the pressure at rest, (case, 1), and its wave speed, (case, z)."""
    given = tube.wall.reference_pressure if pressure is None else pressure
    scalar = np.ndim(given) == 0
    given = finite("initial_pressure", given, "dyn/cm²") if scalar else given
    rest = finite_array("initial_pressure", given)
    if pressure is None:  # of the wall, which has one value, or varies along z
        rest = np.broadcast_to(rest, area.shape)[:, :1]
    elif rest.size in (1, len(area)) and rest.ndim < 2:
        rest = np.broadcast_to(rest.reshape(-1, 1), (len(area), 1))
    else:
        wanted = f"one number or one for each of {len(area)} cases"
        raise InputError(f"initial_pressure must be {wanted}, got shape {rest.shape}.")
    with np.errstate(divide="ignore", invalid="ignore"):
        area_at_rest = tube.wall.area(rest, area)
        speed = tube.wall.wave_speed(np.abs(area_at_rest), area, tube.density)
    wrong = ~((area_at_rest > 0.0) & np.isfinite(area_at_rest) & np.isfinite(speed) & (speed > 0.0))
    for case in np.flatnonzero(wrong.any(axis=1))[:1]:
        reason = "is outside the wall law's range, or would collapse or burst the wall"
        raise InputError(f"initial_pressure = {rest[case, 0]:g} dyn/cm² {reason}.")
    return rest, speed


def _narrowings(
    tube: TubeSettings, z: Array, stenoses: Sequence[Sequence[Stenosis]], labels: pd.DataFrame
) -> Narrowings:
    """Return the stenoses in which the loss of Seeley and Young replaces the wall's friction."""
    dz, centers = (z[-1] - z[0]) / (len(z) - 1), (z[1:] + z[:-1]) / 2
    # The momentum of a face is balanced from cell center to cell center, and on the
    # first and last face from or to the end.
    left, right = np.append(z[0], centers), np.append(centers, z[-1])
    shape = len(stenoses), max(1, *(len(several) for several in stenoses))
    found = Narrowings(
        np.ones((shape[0], len(z))),
        np.zeros((*shape, len(z))),
        np.zeros(shape, int),
        np.zeros(shape),
        np.ones(shape),
    )
    for i, several in enumerate(stenoses):
        for k, stenosis in enumerate(several):
            _check_stenosis(stenosis, z, dz, tube.stenosis_loss, case_name(i, labels))
            if tube.stenosis_loss == "none":
                continue
            found.friction[i] -= _share(left, right, stenosis)
            found.spread[i, k] = _spread(left, right, stenosis)
            found.upstream[i, k] = upstream_point(z, stenosis.start)
            found.blockage[i, k], found.length[i, k] = stenosis.blockage, stenosis.length
    return found._replace(friction=np.maximum(found.friction, 0.0))


def _check_stenosis(stenosis: Stenosis, z: Array, dz: float, loss: str, name: str) -> None:
    if loss != "none" and not stenosis_fits(stenosis, z):
        raise InputError(
            f"A stenosis of {name} reaches from {stenosis.start:g} to {stenosis.end:g} cm, "
            f"too close to the ends of the tube ({z[0]:g} … {z[-1]:g} cm)."
        )
    if stenosis.length < 4 * dz:
        raise InputError(
            f"The grid is too coarse: the stenosis of {name} at {stenosis.position:g} cm "
            f"is shorter than 4 cells of {dz:g} cm; use more points."
        )


def stenosis_fits(stenosis: Stenosis, z: Array) -> bool:
    """Return whether the loss of a stenosis falls on faces that balance momentum."""
    return bool(stenosis.start >= (z[0] + z[1]) / 2 and stenosis.end <= z[-1])


def _share(left: Array, right: Array, stenosis: Stenosis) -> Array:
    """Fraction of each stretch from left to right that lies in the stenosis."""
    overlap = np.minimum(right, stenosis.end) - np.maximum(left, stenosis.start)
    return np.asarray(np.maximum(overlap, 0.0) / (right - left))


def _spread(left: Array, right: Array, stenosis: Stenosis) -> Array:
    """Fraction of the stenosis's loss that falls on each stretch, per length.

    The density is (1 + cos 2πx/L_s)/L_s, the shape of the narrowing itself; its
    integral is exact, so that the total loss does not depend on the grid.
    """

    def upstream_of(z: Array) -> Array:
        x = np.clip((z - stenosis.position) / stenosis.length, -0.5, 0.5)
        return np.asarray(0.5 + x + np.sin(2.0 * np.pi * x) / (2.0 * np.pi))

    return (upstream_of(right) - upstream_of(left)) / (right - left)


def upstream_point(z: Array, start: float) -> int:
    """Return the last point upstream of the stenosis that starts there: S_u there is S_D."""
    point = int(np.searchsorted(z, start + 1e-9 * (z[-1] - z[0]), side="right")) - 1
    return max(point, 0)
