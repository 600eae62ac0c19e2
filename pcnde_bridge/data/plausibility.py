"""Plausibility of vessels: magnitudes and units.

The ranges cover arteries from 0.8 mm to 5 cm in diameter.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.balances import growth_of_volume, momentum
from pcnde_bridge.data.units import FACTORS, SHAPES, SYSTEMS, stated_units, text_of
from pcnde_bridge.errors import InputError

_VISCOSITY = 0.0377  # kinematic, cm²/s; 0.04 dyn·s/cm² over 1.06 g/cm³
_ROOT = math.sqrt(math.pi) / 2  # root of the area over the diameter
_ALONG = {"along": 1, "area": 0}
_SHEAR = {"wall_shear_stress": 1, "area": 1.5, "flow": -1}
_BALANCE = {"balance": 1, "flow": 1, "time": 1, "area": -1, "z": -1}
_INERTIA = {"inertia": 1, "pressure": 1, "time": 1, "area": 1, "flow": -1, "z": -1}
_FRICTION = {"friction": 1, "pressure": 1, "area": 2, "flow": -1, "z": -1}


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

    def extremes(self, sizes: Mapping[str, Array], row: int = 0) -> tuple[float, float]:
        """Return the least and the largest number of vessels; NaN if all are unknown."""
        powers = [sizes[name][row] ** power for name, power in self.powers.items()]
        values = self.factor * math.prod(powers)
        unknown = np.isnan(values).all()
        return (math.nan, math.nan) if unknown else (np.nanmin(values), np.nanmax(values))

    def doubt(self, low: float, high: float, *, possible: bool = False) -> str:
        """Describe a number that is not usual, or not possible; empty if there is none."""
        least, most = (self.least, self.most) if possible else (self.low, self.high)
        if not (low < least or high > most):
            return ""
        wrong, kind = low if low < least else high, "possible" if possible else "usual"
        return f"{self.name} is {wrong:.4g}{self.unit}, {kind} are {least:g} to {most:g}"


# Pressures of 20 … 195 mmHg: less than a factor of 10, so that Pa are never taken for dyn/cm².
# Poiseuille's wall shear stress, 4·μ·Q/(π·r³), is 0.32·_ROOT·Q/S^1.5 with μ = 0.04 poise, and
# its gradient of the pressure 8·π·μ·Q/S². Drops of the published and the synthetic vessels are
# 1.2 to 8 times as large; of their areas taken for radii or for diameters, below 0.2 times.
# The published volumes grow by half of the difference of the flows; exact solutions have 1.
# The density is 0.91 to 1.28 for the published and the synthetic vessels, of blood 1.06 g/cm³;
# with radii of 0.2 cm in place of areas it is 1.6 times as large.
_REYNOLDS, _POISEUILLE, _DROP = 1 / (_ROOT * _VISCOSITY), 1 / (0.32 * _ROOT), 1 / (0.32 * math.pi)
_RANGES = (
    _Range("the mean pressure", " dyn/cm²", 2.67e4, 2.6e5, -1e5, 4e5, {"pressure": 1}),
    _Range("the mean flow", " mL/s", 0.01, 250, 0.002, 750, {"flow": 1}),
    _Range("the median undeformed area", " cm²", 5e-3, 20, 2e-3, 60, {"area": 1}),
    _Range("the length of the vessel", " cm", 0.2, 100, 0.05, 300, {"z": 1}),
    _Range("the length of the recording", " s", 0.25, 60, 0.08, 300, {"time": 1}),
    _Range("the area over the undeformed area", "", 0.75, 1.55, 0.2, 5, {"ratio": 1, "area": 0}),
    _Range(
        "the largest of these ratios along the vessel over the smallest", "", 1, 3, 1, 4, _ALONG
    ),
    _Range("flow over area", " cm/s", 2, 100, 0.2, 400, {"flow": 1, "area": -1}),
    _Range("the Reynolds number", "", 4, 6000, 1.2, 2e4, {"flow": 1, "area": -0.5}, _REYNOLDS),
    _Range("the wall shear stress over Poiseuille's", "", 0.32, 3.1, 0.32, 5, _SHEAR, _POISEUILLE),
    _Range("the length over the diameter", "", 2.5, 100, 0.8, 300, {"z": 1, "area": -0.5}, _ROOT),
    _Range(
        "the ratio of inflow less outflow to the growth of the volume",
        "",
        *(0.3, 2.8) * 2,
        _BALANCE,
    ),
    _Range("the density by pressures and accelerations", " g/cm³", 0.75, 1.43, 0.4, 3, _INERTIA),
    _Range("the pressure drop over Poiseuille's", "", 0.6, 200, -1.0, math.inf, _FRICTION, _DROP),
)

BALANCES = {"balance", "inertia", "friction"}
"""Sizes that compare the variables with each other; unknown where nothing changes in time."""

_EXPLAINED = {*BALANCES, "along"}  # by :mod:`pcnde_bridge.data.single_vessel`

Sizes = dict[str, Array]
"""Measured quantities by name, one number for each vessel; NaN is unknown.

