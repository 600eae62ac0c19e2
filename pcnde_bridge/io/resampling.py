"""Selection of one cycle, and resampling to one grid on request."""

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import check_memory, positive, whole
from pcnde_bridge.data.variables import FIELDS
from pcnde_bridge.errors import InputError
from pcnde_bridge.io.vessel_results import VesselResults

_UNIFORM = 1e-4  # of a time step, as in Cases
_SAME = 1e-6  # of a period, or of an axis's length
_SAME_LENGTH = 1e-3  # of a vessel's length, for lengths that differ by rounding
_CLOSED = 0.05  # of a variable's range: largest difference between cycles
_NEAR = 0.25  # of a time step: saves of two cycles that are nearer than this are one
_FEWEST = 4  # time points of a cycle
_OVERSHOOT = 0.05  # of a variable's range, beyond the values that are resampled


def one_cycle(vessel: VesselResults, period: float | None) -> VesselResults:
    """Select the last complete cycle of a recording.

    Parameters
    ----------
    vessel : VesselResults
        Results in CGS units.
    period : float or None
        Length of the cycle, s; by default that of the file.

    Returns
    -------
    VesselResults
        If the period is known, the last cycle in the order of its phase, from 0 on; else
        the whole recording, which must be one cycle without its end point.

    Raises
    ------
    InputError
        If the recording is shorter than the period, not periodic, or not one cycle.
    """
    cycle = vessel.period if period is None else period
    if cycle is None:
        return _whole_recording(vessel)
    cycle = positive("period", cycle, "s")
    time, steps = vessel.time, np.diff(vessel.time)
    span, tolerance = float(np.ptp(time)), 1e-3 * float(steps.min())
    if span + steps.max() < cycle - tolerance:
        raise InputError(f"it covers {span:g} s, less than the period of {cycle:g} s.")
    last = np.flatnonzero(time > time[-1] - cycle + tolerance)
    # Of two saves at almost the same phase, the later one is used.
    near = time[last[0]] - (time[-1] - cycle) < _NEAR * float(np.median(steps))
    taken = last[1:] if near else last
    if taken.size < _FEWEST:
        few = f"{taken.size} time points only"
        raise InputError(f"a cycle of {cycle:g} s has {few}: correct it, or save more.")
    if not _repeats(vessel, last, cycle):
        raise InputError(
            f"it is not periodic: one period of {cycle:g} s before its end it differs from the end "
            f"by more than {_CLOSED:.0%} of its range. Correct the period, or simulate more cycles."
        )
    phase = np.mod(time[taken], cycle)
    phase[cycle - phase <= tolerance] = 0.0
    order = np.argsort(phase)
    return vessel.change(lambda values: values[taken[order]], time=phase[order], period=cycle)


def _whole_recording(vessel: VesselResults) -> VesselResults:
    """Return the recording as one cycle, with its period."""
    time, span, steps = vessel.time, float(np.ptp(vessel.time)), np.diff(vessel.time)
    if not _uniform(time):
        raise InputError(
            f"the time steps differ, from {steps.min():g} to {steps.max():g} s: pass the period, "
            "and time_points= (--period, --time-points) to resample."
        )
    ends = (np.abs(v[0] - v[-1]).max() <= _SAME * np.ptp(v) for v in vessel.variables().values())
    if all(ends) and np.ptp(vessel.flow[:, 0]) > 0:
        advice = f"Pass period={span:g} (--period {span:g}) to leave it out."
        raise InputError(f"the last time point repeats the first, one period later. {advice}")
    return dataclasses.replace(vessel, period=span * time.size / (time.size - 1))


def _repeats(vessel: VesselResults, last: npt.NDArray[np.intp], cycle: float) -> bool:
    """Compare the last cycle with the one before, as far as it was recorded.

    The earlier cycle is interpolated to the times one period before those of the last one.
    """
    from scipy.interpolate import CubicSpline

    time = vessel.time
    last = last[time[last] - cycle >= time[0] - _NEAR * np.diff(time).min()]
    return all(
        np.abs(CubicSpline(time, values)(time[last] - cycle) - values[last]).max(initial=0)
        <= _CLOSED * np.ptp(values)
        for values in vessel.variables().values()
    )


def _uniform(time: Array, period: float | None = None) -> bool:
    step = np.ptp(time) / (time.size - 1)
    equal = np.abs(time - time[0] - step * np.arange(time.size)).max() <= _UNIFORM * step
    return bool(equal and (period is None or abs(step * time.size - period) <= _SAME * period))


