"""One cycle and one grid for the vessels of a data set; nothing is resampled unasked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import positive, whole
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError

if TYPE_CHECKING:
    from pcnde_bridge.io.vessel_results import VesselResults

_UNIFORM = 1e-4  # of a step, as in Cases
_SAME = 1e-6  # of a period, or of an axis's length
_SAME_LENGTH = 1e-3  # of a vessel's length, which may differ by rounding
_CLOSED = 0.05  # of a field's range: the end of a cycle may miss its start by that
_JUMP = 3.0  # times the largest step of a wave: its end does not lead to its start


def one_cycle(vessel: VesselResults, period: float | None) -> VesselResults:
    """Take the last whole cycle, at phases from 0 on if the period is known."""
    cycle = vessel.period if period is None else period
    time = vessel.time
    span, step = float(np.ptp(time)), float(np.diff(time).max())
    if cycle is None:
        if not _uniform(time):
            raise InputError(
                f"{vessel.name}: the time steps are not equal, from {np.diff(time).min():g} to "
                f"{np.diff(time).max():g} s: pass the period, and instants= (--period, "
                "--instants) to resample."
            )
        if _meets(vessel, 0, -1, 1e-6) and np.ptp(vessel.flow[:, 0]) > 0:
            raise InputError(
                f"{vessel.name}: the last instant repeats the first, one period later. Pass "
                f"period={span:g} (--period {span:g}), which leaves it out."
            )
        inflow = vessel.flow[:, 0]
        if abs(inflow[0] - inflow[-1]) > _JUMP * np.abs(np.diff(inflow)).max():
            raise InputError(
                f"{vessel.name} is not one cycle: the flow at its inlet ends at {inflow[-1]:.4g} "
                f"mL/s and begins at {inflow[0]:.4g}, which is no step of a smooth wave. Pass the "
                "period (--period)."
            )
        return dataclasses.replace(vessel, period=span * time.size / (time.size - 1))
    cycle = positive("period", cycle, "s")
    tolerance = 1e-3 * float(np.diff(time).min())
    if span + step < cycle - tolerance:
        raise InputError(f"{vessel.name} covers {span:g} s, less than the period of {cycle:g} s.")
    taken = np.flatnonzero(time > time[-1] - cycle + tolerance)
    before = taken[0] - 1
    compared = before >= 0 and abs(time[-1] - cycle - time[before]) <= tolerance
    if compared and not _meets(vessel, before, -1, _CLOSED):
        raise InputError(
            f"{vessel.name} is not periodic: one period of {cycle:g} s before its end it differs "
            f"from the end by more than {_CLOSED:.0%} of the cycle's range. Give the right period, "
            "or simulate more cycles."
        )
    phase = np.mod(time[taken], cycle)
    phase[cycle - phase <= tolerance] = 0.0
    order = np.argsort(phase)
    arrays: dict[str, Any] = {name: getattr(vessel, name)[taken[order]] for name in VARIABLES}
    return dataclasses.replace(vessel, **arrays, time=phase[order], period=cycle)


def _meets(vessel: VesselResults, one: int, other: int, tolerance: float) -> bool:
    """Whether two instants are alike, up to a part of each field's range."""
    return all(
        np.abs(field[one] - field[other]).max() <= tolerance * np.ptp(field)
        for field in (getattr(vessel, name) for name in VARIABLES)
    )


def _uniform(time: Array, period: float | None = None) -> bool:
    step = np.ptp(time) / (time.size - 1)
    equal = np.abs(time - time[0] - step * np.arange(time.size)).max() <= _UNIFORM * step
    return bool(equal and (period is None or abs(step * time.size - period) <= _SAME * period))