The first row is for areas as they are given, the second one for their squares, by which radii
and diameters are compared.
"""


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
    dict of str to array of shape (2, case)
        Sizes for :func:`check_units`.
    """
    sizes = input_sizes(flow, area_undeformed, float(np.ptp(z)), float(np.ptp(time)))
    sizes["pressure"] = np.array([pressure.mean(axis=(1, 2))] * 2)
    ratios = (area / area_undeformed[:, None, :]) ** np.arange(1, 3)[:, None, None, None]
    ratios = ratios.mean(axis=2)
    sizes["ratio"] = np.median(ratios, axis=2)
    sizes["along"] = ratios.max(axis=2) / ratios.min(axis=2)
    if wall_shear_stress is not None:
        stress = np.median(np.abs(wall_shear_stress.mean(axis=1)), axis=1)
        sizes["wall_shear_stress"] = np.array([stress, stress])
    measured = [
        (growth_of_volume(flow, one, time, z), *momentum(flow, one, pressure, time, z))
        for one in (area, area**2)
    ]
    products = {"balance": _BALANCE, "inertia": _INERTIA, "friction": _FRICTION}
    for (name, powers), values in zip(products.items(), np.swapaxes(measured, 0, 1), strict=True):
        # The other sizes in this product cancel, so that it is measured in their units.
        others = math.prod(sizes[other] ** powers[other] for other in powers if other != name)
        sizes[name] = np.divide(values, others, out=np.full_like(values, np.nan), where=others != 0)
    return sizes