def on_time_points(vessel: VesselResults, time_points: int | None) -> VesselResults:
    """Resample one cycle to equal time steps, if asked to.

    Parameters
    ----------
    vessel : VesselResults
        One cycle with its period.
    time_points : int or None
        Number of time points; None keeps those of the results.

    Raises
    ------
    InputError
        If the time steps are not equal and no number is given.
    """
    time, period = vessel.time, vessel.period
    assert period is not None
    if _uniform(time, period) and time_points in (None, time.size):
        return vessel
    if time_points is None:
        raise InputError(
            f"{time.size} time points are not equal steps of the period of {period:g} s: pass "
            "time_points= (--time-points), such as 100, to resample."
        )
    _check_size(time_points, vessel.z.size)
    equal = time[0] + period / time_points * np.arange(time_points)
    return vessel.change(lambda values: _periodic(time, values, period, time_points), time=equal)


def _check_size(count: int, others: int) -> None:
    """Raise if the variables on so many time points or points do not fit into memory."""
    numbers = 2 * len(FIELDS) * count * others
    check_memory(f"Resampling to {count} values", numbers, "ask for fewer")


def _periodic(time: Array, values: Array, period: float, count: int) -> Array:
    """Resample (time, z) to equal steps of a period from the first time point."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample

    low, high = values.min(axis=0), values.max(axis=0)
    if not _uniform(time, period):
        closed = np.append(time, time[0] + period)
        spline = CubicSpline(closed, np.concatenate([values, values[:1]]), bc_type="periodic")
        fine = min(max(count, math.ceil(period / np.diff(closed).min())), 10_000)
        values = spline(time[0] + period / fine * np.arange(fine))
    resampled: Array = resample(values, count, axis=0)
    size, beyond = np.max(high - low), np.max([resampled - high, low - resampled])
    if beyond > _OVERSHOOT * size + 1e-9 * np.abs(values).max():
        raise InputError(
            f"resampling to {count} time points overshoots the values by {beyond:.3g}, and their "
            f"range is {size:.3g}: the cycle is not smooth. Ask for about as many time points as "
            "were saved, or save more often."
        )
    return resampled


def on_points(vessel: VesselResults, points: int | npt.ArrayLike | None) -> VesselResults:
    """Resample the vessel to other points by monotone cubic interpolation, if asked to.

    Parameters
    ----------
    vessel : VesselResults
        Results in CGS units.
    points : int, array of shape (z,) or None
        Number of equally spaced points, or the points, cm; None keeps those of the results.

    Raises
    ------
    InputError
        If the points are not usable or lie outside the vessel.
    """
    if points is None:
        return vessel
    from scipy.interpolate import PchipInterpolator

    first, last = vessel.z[0], vessel.z[-1]
    if np.ndim(points) == 0:
        count = whole("points", points, 3)
        _check_size(count, vessel.time.size)
        points = np.linspace(first, last, count)
    z, slack = np.asarray(points, dtype=np.float64), _SAME_LENGTH * np.ptp(vessel.z)
    if z.ndim != 1 or z.min() < first - slack or z.max() > last + slack:
        raise InputError(f"points must lie within the vessel, from {first:g} to {last:g} cm.")
    inside = np.clip(z, first, last)

    def along(values: Array) -> Array:
        return np.asarray(PchipInterpolator(vessel.z, values, axis=-1)(inside))

    return vessel.change(along, area_undeformed=along(vessel.area_undeformed), z=z)


def match_length(vessel: VesselResults, first: VesselResults) -> VesselResults:
    """Take over the points of another vessel whose length differs by rounding only."""
    if abs(np.ptp(vessel.z) - np.ptp(first.z)) <= _SAME_LENGTH * np.ptp(first.z):
        return dataclasses.replace(vessel, z=first.z)
    return vessel


def check_same_grid(first: VesselResults, other: VesselResults) -> None:
    """Raise unless two vessels have the same variables, time points, points and thus period.

    Raises
    ------
    InputError
        If they differ; the message says what to do.
    """
    if (first.wall_shear_stress is None) != (other.wall_shear_stress is None):
        here, absent = (first, other) if other.wall_shear_stress is None else (other, first)
        raise InputError(
            f"{here.name} has a wall shear stress, but {absent.name} has none: make separate data "
            "sets of files with and without it."
        )
    for name, option in (("time", "time_points"), ("z", "points")):
        mine, theirs = getattr(first, name), getattr(other, name)
        if mine.shape != theirs.shape or not np.allclose(mine, theirs, 0, _SAME * np.ptp(mine)):
            raise InputError(
                f"{first.name} has {mine.size} values of {name} from {mine[0]:g} to {mine[-1]:g}, "
                f"{other.name} {theirs.size} from {theirs[0]:g} to {theirs[-1]:g}. Resample with "
                f"{option}= (--{option.replace('_', '-')}) if their number differs; vessels of "
                "other lengths or periods need separate data sets."
            )
