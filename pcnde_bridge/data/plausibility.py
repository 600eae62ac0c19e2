"""Plausibility of vessels: magnitudes, units, and flow along the vessel.

The ranges cover arteries from 0.8 mm to 5 cm in diameter.
"""

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.balances import density, growth_of_volume
from pcnde_bridge.data.units import FACTORS, SYSTEMS, factors_to_cgs
from pcnde_bridge.errors import InputError

_VISCOSITY = 0.0377  # kinematic, cm²/s; 0.04 dyn·s/cm² over 1.06 g/cm³
_ROOT = math.sqrt(math.pi) / 2  # root of the area over the diameter
_ALONG = {"along": 1, "area": 0}
_SHEAR = {"wall_shear_stress": 1, "area": 1.5, "flow": -1}
_BALANCE = {"balance": 1, "flow": 1, "time": 1, "area": -1, "z": -1}
_INERTIA = {"inertia": 1, "pressure": 1, "time": 1, "area": 1, "flow": -1, "z": -1}


class _Range(NamedTuple):
    """Usual range of a number that is a product of powers of measured quantities.

    Outside ``least`` and ``most`` it is impossible, even if the units are stated.
    """

    name: str
    unit: str
    low: float
    high: float
    least: float
    most: float
    powers: Mapping[str, float]
    factor: float = 1.0

    def holds(self, low: float, high: float, units: Mapping[str, str]) -> bool:
        """Return whether two numbers are in the range if the quantities have these units."""
        powers = (FACTORS[n][unit] ** self.powers.get(n, 0) for n, unit in units.items())
        factor = math.prod(powers)
        return bool(self.low <= low * factor and high * factor <= self.high)


# Pressures of 20 … 195 mmHg: less than a factor of 10, so that Pa are never taken for dyn/cm².
# Poiseuille's wall shear stress, 4·μ·Q/(π·r³), is 0.32·_ROOT·Q/S^1.5 with μ = 0.04 poise.
# The published volumes grow by half of the difference of the flows; exact solutions have 1.
# The density is 0.91 to 1.28 for the published and the synthetic vessels, of blood 1.06 g/cm³;
# with radii of 0.2 cm in place of areas it is 1.6 times as large.
_REYNOLDS, _POISEUILLE = 1 / (_ROOT * _VISCOSITY), 1 / (0.32 * _ROOT)
_RANGES = (
    _Range("the mean pressure", " dyn/cm²", 2.67e4, 2.6e5, -1e5, 4e5, {"pressure": 1}),
    _Range("the mean flow", " mL/s", 0.01, 250, 0.002, 750, {"flow": 1}),
    _Range("the median undeformed area", " cm²", 5e-3, 20, 2e-3, 60, {"area": 1}),
    _Range("the length of the vessel", " cm", 0.2, 100, 0.05, 300, {"z": 1}),
    _Range("the length of the recording", " s", 0.25, 60, 0.08, 300, {"time": 1}),
    _Range("the area over the undeformed area", "", 0.75, 1.55, 0.2, 5, {"ratio": 1, "area": 0}),
    _Range("the largest of these along the vessel, over the least,", "", 1, 3, 1, 4, _ALONG),
    _Range("flow over area", " cm/s", 1, 100, 0.2, 400, {"flow": 1, "area": -1}),
    _Range("the Reynolds number", "", 4, 6000, 1.2, 2e4, {"flow": 1, "area": -0.5}, _REYNOLDS),
    _Range("the wall shear stress over Poiseuille's", "", 0.32, 3.1, 0.32, 5, _SHEAR, _POISEUILLE),
    _Range("the length over the diameter", "", 2.5, 100, 0.8, 300, {"z": 1, "area": -0.5}, _ROOT),
    _Range("inflow less outflow, over the growth of the volume,", "", *(0.3, 2.8) * 2, _BALANCE),
    _Range("the density by pressures and accelerations", " g/cm³", 0.75, 1.43, 0.4, 3, _INERTIA),
)
_LONE = 12.0  # ratio of deviations from neighbors, without a damaged sample up to 7.5 (3D data)
_GAP = 3.0  # times those within a waveform; whole cycles have up to 2.7, with kinks
_RESOLVED, _FINE = 16, 40  # time points that show the shape of a waveform, and its derivatives
_DRIFT = 0.04  # of the mean flow; the published averages lose up to 0.013 along the vessel
_TRANSPOSED = (
    "the arrays look transposed, (z, time) in place of (time, z): exchange their last two axes, "
    "np.swapaxes(array, -1, -2)."
)

BALANCES = {"balance", "inertia"}
"""Sizes that compare the variables with each other; unknown where nothing changes in time."""

_EXPLAINED = {*BALANCES, "along"}  # by :func:`check_vessel`

Sizes = dict[str, Array]
"""Measured quantities by name, one number for each vessel; NaN is unknown."""


