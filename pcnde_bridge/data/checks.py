"""Checks of the arrays of a data set."""

import warnings
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.hdf5 import release
from pcnde_bridge._utils.validation import (
    check_finite,
    check_increasing,
    check_shape,
    check_values,
    counted,
    finite,
    naming,
    real_array,
)
from pcnde_bridge.data.plausibility import BALANCES, UnitsError, check_units, sizes_of
from pcnde_bridge.data.selection import batches_of
from pcnde_bridge.data.single_vessel import check_vessel
from pcnde_bridge.data.variables import FIELDS, VARIABLES
from pcnde_bridge.errors import InputError, PCNDEWarning

_AT_ONCE = 256  # cases whose values are in memory while data on disk are checked


class UnitsWarning(PCNDEWarning):
    """The magnitude of the numbers suggests that they are not in CGS units."""


def check_arrays(given: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Return copies of the arrays of a data set, by name.

    Raises
    ------
    InputError
        If an array does not hold real numbers, or has a wrong shape or invalid values.
    """
    arrays = {name: real_array(name, value) for name, value in given.items()}
    _check_shapes(arrays)
    for name, array in arrays.items():
        for rows in batches_of(len(array), _AT_ONCE):
            part = array[rows]
            check_finite(name, part, rows.start)
            if name in ("area", "area_undeformed"):
                check_values(name, part, part <= 0, "areas must be positive (cm²)", rows.start)
            release(array)
    check_increasing("z", arrays["z"], "cm")
    return arrays


def _check_shapes(arrays: Mapping[str, Array]) -> None:
    """Compare all shapes with the numbers of cases, time points and points."""
    for name, least in (("time", 4), ("z", 3)):
        if arrays[name].ndim != 1:
            raise InputError(f"{name} must have one axis, but its shape is {arrays[name].shape}")
        if (count := len(arrays[name])) < least:
            raise InputError(f"{name} has {counted(count, 'value')}; at least {least} are needed")
    n_times, n_points = len(arrays["time"]), len(arrays["z"])
    undeformed = arrays["area_undeformed"]
    n_cases = len(undeformed) if undeformed.ndim == 2 else 1
    check_shape("area_undeformed", undeformed, (n_cases, n_points), "case, z")
    if n_cases < 1:
        raise InputError("there is no case: area_undeformed has length 0 along its first axis")
    for name in FIELDS:
        if name in arrays:
            check_shape(name, arrays[name], (n_cases, n_times, n_points), "case, time, z")


def check_time(arrays: Mapping[str, Array], period: float | None) -> float:
    """Return the period, after checking that the time points divide it evenly.

    Raises
    ------
    InputError
        If the time points are not uniform or do not cover exactly one period.
    """
    time = arrays["time"]
    n_times = len(time)
    step = float(time[-1] - time[0]) / (n_times - 1)
    if step <= 0:
        raise InputError("time must increase (s), but its last value is not above its first")
    # A ten-thousandth of a step is the tolerance for times stored in single precision.
    off = np.abs(time - (time[0] + step * np.arange(n_times))) > 1e-4 * step
    check_values("time", time, off, f"time must have uniform steps (here {step:g} s)")
    cycle = n_times * step
    end_repeated = (
        "the last time point repeats the first, one period later; leave it out (time[:-1], "
        "flow[:, :-1], area[:, :-1], pressure[:, :-1])"
    )
    if period is None:
        fields = [arrays[name] for name in VARIABLES]
        closed = all(np.array_equal(field[:, 0], field[:, -1]) for field in fields)
        steady = all(np.array_equal(field[:, 0], field[:, 1]) for field in fields)
        if closed and not steady:
            raise InputError(f"{end_repeated}, or pass period= if it does not")
        return cycle
    period = finite("period", period, "s")
    if abs(cycle - period) <= 1e-6 * abs(period):
        return period
    if abs(cycle - step - period) <= 1e-3 * step:
        why = end_repeated
    elif abs(cycle + step - period) <= 1e-3 * step:
        why = "the last time point of the cycle is missing"
    else:
        why = "time must cover one period, without its end point"
    given = f"{n_times} time points in steps of {step:g} s give {cycle:g} s"
    raise InputError(f"period is {period:g} s, but {given}: {why}")


def check_plausible(
    arrays: Mapping[str, Array], stated: Mapping[str, str], *, strict: bool
) -> None:
    """Raise unless the arrays of a data set are plausible for single vessels in CGS units.

    Parameters
    ----------
    arrays : mapping of str to array
        Checked arrays of a data set, in CGS units.
    stated : mapping of str to str
        Units that the caller stated.
    strict : bool
        If False, warn of magnitudes, and accept any flow and any sample.  Unusual magnitudes in
        stated units are a warning, too.

    Raises
    ------
    InputError
        If magnitudes, the flow along a vessel or a sample are implausible; see
        :mod:`pcnde_bridge.data.plausibility`.
    """
    z, time, flip = arrays["z"], arrays["time"], "Change its sign, or reverse the points."
    for case in range(len(arrays["flow"]) if strict else 0):
        with naming(f"case {case}"):
            variables = {name: arrays[name][case] for name in FIELDS if name in arrays}
            check_vessel(variables, z, time, flip)
    parts = []
    for rows in batches_of(len(arrays["flow"]), _AT_ONCE):
        part = {name: a if name in ("time", "z") else a[rows] for name, a in arrays.items()}
        parts.append(sizes_of(**part))
        release(*arrays.values())
    sizes = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if strict:
        check_units(sizes, stated, unique=bool(arrays["flow"].any()))
    if stated or not strict:
        sizes = {name: size for name, size in sizes.items() if name not in BALANCES}
        try:
            check_units(sizes, {"shape": "area"})
        except UnitsError as error:
            text = f"{error.problem}." if stated else str(error)
            warnings.warn(text, UnitsWarning, stacklevel=3)
