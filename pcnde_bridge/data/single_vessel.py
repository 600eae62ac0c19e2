"""Checks that results are those of one vessel over one cycle."""

from collections.abc import Mapping

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.balances import lag
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import InputError

_LONE = 12.0  # ratio of deviations from neighbors, without a damaged sample up to 7.5 (3D data)
_GAP = 3.0  # times those within a waveform; whole cycles have up to 2.7, with kinks
_RESOLVED, _FINE = 16, 40  # time points that show the shape of a waveform, and its derivatives
_LAG = 0.04  # of the cycle; walls that creep are a little late
_LEAD = 0.16  # of the cycle; the wall shear stress of a large artery leads the flow by up to 1/8
_DRIFT = 0.04  # of the mean flow; the published averages lose up to 0.013 along the vessel
_OPPOSITE = 0.95  # correlation with the opposite sign
_TRANSPOSED = (
    "the arrays look transposed, (z, time) in place of (time, z): exchange their last two axes, "
    "np.swapaxes(array, -1, -2)."
)


def _is_constant(flow: Array) -> bool:
    return bool(np.ptp(flow) <= _DRIFT * np.abs(flow).mean())


def check_vessel(variables: Mapping[str, Array], z: Array, time: Array, flip: str) -> None:
    """Raise if results are not those of one vessel, or a time point is damaged.

    Parameters
    ----------
    variables : mapping of str to array of shape (time, z)
        Flow (mL/s), area (cm²) and others of one vessel over one cycle.
    z, time : array
        Points, cm, and time points, s.
    flip : str
        Advice for a flow that runs against z.

    Raises
    ------
    InputError
        See :func:`check_flow` and :func:`check_samples`; also if there are several equal cycles,
        if pressures are missing, if a variable is shifted in time or reversed, or if most of the
        wall shear stress points against the flow.
    """
    check_axes(variables["flow"])
    moving = [variables[n] for n in VARIABLES if np.ptp(variables[n], axis=0).all()]
    if moving and (cycles := equal_cycles(np.concatenate(moving, axis=1))) > 1:
        raise InputError(
            f"the recording has {cycles} equal cycles: give one, the first {len(time) // cycles} "
            "time points, and its period."
        )
    for name, values in variables.items():
        check_samples(name, values, time)
    lost = variables["pressure"] == 0
    lost &= ~lost.all(axis=0)
    others = variables["pressure"][~lost]
    if lost.any() and others.min() > 0.2 * np.median(others):
        row, at = np.argwhere(lost)[0]
        raise InputError(
            f"pressure is 0 at {time[row]:g} s (time point {row}, point {at}), and all others are "
            f"{others.min():.4g} or more: values are missing. Correct them, or interpolate them."
        )
    check_flow(variables["flow"], variables["area"], z, flip)
    stress = variables.get("wall_shear_stress", np.ones((1, 1)))
    if (usual := np.median(stress.mean(axis=0))) < 0:
        raise InputError(
            f"the wall shear stress points against the flow, its mean is {usual:.4g} dyn/cm² in "
            "the middle of its range: change its sign, or give its magnitude."
        )
    _check_phases(variables, z, time)
    for name in ("area", "pressure"):
        mean = np.abs(variables[name].mean(axis=0))
        missing, present = mean < 1e-3 * mean.max(), mean > 0.5 * mean.max()
        missing[1:-1] &= present[:-2] | present[2:]
        missing[[0, -1]] &= present[[1, -2]]
        if missing.any():
            at = int(missing.argmax())
            raise InputError(
                f"the mean {name} is {mean[at]:.4g} at z = {z[at]:.4g} cm (point {at}), but usual "
                "at the neighboring points: leave out the points without results."
            )