def sizes_of(
    flow: Array,
    area: Array,
    pressure: Array,
    area_undeformed: Array,
    time: Array,
    z: Array,
    wall_shear_stress: Array | None = None,
) -> Sizes:
    """Measure the sizes of vessels.

    Parameters
    ----------
    flow, area, pressure : array of shape (case, time, z)
        Results in any units.
    area_undeformed : array of shape (case, z)
        Undeformed areas.
    time, z : array
        Time points and points.
    wall_shear_stress : array of shape (case, time, z), optional
        Results in any units.

    Returns
    -------
    dict of str to array of shape (case,)
        Sizes for :func:`check_units`.
    """
    sizes = input_sizes(flow, area_undeformed, float(np.ptp(z)), float(np.ptp(time)))
    undeformed = area_undeformed[:, None, :]
    sizes["pressure"] = pressure.mean(axis=(1, 2))
    ratios = (area / undeformed).mean(axis=1)
    sizes["ratio"] = np.median(ratios, axis=1)
    sizes["along"] = ratios.max(axis=1) / ratios.min(axis=1)
    if wall_shear_stress is not None:
        sizes["wall_shear_stress"] = np.median(np.abs(wall_shear_stress.mean(axis=1)), axis=1)
    for name, powers, values in (
        ("balance", _BALANCE, growth_of_volume(flow, area, time, z)),
        ("inertia", _INERTIA, density(flow, area, pressure, time, z)),
    ):
        # The other sizes in this product cancel, so that it is measured in their units.
        others = math.prod(sizes[other] ** powers[other] for other in powers if other != name)
        sizes[name] = np.divide(values, others, out=np.full_like(values, np.nan), where=others != 0)
    return sizes


def input_sizes(flow: Array, area_undeformed: Array, length: float, period: float) -> Sizes:
    """Measure the sizes of a prediction's inputs.

    Parameters
    ----------
    flow : array of shape (case, time, ...)
        Flow rate.
    area_undeformed : array of shape (case, z)
        Undeformed area.
    length, period : float
        Length of the vessel and of the cycle; NaN if unknown.
    """
    mean = np.abs(flow).reshape(len(flow), -1).mean(axis=1)
    count = len(flow)
    return {
        "flow": np.where(mean > 0, mean, np.nan),
        "area": np.median(area_undeformed, axis=1),
        "z": np.full(count, length),
        "time": np.full(count, period),
    }


class Advice(NamedTuple):
    """Advice for numbers whose units are wrong or ambiguous.

    Attributes
    ----------
    state : str
        Format of the advice to use the units ``{units}``, or ``{flags}`` at the command line.
    choose : str
        Advice where several units are possible.
    confirm : str
        Advice for numbers that are right as they are.
    """

    state: str
    choose: str
    confirm: str


OPTION = Advice(
    "pass units={units} (--units {flags})",
    "state the units (--units)",
    "pass units='cgs' (--units cgs)",
)
"""Advice where units can be stated by an option."""

CONVERT = Advice(
    "convert the arrays to CGS units", "convert the arrays to CGS units", "pass check=False"
)
"""Advice where arrays must be in CGS units."""


def check_units(
    sizes: Sizes, stated: Collection[str], advice: Advice, *, unique: bool = False
) -> None:
    """Raise if the units are wrong or, with ``unique``, ambiguous.

    Parameters
    ----------
    sizes : dict of str to array of shape (case,)
        Sizes of vessels, taken to be in CGS units.
    stated : collection of str
        Quantities whose units are stated; numbers of these alone need only be possible.
    advice : Advice
        Advice for the message.
    unique : bool
        Raise also if the numbers are usual in other units as well, but not if the
        variables do not go together in any units: :func:`check_vessel` may explain it.

    Raises
    ------
    InputError
        If a number is impossible, or unusual; the message suggests the units if only one
        combination of them makes all numbers usual.
    """
    open_ = [name for name in FACTORS if name in sizes and name not in stated]
    if "pressure" in open_ and (sizes["pressure"] < 0).any():
        raise InputError(
            f"the mean pressure is {sizes['pressure'].min():.4g}; pressures must be relative to "
            f"the surroundings, as blood pressures are. If they are, {advice.confirm}."
        )
    measured = []
    for usual, low, high in _measured(sizes):
        if usual.powers.keys() & {*open_}:
            measured.append((usual, low, high))
        elif unique and usual.powers.keys() & _EXPLAINED:
            continue  # start-up cycles need not balance
        elif low < usual.least or high > usual.most:
            wrong = low if low < usual.least else high
            raise InputError(
                f"with the stated units {usual.name} is {wrong:.4g}{usual.unit}, possible are "
                f"{usual.least:g} to {usual.most:g}. Correct the units (--units), or the numbers."
            )

    def all_usual(units: Mapping[str, str]) -> bool:
        return all(usual.holds(low, high, units) for usual, low, high in measured)

    right = all_usual({})
    if right and not unique:
        return
    others = [units for units in _combinations(open_) if units and all_usual(units)]
    if right and others:
        raise InputError(
            "the units are ambiguous: the numbers are usual in CGS units, and with "
            f"{_listed(others)}: {advice.choose}; if they are CGS, {advice.confirm}."
        )
    doubts = [
        f"{usual.name} is {low if low < usual.low else high:.4g}{usual.unit}, usual are "
        f"{usual.low:g} to {usual.high:g}"
        for usual, low, high in measured
        if not usual.holds(low, high, {})
        and (others or not unique or usual.powers.keys().isdisjoint(_EXPLAINED))
    ]
    if not doubts:
        return
    if len(others) == 1:
        units, flags = _stated(others[0], open_)
        state = advice.state.format(units=units, flags=flags)
        hint = f"All numbers are usual with {_listed(others)}: {state}"
    elif others:
        hint = f"The numbers are usual with {_listed(others)}: {advice.choose}"
    else:
        hint = (
            "They are unusual in every combination of known units: correct the numbers, such as "
            "radii or diameters in place of areas"
        )
    raise InputError(
        "this does not look like CGS units (cm, s, mL/s, cm², dyn/cm²): "
        f"{'; '.join(doubts)}. {hint}, or {advice.confirm} if they are right."
    )


