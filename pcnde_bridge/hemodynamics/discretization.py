"""Discretization of the 1D solver: checked input on its grid and at its time steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

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
from pcnde_bridge.hemodynamics.outlet import OutletElements, Windkessel
from pcnde_bridge.hemodynamics.pressure_losses import effective_length, turbulent_drop, viscous_drop
from pcnde_bridge.hemodynamics.settings import TubeSettings
from pcnde_bridge.hemodynamics.waveform import Waveform

Labels = pd.DataFrame | Mapping[str, Any] | None

GAMMA = 2.0 - math.sqrt(2.0)
"""Time of the first implicit stage of TR-BDF2, as a fraction of the step."""

_LARGEST_AREA_RATIO = 2.5  # of S_u between neighboring points
_STEPS_PER_HARMONIC = 8  # time steps per period of the highest harmonic
_SMALLEST_AMPLITUDE = 1e-3  # of the mean flow plus the largest amplitude


class Tube(NamedTuple):
    """Vessels and blood of all cases, and the steps in space and time.

    Attributes
    ----------
    cells, end : array of shape (case, n) and (case,)
        S_u in the cells and at the outlet, cm².
    viscous, turbulent : array of shape (case, n)
        Pressure loss around each face at S = S_u, per length and per Q or Q·|Q|.
    outlet : OutletElements
        Elements of the outlet.
    density, kinematic_viscosity, convection : float
        ρ (g/cm³), ν (cm²/s) and 1 + δ.
    dz, dt : float
        Length of a cell, cm, and time step, s.
    """

    cells: Any
    end: Any
    viscous: Any
    turbulent: Any
    outlet: OutletElements
    density: Any
    kinematic_viscosity: Any
    convection: Any
    dz: Any
    dt: Any


@dataclass(frozen=True)
class Problem:
    """Checked input of the solver for some cases; the points are the faces of n cells.

    Attributes
    ----------
    z : array of shape (n + 1,)
        Points, cm.
    area_undeformed : array of shape (case, n + 1)
        S_u, cm².
    inflow : array of shape (time, step, stage, case)
        Inlet flow of one cycle, mL/s.
    tube : Tube
        Numbers of the discrete equations.
    initial_pressure : float
        Pressure at rest, dyn/cm².
    period : float
        Length of the cycle, s.
    labels : DataFrame
        Labels of the cases.
    """

    z: Array
    area_undeformed: Array
    inflow: Array
    tube: Tube
    initial_pressure: float
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

    Without labels, numbers are assigned to the different vessels and waveforms.  A vessel that
    is repeated with the same waveform, at another outlet, is another geometry each time.
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
            "geometry": pairs.groupby(["vessel", "copy"], sort=False).ngroup(),
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
    outlet: Windkessel,
    stenoses: Sequence[Sequence[Stenosis]] | None = None,
    initial_pressure: float | None = None,
    labels: Labels = None,
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
    for name in SOLVER_LABELS:
        if isinstance(labels, Mapping | pd.DataFrame) and name in labels:
            what = "which is the name of a column that the solver adds"
            raise InputError(f"labels has a column {name!r}, {what}; rename it.")
    table = check_labels(labels, area)
    ratio = np.exp(np.abs(np.diff(np.log(area), axis=1)))
    for i, k in np.argwhere(ratio > _LARGEST_AREA_RATIO)[:1]:
        raise InputError(
            f"The grid is too coarse: area_undeformed of {case_name(i, table)} changes "
            f"{ratio[i, k]:.2f}-fold between z = {points[k]:g} and {points[k + 1]:g} cm, "
            f"{_LARGEST_AREA_RATIO:g}-fold at most can be resolved; use more points."
        )
    for i, waveform in enumerate(waveforms):
        _check_waveform(tube, i, waveform, waveforms[0].period)
        _check_speed(tube, points, area[i], waveform, case_name(i, table))
    if not isinstance(outlet, Windkessel):
        raise InputError(f"outlet must be a Windkessel, such as Windkessel(R), got {outlet!r}.")
    elements = outlet.elements(n_cases)
    pressure = _check_initial_pressure(tube, area, initial_pressure)
    vessels = 0.5 * (area[:, :-1] + area[:, 1:]), area[:, -1]
    losses = _losses(tube, points, area, narrowings, table)
    period = waveforms[0].period
    delta = 1.0 / (1.0 + tube.profile_exponent)  # of the momentum equation
    blood = tube.density, tube.kinematic_viscosity, 1.0 + delta
    steps = float(points[-1] - points[0]) / (len(points) - 1), period / tube.steps
    numbers = Tube(*vessels, *losses, elements, *blood, *steps)
    return Problem(points, area, _stage_inflow(tube, waveforms), numbers, pressure, period, table)


def _check_points(z: npt.ArrayLike) -> Array:
    points = finite_vector("z", z)
    if len(points) < 4:
        raise InputError(f"The grid is too coarse: z must have 4 points, got {len(points)}.")
    steps, mean = np.diff(points), (points[-1] - points[0]) / (len(points) - 1)
    wrong = ~(np.abs(steps - mean) <= 1e-6 * abs(mean)) | (steps <= 0.0)
    rule = f"points must have equal steps; their mean is {mean:g} cm"
    check_values("z", points[1:], wrong, rule, offset=1)
    return points


def _check_waveform(tube: TubeSettings, i: int, waveform: Waveform, period: float) -> None:
    if not math.isclose(waveform.period, period, rel_tol=1e-12):
        raise InputError(
            f"waveforms[{i}] has a period of {waveform.period:g} s, waveforms[0] of "
            f"{period:g} s; solve different periods in different batches."
        )
    amplitude = np.hypot(waveform.cosine, waveform.sine)
    smallest = _SMALLEST_AMPLITUDE * (abs(waveform.mean) + amplitude.max(initial=0))
    highest = 1 + int(np.max(np.flatnonzero(amplitude > smallest), initial=-1))
    if tube.steps < _STEPS_PER_HARMONIC * highest:
        raise InputError(
            f"The time step is too long: waveforms[{i}] has {highest} harmonics, which need "
            f"at least {_STEPS_PER_HARMONIC * highest} steps per cycle, not {tube.steps}."
        )


def _check_speed(
    tube: TubeSettings, z: Array, area_undeformed: Array, waveform: Waveform, name: str
) -> None:
    """Raise if a flow is faster than the pulse wave, which the scheme does not support."""
    narrowest = int(np.argmin(area_undeformed))
    smallest = area_undeformed[narrowest]
    speed = np.abs(waveform.samples(tube.steps)).max() / smallest
    wave_speed = float(tube.wall.wave_speed(smallest, smallest, tube.density))
    if speed >= wave_speed:
        raise InputError(
            f"The flow would be faster than the pulse wave: {speed:.0f} against {wave_speed:.0f} "
            f"cm/s in {name} at z = {z[narrowest]:g} cm; lower the flow or the blockage."
        )


def _check_initial_pressure(tube: TubeSettings, area: Array, pressure: float | None) -> float:
    if pressure is None:
        pressure = tube.wall.reference_pressure
    rest = finite("initial_pressure", pressure, "dyn/cm²")
    with np.errstate(divide="ignore", invalid="ignore"):
        area_at_rest = tube.wall.area(rest, area)
        slope = tube.wall.pressure_slope(np.abs(area_at_rest), area)
    if not all((np.isfinite(value) & (value > 0.0)).all() for value in (area_at_rest, slope)):
        reason = "is outside the wall law's range, or would collapse or burst the wall"
        raise InputError(f"initial_pressure = {rest:g} dyn/cm² {reason}.")
    return rest


def _losses(
    tube: TubeSettings,
    z: Array,
    area_undeformed: Array,
    stenoses: Sequence[Sequence[Stenosis]],
    labels: pd.DataFrame,
) -> tuple[Array, Array]:
    """Loss of pressure per length around each face, per Q and per Q·|Q|.

    Wall friction N·Q/S is written as the pressure gradient −ρ·N·Q/S², so that it
    scales with the area as the loss of a stenosis does, which replaces it there.
    """
    dz = (z[-1] - z[0]) / (len(z) - 1)
    # The momentum of a face is balanced from cell center to cell center, and on the
    # last face from the last center to the outlet.
    left = z[1:] - dz / 2
    right = np.append(z[1:-1] + dz / 2, z[-1])
    # Mean of 1/S_u² over that stretch, if linear between the points.
    inverse = area_undeformed**-2.0
    mean = 0.75 * inverse[:, 1:]
    mean[:, :-1] += (inverse[:, :-2] + inverse[:, 2:]) / 8
    mean[:, -1] += inverse[:, -2] / 4
    # N of the momentum equation, and its ratio to that of the parabolic profile.
    friction = -2.0 * math.pi * tube.kinematic_viscosity * (tube.profile_exponent + 2.0)
    friction_ratio = (tube.profile_exponent + 2.0) / 4.0
    viscous = -tube.density * friction * mean
    turbulent = np.zeros_like(viscous)
    for i, several in enumerate(stenoses):
        name = case_name(i, labels)
        for stenosis in several:
            if tube.stenosis_loss != "none" and not stenosis_fits(stenosis, z):
                raise InputError(
                    f"A stenosis of {name} reaches from {stenosis.start:g} to {stenosis.end:g} cm, "
                    f"too close to the ends of the tube ({z[0]:g} … {z[-1]:g} cm)."
                )
            if stenosis.length < 4 * dz:
                raise InputError(
                    f"The grid is too coarse: the stenosis of {name} at {stenosis.position:g} cm "
                    f"is shorter than 4 cells of {dz:g} cm; use more points."
                )
        if tube.stenosis_loss == "none":
            continue
        shares = [_share(left, right, stenosis) for stenosis in several]
        viscous[i] *= 1.0 - np.minimum(sum(shares), 1.0)
        for stenosis in several:
            healthy, length = upstream_area(z, area_undeformed[i], stenosis.start), stenosis.length
            throat = healthy * (1.0 - stenosis.blockage)
            if tube.stenosis_loss == "effective_length":
                length = effective_length(length, throat)
            spread = _spread(left, right, stenosis)
            drop = viscous_drop(1.0, healthy, throat, length, tube.viscosity)
            viscous[i] += spread * drop * friction_ratio
            blood = tube.density, tube.turbulent_coefficient
            turbulent[i] += spread * turbulent_drop(1.0, healthy, throat, *blood)
    return viscous, turbulent


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


def upstream_area(z: Array, area_undeformed: Array, start: float) -> float:
    """Return S_D: S_u at the last point upstream of the stenosis that starts there."""
    point = int(np.searchsorted(z, start + 1e-9 * (z[-1] - z[0]), side="right")) - 1
    return float(area_undeformed[max(point, 0)])


def _stage_inflow(tube: TubeSettings, waveforms: Sequence[Waveform]) -> Array:
    """Inlet flow at both stages of every step of a cycle, (time, step, stage, case)."""
    dt = waveforms[0].period / tube.steps
    stages = dt * (np.arange(tube.steps)[:, None] + np.array([GAMMA, 1.0]))
    inflow = np.stack([waveform.flow(stages) for waveform in waveforms], axis=-1)
    return inflow.reshape(tube.n_times, tube.steps // tube.n_times, 2, len(waveforms))