def _check_phases(variables: Mapping[str, Array], z: Array, time: Array) -> None:
    """Raise if pressure or flow is shifted in time against the area, or stress against the flow."""
    if _is_coarse(time):
        return
    volume = np.asarray(np.trapezoid(variables["area"], z, axis=1))
    flow = variables["flow"]
    growth = np.roll(volume, -1) - np.roll(volume, 1)
    shear = variables.get("wall_shear_stress", flow)
    for name, signal, of, cause, lead in (
        ("pressure", variables["pressure"].mean(axis=1), volume, "area of elastic walls", _LAG),
        ("flow", flow[:, 0] - flow[:, -1], growth, "area of elastic walls", _LAG),
        ("wall shear stress", shear.mean(axis=1), flow.mean(axis=1), "flow", _LEAD),
    ):
        if name == "flow" and _opposes(signal, of):
            raise InputError(
                "more flows out than in while the volume grows: the flow has the wrong sign, or z "
                "or time runs backward."
            )
        steps = lag(signal, of)
        if not -lead * len(time) <= steps <= _LAG * len(time):
            late = "late" if steps > 0 else "early"
            raise InputError(
                f"the {name} is {abs(steps) * (time[1] - time[0]):.3g} s too {late} for the "
                f"{cause}: give all variables from the same start of the cycle."
            )


def _opposes(signal: Array, other: Array) -> bool:
    """Return whether two periodic signals vary against each other."""
    one, two = signal - signal.mean(), other - other.mean()
    return bool(one @ two < -_OPPOSITE * np.linalg.norm(one) * np.linalg.norm(two))