def _measured(sizes: Sizes) -> Iterator[tuple[_Range, float, float]]:
    """Yield the ranges of known quantities, with the least and the largest number."""
    for usual in _RANGES:
        if usual.powers.keys() <= sizes.keys():
            powers = [sizes[name] ** power for name, power in usual.powers.items()]
            values = usual.factor * math.prod(powers)
            if not np.isnan(values).all():
                yield usual, float(np.nanmin(values)), float(np.nanmax(values))


def _combinations(names: Collection[str]) -> Iterator[dict[str, str]]:
    """Yield all combinations of units, by the quantities that are not in CGS."""
    # Of units with the same factor, such as mL/s and cm^3/s, the first one is used.
    choices = [
        {f: unit for unit, f in reversed([*FACTORS[name].items()])}.values() for name in names
    ]
    for units in itertools.product(*choices):
        found = dict(zip(names, units, strict=True))
        yield {name: unit for name, unit in found.items() if FACTORS[name][unit] != 1}


def _stated(units: Mapping[str, str], open_: Collection[str]) -> tuple[str, str]:
    """Return the units of quantities as Python and as the command line state them."""
    factors = factors_to_cgs(units)
    for name, system in SYSTEMS.items():
        if all(factors_to_cgs(system)[quantity] == factors[quantity] for quantity in open_):
            return repr(name), name
    return str(units), ",".join(f"{name}={unit}" for name, unit in units.items())


def _listed(readings: Sequence[Mapping[str, str]]) -> str:
    """Describe combinations of units, the first three of them."""
    shown = [", ".join(f"{n} in {u}" for n, u in units.items()) for units in readings[:3]]
    more = f", or {len(readings) - 3} other combinations" if readings[3:] else ""
    return f"{', or '.join(shown)}{more}"


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
        See :func:`check_flow` and :func:`check_samples`; also if most of the wall shear
        stress points against the flow.
    """
    check_axes(variables["flow"])
    for name, values in variables.items():
        check_samples(name, values, time)
    check_flow(variables["flow"], variables["area"], z, flip)
    for name in ("area", "pressure"):
        mean = np.abs(variables[name].mean(axis=0))
        missing, present = mean < 1e-3 * mean.max(), mean > 0.5 * mean.max()
        missing[1:-1] &= present[:-2] | present[2:]
        missing[[0, -1]] &= present[[1, -2]]
        if missing.any():
            at = int(missing.argmax())
            raise InputError(
                f"the mean {name} is {mean[at]:.4g} at z = {z[at]:.4g} cm (point {at}), and usual "
                "beside it: leave out the points without results."
            )
    stress = variables.get("wall_shear_stress", np.ones((1, 1)))
    if (usual := np.median(stress.mean(axis=0))) < 0:
        raise InputError(
            f"the wall shear stress points against the flow, its mean is {usual:.4g} dyn/cm² in "
            "the middle of its range: change its sign, or give its magnitude."
        )


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
        If there is a gap between the end and the start, or a time point is damaged.
    """
    if len(time) < _RESOLVED or np.ptp(np.diff(time)) > 1e-3 * (time[1] - time[0]):
        return
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
            f"it is not one cycle: {name} ends at {values[-1, at]:.4g} and begins at "
            f"{values[0, at]:.4g} ({column} {at}), a gap in its waveform. Correct the time points, "
            "or pass the period (--period)."
        )


def _gaps(values: Array, floor: Array) -> Array:
    """Return the gap between the end and the start of each signal over the largest within it.

    A gap is the step to the next time point, or its distance from both a line and a parabola
    through those on one side, or from both polynomials of degree 3 and 4, whichever side is nearer.
    """
    found: list[Array] = []
    for weights in ((1,), (2, -1), (3, -3, 1), (4, -6, 4, -1), (5, -10, 10, -5, 1)):
        off = [
            values - sum(w * np.roll(values, side * n, axis=0) for n, w in enumerate(weights, 1))
            for side in (1, -1)
        ]
        jumps = np.minimum(np.abs(off[0]), np.abs(np.roll(off[1], 1, axis=0)))
        found.append(jumps[0] / np.maximum(jumps[len(weights) : -2].max(axis=0), floor))
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
