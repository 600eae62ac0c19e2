"""What the 1D solver is asked to solve: checked, and brought to its grid."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import all_of, finite, real_array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.checks import UnitsWarning
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.pressure_losses import (
    effective_length,
    turbulent_drop,
    viscous_drop,
)
from pcnde_bridge.hemodynamics.tr_bdf2 import GAMMA, named
from pcnde_bridge.hemodynamics.waveform import Waveform

if TYPE_CHECKING:
    from pcnde_bridge.hemodynamics.solver import Tube1D, Windkessel

_LARGEST_AREA_RATIO = 2.5  # of S_u between neighbouring points
_STEPS_PER_HARMONIC = 8  # time steps per period of the highest harmonic


@dataclass(frozen=True)
class Problem:
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


def check_vessels(
    tube: Tube1D,
    vessels: Sequence[Vessel],
    waveforms: Sequence[Waveform],
    outlet: Windkessel,
    n_points: int,
    initial_pressure: float | None = None,
    labels: pd.DataFrame | Mapping[str, Any] | None = None,
) -> Problem:
    """Bring idealised vessels to the solver's grid; see :func:`check`."""
    vessels = all_of(Vessel, "vessels", vessels)
    waveforms = all_of(Waveform, "waveforms", waveforms)
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
        labels = _default_labels(vessels, waveforms)
    if isinstance(labels, Mapping | pd.DataFrame) and "blockage" not in labels:
        labels = {**labels, "blockage": [vessel.blockage for vessel in vessels]}
    area = np.array([vessel.area_undeformed(z) for vessel in vessels])
    stenoses = [vessel.stenoses for vessel in vessels]
    return check(tube, z, area, waveforms, outlet, stenoses, initial_pressure, labels)


def _default_labels(
    vessels: Sequence[Vessel], waveforms: Sequence[Waveform]
) -> dict[str, list[int]]:
    """One geometry per different vessel, one waveform label per different waveform.

    A vessel that comes again with the same waveform, at another outlet, is another
    geometry each time.
    """
    before: Counter[tuple[Vessel, Waveform]] = Counter()
    copies = []
    for vessel, waveform in zip(vessels, waveforms, strict=False):
        copies.append((vessel, before[vessel, waveform]))
        before[vessel, waveform] += 1
    shapes, inlets = list(dict.fromkeys(copies)), list(dict.fromkeys(waveforms))
    return {
        "geometry": [shapes.index(copy) for copy in copies],
        "waveform": [inlets.index(waveform) for waveform in waveforms],
    }


def check(
    tube: Tube1D,
    z: npt.ArrayLike,
    area_undeformed: npt.ArrayLike,
    waveforms: Sequence[Waveform],
    outlet: Windkessel,
    stenoses: Sequence[Sequence[Stenosis]] | None,
    initial_pressure: float | None,
    labels: pd.DataFrame | Mapping[str, Any] | None,
) -> Problem:
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
    waveforms = all_of(Waveform, "waveforms", waveforms)
    if len(waveforms) != n_cases:
        raise InputError(f"There are {len(waveforms)} waveforms for {n_cases} cases.")
    table = _labels(points, area, labels)
    ratio = np.exp(np.abs(np.diff(np.log(area), axis=1)))
    for i, k in np.argwhere(ratio > _LARGEST_AREA_RATIO)[:1]:
        raise InputError(
            f"The grid is too coarse: area_undeformed of {named(i, table)} changes "
            f"{ratio[i, k]:.2f}-fold "
            f"between z = {points[k]:g} and {points[k + 1]:g} cm, {_LARGEST_AREA_RATIO:g}-fold at "
            "most can be resolved; use more points."
        )
    period = _period(waveforms)
    if not isinstance(stenoses, Iterable | None):
        raise InputError(f"stenoses must be a sequence for every case, got {stenoses!r}.")
    all_stenoses = [()] * n_cases if stenoses is None else list(stenoses)
    if len(all_stenoses) != n_cases:
        raise InputError(f"stenoses has {len(all_stenoses)} entries for {n_cases} cases.")
    narrowings = [
        all_of(Stenosis, f"stenoses[{i}]", several) for i, several in enumerate(all_stenoses)
    ]
    _check_steps(tube, points, area, waveforms, table)

    rest = tube.wall.reference_pressure
    if initial_pressure is not None:
        rest = finite("initial_pressure", initial_pressure, "dyn/cm²")
    with np.errstate(divide="ignore"):
        area_at_rest = tube.wall.area(rest, area)
    if not (np.isfinite(area_at_rest) & (area_at_rest > 0.0)).all():
        raise InputError(f"initial_pressure = {rest:g} dyn/cm² would collapse or burst the wall.")
    slope = tube.wall.pressure_slope(area_at_rest, area)
    if not (np.isfinite(slope) & (slope > 0.0)).all():
        raise InputError(f"initial_pressure = {rest:g} dyn/cm² is outside the wall law's range.")

    viscous, turbulent = _losses(tube, points, area, narrowings, table)
    return Problem(
        points,
        area,
        _stage_inflow(tube, waveforms, period),
        _outlet(outlet, n_cases),
        viscous,
        turbulent,
        rest,
        period,
        table,
    )