def input_sizes(flow: Array, area_undeformed: Array, length: float, period: float) -> Sizes:
    """Measure the sizes of a prediction's inputs, as :func:`sizes_of`.

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
    area = np.median(area_undeformed, axis=1)
    flows = np.where(mean > 0, mean, np.nan)
    return {
        "flow": np.stack([flows, flows]),
        "area": np.stack([area, area**2]),
        "z": np.full((2, len(flow)), length),
        "time": np.full((2, len(flow)), period),
    }


class UnitsError(InputError):
    """The numbers do not look like those of arteries in the units that are stated or assumed.

    Parameters
    ----------
    problem : str
        Text without advice.
    advice : str
        What to do where units can be stated.
    """

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(f"{problem}: {advice}.")
        self.problem = problem


_HINT = " (radii or diameters in place of areas?)"
_STATE_SHAPE = ", with area=cm^2 for areas, radius=mm for radii, and diameter=mm for diameters"


def check_units(
    sizes: Sizes,
    stated: Mapping[str, str],
    *,
    unique: bool = False,
    start: bool = False,
    shapes: Collection[str] = tuple(SHAPES),
) -> None:
    """Raise if the units are wrong or, with ``unique``, ambiguous.

    Parameters
    ----------
    sizes : dict of str to array of shape (2, case)
        Sizes of vessels, converted to CGS units from those that are stated.
    stated : mapping of str to str
        Units that are stated; numbers of these quantities alone need only be possible.  A
        system of units does not state whether areas are areas, radii or diameters.
    unique : bool
        Raise also if the numbers are usual in other units as well.
    start : bool
        Whether the recording may begin at rest: numbers that
        :mod:`pcnde_bridge.data.single_vessel` may explain count only if other units do, too.
    shapes : collection of str
        Possible readings of the areas if the shape is not stated.

    Raises
    ------
    UnitsError
        If a number is impossible, or unusual; the message suggests the units if only one
        combination of them makes all numbers usual.
    """
    open_ = {name for name in FACTORS if name in sizes and name not in stated}
    if "pressure" in open_ and (sizes["pressure"] < 0).any():
        raise UnitsError(
            f"the mean pressure is {sizes['pressure'].min():.4g}, but pressures must be relative "
            "to the surroundings",
            f"if these are, {_pass(stated, 'cgs')}",
        )
    by_system = "area" in stated and "shape" not in stated
    doubts: list[str] = []
    explained: list[str] = []
    compared, of_doubt = [], False
    for usual in (usual for usual in _RANGES if usual.powers.keys() <= sizes.keys()):
        names, extremes = usual.powers.keys(), usual.extremes(sizes)
        of_area = "area" in names and "shape" not in stated
        of_start = start and names & _EXPLAINED
        if not (names & open_ or of_start) and (doubt := usual.doubt(*extremes, possible=True)):
            advice = "correct the units (--units), or the numbers"
            raise UnitsError(f"with the stated units {doubt}{_HINT * of_area}", advice)
        if names & open_ or (by_system and "area" in names):
            compared.append(usual)
            if doubt := usual.doubt(*extremes):
                (explained if of_start else doubts).append(doubt)
                of_doubt |= of_area
    if not (doubts or explained or unique):
        return
    others = _readings(sizes, compared, stated, ["area"] if "shape" in stated else shapes)
    if others or (doubts and not by_system):
        text = "; ".join([*doubts, *explained] if others else doubts)
        text += _HINT * bool(text and of_doubt)
        raise _units_error(text, others, open_, stated)


def _units_error(
    doubts: str,
    others: Sequence[Mapping[str, str]],
    open_: Collection[str],
    stated: Mapping[str, str],
) -> UnitsError:
    """Return the error for numbers that are unusual, or usual in other units, too."""
    has_shapes = any("radius" in units or "diameter" in units for units in others)
    areas = {"area": stated.get("area", "cm^2"), "shape": "area"} if has_shapes else {}
    cgs = _pass({**stated, **areas}, "cgs")
    listed, known = _listed(others), text_of(stated)
    state = f"state the units (--units{f' {known},…' * bool(known)}){_STATE_SHAPE * has_shapes}"
    rest = "the others" if known else "they"
    if not doubts:
        problem = f"the units are ambiguous: the numbers are usual in CGS units, and with {listed}"
        return UnitsError(problem, f"{state}; if {rest} are CGS, {cgs}")
    problem = f"does not look like CGS units (cm, s, mL/s, cm², dyn/cm²): {doubts}"
    usual = f"All numbers are usual with {listed}"
    if not others:
        usual = "They are unusual in every combination of known units"
        state = (
            "correct the numbers, such as radii or diameters in place of areas, a reversed vessel, "
            "or pressures relative to the outlet"
        )
    elif len(others) == 1 and open_:
        state = _stated(others[0], open_, stated)
    return UnitsError(f"this {problem}. {usual}", f"{state}, or {cgs} if they are right")


def _readings(
    sizes: Sizes, ranges: Sequence[_Range], stated: Mapping[str, str], shapes: Collection[str]
) -> list[dict[str, str]]:
    """Return the units, other than CGS and the stated ones, in which all numbers are usual."""
    # Of units with the same factor, such as mL/s and cm^3/s, the first one is used.
    choices = {
        name: {f: unit for unit, f in [*units.items()][::-1]}
        for name, units in FACTORS.items()
        if name in sizes and name not in stated
    }
    grids = np.meshgrid(*map(list, choices.values()), indexing="ij")
    factors = dict(zip(choices, grids, strict=True))
    found = []
    for shape in sorted(shapes):
        given = dict(factors)
        if shape != "area":
            # What was converted as an area is the square of lengths in the root of its unit.
            of_unit = FACTORS["area"][stated["area"]] if "area" in stated else 1.0
            given["area"] = SHAPES[shape] / of_unit * given.get("area", np.ones(()))
        usual = np.ones([len(units) for units in choices.values()], dtype=bool)
        for of in ranges:
            low, high = of.extremes(sizes, int(shape != "area"))
            factor = math.prod(given[name] ** p for name, p in of.powers.items() if name in given)
            usual &= np.logical_not((low * factor < of.low) | (high * factor > of.high))
        for place in np.argwhere(usual):
            units = {n: [*choices[n].values()][i] for n, i in zip(choices, place, strict=True)}
            others = {name: unit for name, unit in units.items() if FACTORS[name][unit] != 1}
            if shape != "area":
                others.pop("area", None)
                others[shape] = {**stated, **units}["area"].removesuffix("^2")
            found.append(others)
    return [units for units in found if units]


def _stated(units: Mapping[str, str], open_: Collection[str], stated: Mapping[str, str]) -> str:
    """Return the advice to state units beside those that are stated."""
    for name, system in SYSTEMS.items():
        if (
            all(FACTORS[n][system[n]] == FACTORS[n][units.get(n, SYSTEMS["cgs"][n])] for n in open_)
            and not units.keys() - FACTORS.keys()
        ):
            return _pass(stated, name)
    return _pass({**stated, **stated_units(units)})


def _pass(units: Mapping[str, str], system: str = "") -> str:
    text = text_of(units, system)
    return f"pass units={text!r} (--units {text})"


def _listed(readings: Sequence[Mapping[str, str]]) -> str:
    """Describe combinations of units, the first three of them."""
    shown = [", ".join(f"{n} in {u}" for n, u in units.items()) for units in readings[:3]]
    more = f", or {len(readings) - 3} other combinations" if readings[3:] else ""
    return f"{', or '.join(shown)}{more}"