def on_instants(vessel: VesselResults, instants: int | None) -> VesselResults:
    """Resample the cycle to so many equal steps; refuse unequal ones unless asked to."""
    time, period = vessel.time, vessel.period
    assert period is not None
    if _uniform(time, period) and instants in (None, time.size):
        return vessel
    if instants is None:
        raise InputError(
            f"{vessel.name}: its {time.size} instants are not equal steps of the period of "
            f"{period:g} s: pass instants= (--instants), such as 100, to resample."
        )
    arrays: dict[str, Any] = {
        name: _periodic(time, getattr(vessel, name), period, instants) for name in VARIABLES
    }
    equal = time[0] + period / instants * np.arange(instants)
    return dataclasses.replace(vessel, **arrays, time=equal)


def _periodic(time: Array, values: Array, period: float, instants: int) -> Array:
    """Resample (time, z) to equal steps of a period from the first instant."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample

    if not _uniform(time, period):
        closed = np.concatenate([values, values[:1]])
        spline = CubicSpline(np.append(time, time[0] + period), closed, bc_type="periodic")
        shortest = np.diff(np.append(time, time[0] + period)).min()
        fine = min(max(instants, math.ceil(period / shortest)), 10_000)
        values = spline(time[0] + period / fine * np.arange(fine))
    resampled: Array = resample(values, instants, axis=0)
    return resampled


def on_points(vessel: VesselResults, points: int | npt.ArrayLike | None) -> VesselResults:
    """Resample the vessel to so many equally spaced points, or to these (cm), if asked to."""
    if points is None:
        return vessel
    if np.ndim(points) == 0:
        count = whole("points", points, 3)
        z = np.linspace(vessel.z[0], vessel.z[-1], count)
    else:
        z = np.asarray(points, dtype=np.float64)
        slack = _SAME_LENGTH * np.ptp(vessel.z)
        if z.ndim != 1 or z.min() < vessel.z[0] - slack or z.max() > vessel.z[-1] + slack:
            raise InputError(
                f"{vessel.name} reaches from z = {vessel.z[0]:g} to {vessel.z[-1]:g} cm; the "
                "points asked for must be a row of numbers inside."
            )
    along = _interpolator(vessel.z, np.clip(z, vessel.z[0], vessel.z[-1]))
    arrays: dict[str, Any] = {
        name: along(getattr(vessel, name)) for name in (*VARIABLES, "area_undeformed")
    }
    return dataclasses.replace(vessel, **arrays, z=z)


def _interpolator(old: Array, new: Array) -> Callable[[Array], Array]:
    from scipy.interpolate import PchipInterpolator

    return lambda values: np.asarray(PchipInterpolator(old, values, axis=-1)(new))


def of_length(vessel: VesselResults, first: VesselResults) -> VesselResults:
    """Give equally spaced points of a length that differs by rounding that of the first."""
    if abs(np.ptp(vessel.z) - np.ptp(first.z)) <= _SAME_LENGTH * np.ptp(first.z):
        return dataclasses.replace(vessel, z=first.z)
    return vessel


def check_grid(first: VesselResults, other: VesselResults) -> None:
    """Refuse vessels of another grid or period than the first."""
    for name, option in (("time", "instants"), ("z", "points")):
        mine, theirs = getattr(first, name), getattr(other, name)
        if mine.shape != theirs.shape or not np.allclose(mine, theirs, 0, _SAME * np.ptp(mine)):
            raise InputError(
                f"{first.name} has {mine.size} values of {name} from {mine[0]:g} to {mine[-1]:g}, "
                f"{other.name} {theirs.size} from {theirs[0]:g} to {theirs[-1]:g}: a data set has "
                f"one grid. Resample with {option}= (--{option}) where they differ in number; "
                "vessels of other lengths or periods need data sets of their own."
            )
    assert first.period is not None
    assert other.period is not None
    if not math.isclose(first.period, other.period, rel_tol=_SAME):
        raise InputError(
            f"The cycle of {first.name} takes {first.period:g} s, that of {other.name} "
            f"{other.period:g} s; a data set has one period."
        )