def _labels(
    z: Array, area_undeformed: Array, labels: pd.DataFrame | Mapping[str, Any] | None
) -> pd.DataFrame:
    """Labels as the data set wants them, found wrong now rather than after computing."""
    for name in SOLVER_LABELS:
        if isinstance(labels, Mapping | pd.DataFrame) and name in labels:
            raise InputError(
                f"labels has a column named {name!r}, as the solver names one that it adds; leave "
                "it out or give it another name."
            )
    instants = 4
    area = np.repeat(area_undeformed[:, None], instants, axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitsWarning)
        rest = Cases(
            0 * area, area, 0 * area, area_undeformed, np.arange(instants), z, labels=labels
        )
    return rest.labels


def _finite(name: str, values: npt.ArrayLike) -> Array:
    array = real_array(name, values)
    for index in np.argwhere(~np.isfinite(array))[:1]:
        place = index.tolist() if array.ndim else ""
        raise InputError(f"{name}{place} is {array[tuple(index)]}; it must be finite.")
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


def _period(waveforms: Sequence[Waveform]) -> float:
    for i, waveform in enumerate(waveforms):
        if not math.isclose(waveform.period, waveforms[0].period, rel_tol=1e-12):
            raise InputError(
                f"waveforms[{i}] has a period of {waveform.period:g} s, waveforms[0] of "
                f"{waveforms[0].period:g} s; solve different periods in different batches."
            )
    return waveforms[0].period


def _check_steps(
    tube: Tube1D,
    z: Array,
    area_undeformed: Array,
    waveforms: Sequence[Waveform],
    labels: pd.DataFrame,
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
        where = f"{named(i, labels)} at z = {z[narrowest]:g} cm"
        wave_speed = float(tube.wall.wave_speed(smallest, smallest, tube.density))
        if speed >= wave_speed:
            raise InputError(
                f"The flow would be faster than the pulse wave: {speed:.0f} cm/s against "
                f"{wave_speed:.0f} cm/s in {where}; lower the flow or the blockage."
            )


def _outlet(outlet: Windkessel, n_cases: int) -> tuple[Array, ...]:
    from pcnde_bridge.hemodynamics.solver import Windkessel

    if not isinstance(outlet, Windkessel):
        raise InputError(
            f"outlet must be a Windkessel, got {outlet!r}; Windkessel(R) is a resistance."
        )
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
    tube: Tube1D,
    z: Array,
    area_undeformed: Array,
    stenoses: Sequence[Sequence[Stenosis]],
    labels: pd.DataFrame,
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
            if tube.stenosis_loss != "none" and not fits(stenosis, z):
                raise InputError(
                    f"A stenosis of {named(i, labels)} reaches from {stenosis.start:g} to "
                    f"{stenosis.end:g} cm, too close to the ends of the tube ({z[0]:g} … "
                    f"{z[-1]:g} cm)."
                )
            if stenosis.length < 4 * dz:
                raise InputError(
                    f"The grid is too coarse: the stenosis of {named(i, labels)} at "
                    f"{stenosis.position:g} cm is {stenosis.length:g} cm long, less than 4 cells "
                    f"of {dz:g} cm; use more points."
                )
        if tube.stenosis_loss == "none":
            continue
        shares = [_share(left, right, stenosis) for stenosis in several]
        viscous[i] *= 1.0 - np.minimum(sum(shares), 1.0)
        for stenosis in several:
            healthy = upstream_area(z, area_undeformed[i], stenosis.start)
            throat = healthy * (1.0 - stenosis.blockage)
            length = stenosis.length
            if tube.stenosis_loss == "effective_length":
                length = effective_length(length, throat)
            spread = _spread(left, right, stenosis)
            drop = viscous_drop(1.0, healthy, throat, length, tube.viscosity)
            viscous[i] += spread * drop * tube.friction_ratio
            turbulent[i] += spread * turbulent_drop(
                1.0, healthy, throat, tube.density, tube.turbulent_coefficient
            )
    return viscous, turbulent


def fits(stenosis: Stenosis, z: Array) -> bool:
    """Whether the loss of a stenosis falls on faces that balance momentum."""
    dz = (z[-1] - z[0]) / (len(z) - 1)
    return bool(stenosis.start >= z[0] + dz / 2 and stenosis.end <= z[-1])


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


def upstream_area(z: Array, area_undeformed: Array, start: float) -> float:
    """S_D: S_u at the last point that is not inside the stenosis that starts there."""
    point = int(np.searchsorted(z, start + 1e-9 * (z[-1] - z[0]), side="right")) - 1
    return float(area_undeformed[max(point, 0)])


def _stage_inflow(tube: Tube1D, waveforms: Sequence[Waveform], period: float) -> Array:
    """Inlet flow at both stages of every step of a cycle, (instant, step, stage, case)."""
    dt = period / tube.steps
    stages = dt * (np.arange(tube.steps)[:, None] + np.array([GAMMA, 1.0]))
    inflow = np.stack([waveform.flow(stages) for waveform in waveforms], axis=-1)
    return inflow.reshape(tube.n_times, tube.steps // tube.n_times, 2, len(waveforms))