def equal_cycles(values: Array) -> int:
    """Return how many equal cycles signals of shape (time, column) have; at most 5."""
    size, count = np.ptp(values, axis=0), len(values)
    for cycles in range(5, 1, -1):
        difference = np.abs(values - np.roll(values, count // cycles, axis=0))
        if count % cycles == 0 and (difference < 0.01 * size).all():
            return cycles
    return 1


def _is_coarse(time: Array) -> bool:
    """Return whether time points are few or in unequal steps."""
    return len(time) < _RESOLVED or bool(np.ptp(np.diff(time)) > 1e-3 * (time[1] - time[0]))


def check_samples(name: str, values: Array, time: Array, column: str = "point") -> None:
    """Raise if signals are not one cycle, or one time point does not belong to those around it.

    A time point is compared with the cubic through the two on either side; without it, all
    others must be much nearer to theirs.  Time points in unequal steps are not compared.

    Parameters
    ----------
    name : str
        Name of the signals, for the message.
    values : array of shape (time, column)
        Periodic signals.
    time : array of shape (time,)
        Time points, s, without the end of the cycle.
    column : str
        Name of the second axis, for the message.

    Raises
    ------
    InputError
        If there is a gap between the end and the start, a time point is damaged, or the time
        points are in the order of text.
    """
    if _is_coarse(time):
        return
    for first in (0, 1):
        by_text = np.argsort([str(number) for number in range(first, first + len(values))])
        if _roughness(values[np.argsort(by_text)]) < _roughness(values) / 4:
            raise InputError(
                f"the time points of {name} are in the order of text, 1, 10, 11, …: sort them by "
                "number."
            )
    floor = np.maximum(1e-4 * np.abs(values).max(axis=0), np.finfo(float).tiny)

    def deviation(of: Array) -> Array:
        before, after = (np.roll(of, n, axis=0) for n in (1, -1))
        beyond = np.roll(of, 2, axis=0) + np.roll(of, -2, axis=0)
        return np.asarray(of - (4 * (before + after) - beyond) / 6)

    off = deviation(values)
    worst, columns = np.abs(off).argmax(axis=0), np.arange(values.shape[1])
    size = np.abs(off[worst, columns])
    columns = columns[size > np.maximum(0.02 * np.ptp(values, axis=0), floor)]
    repaired = values.copy()
    repaired[worst[columns], columns] -= off[worst[columns], columns]
    lone = size[columns] > _LONE * np.abs(deviation(repaired[:, columns])).max(axis=0)
    for at in columns[lone]:
        row = worst[at]
        raise InputError(
            f"{name} is {values[row, at]:.4g} at {time[row]:g} s (time point {row}, {column} {at}),"
            f" and the time points around it give {repaired[row, at]:.4g}: a single sample is "
            "damaged. Correct it, or interpolate it."
        )
    gaps = _gaps(values, floor)
    if gaps[at := int(gaps.argmax())] > _GAP:
        raise InputError(
            f"the recording is not one cycle: {name} ends at {values[-1, at]:.4g} and begins at "
            f"{values[0, at]:.4g} ({column} {at}), a gap in its waveform. Correct the time points, "
            "or pass the period (--period)."
        )


def _roughness(values: Array) -> float:
    """Return the sum of squares of the second differences of periodic signals."""
    steps = values - np.roll(values, 1, axis=0)
    return float(np.square(steps - np.roll(steps, 1, axis=0)).sum())


def _gaps(values: Array, floor: Array) -> Array:
    """Return the gap between the end and the start of each signal over the largest within it.

    A gap is the step to the next time point, or its distance from both a line and a parabola
    through those on one side, or from both polynomials of degree 3 and 4, whichever side is nearer.
    """
    found: list[Array] = []
    difference = values
    for order in range(1, 6):
        # Distance of each point from the extrapolation of those before it.  Shifted by order - 1,
        # it is the distance of the point before from the extrapolation of those after that.
        difference = difference - np.roll(difference, 1, axis=0)
        size = np.abs(difference)
        jumps = np.minimum(size, np.roll(size, 1 - order, axis=0))
        found.append(jumps[0] / np.maximum(jumps[order:-2].max(axis=0), floor))
    step, line, parabola, cubic, quartic = found
    gaps = np.maximum(step, np.minimum(line, parabola))
    # Coarse samples of smooth signals are no polynomials of higher degree.
    return np.maximum(gaps, np.minimum(cubic, quartic)) if len(values) >= _FINE else gaps


def check_flow(flow: Array, area: Array, z: Array, flip: str) -> None:
    """Raise if the mean flow runs against z, or is not the same all along the vessel.

    Parameters
    ----------
    flow, area : array of shape (time, z)
        Flow rate, mL/s, and area, cm², of one vessel over one cycle.
    z : array of shape (z,)
        Points, cm.
    flip : str
        Advice for a flow that runs against z.

    Raises
    ------
    InputError
        If the flow is not that of one vessel; the message names the place.
    """
    mean, scale = flow.mean(axis=0), float(np.abs(flow).mean())
    tolerance = _DRIFT * scale
    inlet, middle = float(mean[0]), float(np.median(mean))
    if np.ptp(mean) <= tolerance:
        if middle < -1e-3 * scale:
            raise InputError(
                f"the flow runs against z, its mean is {inlet:.4g} mL/s at the first point. {flip}"
            )
        return
    worst = int(np.abs(mean - (inlet if abs(inlet - middle) <= tolerance / 2 else middle)).argmax())
    candidates = (
        (
            np.abs(flow).mean(axis=0),
            "Its sign seems to change along the vessel: give it one sign.",
        ),
        ((flow * area).mean(axis=0), "Probably these are velocities: flow × area is constant."),
        (mean[1:-1], "Probably it differs at the ends alone: leave out the end points."),
        (np.zeros(1), "Leave out branches, or give the part of one vessel without them."),
    )
    advice = next(text for values, text in candidates if _is_constant(values))
    raise InputError(
        f"the mean flow changes along the vessel: {middle:.4g} mL/s in the middle of its range, "
        f"but {mean[worst]:.4g} mL/s at z = {z[worst]:.4g} cm (point {worst}); at most "
        f"{_DRIFT:.0%} is what averaging leaves. {advice}"
    )


def check_axes(flow: Array) -> None:
    """Raise if a square array of the flow is (z, time) in place of (time, z)."""
    square = flow.shape[0] == flow.shape[1]
    if square and _is_constant(flow.mean(axis=1)) and not _is_constant(flow.mean(axis=0)):
        raise InputError(_TRANSPOSED)
