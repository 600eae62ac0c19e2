r"""How far a prediction of the ``physics`` preset may be off.

Three things make a draw of a prediction:

- the correction of one of the fits that left out a part of the training cases (whole
  geometries, or whole waveforms), drawn at random: what the data do not decide;
- a normal shift of the correction's logit, the same for a whole case: cases differ in
  how much of the storage the averaged flow hides, and nothing in the inputs says so;
- a normal multiple of a profile along the vessel, for each variable: what is left where
  the correction does nothing.

The width of the last two is found on the cases that each fit had left out: the profile
is the 68 % quantile of the errors at each point, the shift the one with the narrowest
intervals, and all is scaled so that 90 % intervals hold 90 % of the values left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from pcnde_bridge.cases import Cases
from pcnde_bridge.closures.parameters import ClosureParameters
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.engines.base import Solution
from pcnde_bridge.engines.closures import Closures
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.grid import Grid
from pcnde_bridge.validation import counted
from pcnde_bridge.variables import VARIABLES

Array = npt.NDArray[np.float64]

_SHIFTS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
_DRAWS = 12
_LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What the draws are made of.

    Attributes
    ----------
    members : array of shape (member, n)
        Parameters of the correction, a row for each fit that left out a part.
    shift : array of shape (1,)
        Standard deviation of the logit's shift.
    profile : array of shape (3, point)
        Of flow, area and pressure, equally spaced from inlet to outlet.
    scale : array of shape (3,)
        Factor on the deviations of flow, area and pressure.
    """

    members: Array
    shift: Array
    profile: Array
    scale: Array

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        return ((f.name, getattr(self, f.name)) for f in fields(self))

    def check(self, width: int) -> None:
        """Raise if the arrays do not belong together, or to a correction of ``width`` numbers.

        Raises
        ------
        InputError
            Saying what their shapes are, or which is not finite.
        """
        for name, array in self:
            if not np.isfinite(array).all():
                raise InputError(f"The uncertainty's {name} holds values that are not finite.")
        shapes = {name: array.shape for name, array in self}
        n = len(VARIABLES)
        fits = shapes["members"][1:] == (width,) and len(shapes["profile"]) == 2
        if (
            not fits
            or shapes["shift"] != (1,)
            or shapes["scale"] != (n,)
            or shapes["profile"][0] != n
        ):
            raise InputError(f"The uncertainty's arrays do not belong together: {shapes}.")


def parts(cases: Cases, folds: int) -> list[npt.NDArray[np.int64]]:
    """List the cases that each fit of the ensemble leaves out.

    The geometries in the order of their narrowest area, and the waveforms in the
    order of their oscillation, are each cut into ``folds`` neighbouring parts, so
    that the outermost are left out together: predictions are often asked for
    beyond the training cases.  Where there are fewer geometries or waveforms than
    parts and one, every ``folds``-th case is left out instead.
    """
    narrowness = cases.area_undeformed.min(axis=1) / cases.area_undeformed.max(axis=1)
    oscillation = np.std(cases.inflow, axis=1)
    found = []
    for label, order in (("geometry", narrowness), ("waveform", oscillation)):
        values = cases.labels[label].to_numpy()
        distinct = np.unique(values)
        if len(distinct) <= folds:
            continue
        mean = [float(order[values == v].mean()) for v in distinct]
        ranked = distinct[np.argsort(mean, kind="stable")]
        found += [np.flatnonzero(np.isin(values, part)) for part in np.array_split(ranked, folds)]
    if found:
        return found
    return [np.arange(k, len(cases), folds) for k in range(folds) if len(cases) > folds]


def calibrate(
    closures: Closures,
    parameters: ClosureParameters,
    members: Sequence[Array],
    left_out: Sequence[npt.NDArray[np.int64]],
    cases: Cases,
    config: ClosureConfig,
    rng: np.random.Generator,
) -> Uncertainty:
    """Find profile, shift and scale on the cases that each member's fit left out."""
    grid = cases.grid
    normal = rng.standard_normal((_DRAWS, max(len(part) for part in left_out)))
    errors: dict[str, list[Array]] = {name: [] for name in VARIABLES}
    widths: dict[str, list[list[Array]]] = {name: [[] for _ in _SHIFTS] for name in VARIABLES}
    for member, part in zip(members, left_out, strict=True):
        held = cases.select(part)
        vectors = parameters.replace(correction=member)

        def predict(
            shift: Array, held: Cases = held, vectors: ClosureParameters = vectors
        ) -> Solution:
            count = len(shift) // len(held)
            inflow, s_u = (np.tile(a, (count, 1)) for a in (held.inflow, held.area_undeformed))
            return closures.predict(vectors, shift, inflow, s_u, grid, config)

        plain = predict(np.zeros(len(held)))
        for name in VARIABLES:
            errors[name].append(np.abs(getattr(plain, name) - getattr(held, name)))
        for number, shift in enumerate(_SHIFTS):
            if shift == 0:
                for name in VARIABLES:
                    widths[name][number].append(np.zeros_like(errors[name][-1]))
                continue
            draws = predict((shift * normal[:, : len(held)]).ravel())
            for name in VARIABLES:
                values = getattr(draws, name).reshape(_DRAWS, *getattr(held, name).shape)
                widths[name][number].append(values.std(axis=0, ddof=1))
    error = {name: np.concatenate(values) for name, values in errors.items()}
    profile = {name: np.quantile(e, 0.68, axis=(0, 1)) for name, e in error.items()}

    def scaled(number: int, name: str) -> tuple[float, float]:
        """Factor that makes 90 % intervals hold 90 %, and their mean width then."""
        width = np.hypot(np.concatenate(widths[name][number]), profile[name])
        factor = calibrated_factor(error[name], width)
        return factor, factor * float(width.mean()) / float(error[name].mean() + _LEAST)

    widest = [sum(scaled(n, name)[1] for name in VARIABLES) for n in range(len(_SHIFTS))]
    best = int(np.argmin(widest))
    return Uncertainty(
        np.array(members),
        np.array([_SHIFTS[best]]),
        np.stack([profile[name] for name in VARIABLES]),
        np.array([scaled(best, name)[0] for name in VARIABLES]),
    )


def calibrated_factor(error: Array, width: Array) -> float:
    """Factor on deviations that makes normal 90 % intervals hold 90 % of the errors.

    Parameters
    ----------
    error, width : array of the same shape
        Absolute errors, and the deviations before; where these are zero the values are
        known, such as the flow at the inlet, and do not count.
    """
    inside = width > _LEAST
    if not inside.any():
        return 0.0
    normal = NormalDist().inv_cdf(0.95)  # 90 % lie within so many deviations
    return float(np.quantile(error[inside] / width[inside], 0.9)) / normal


def draw(
    closures: Closures,
    parameters: ClosureParameters,
    uncertainty: Uncertainty,
    mean: Solution,
    inflow: Array,
    area_undeformed: Array,
    grid: Grid,
    config: ClosureConfig,
    samples: int,
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Draw predictions.

    Returns
    -------
    dict of arrays of shape (sample, case, time, z)
        Flow, area and pressure.

    Raises
    ------
    SolveError
        If a draw cannot be computed.
    """
    count = len(inflow)
    chosen = rng.integers(len(uncertainty.members), size=samples)
    shift = uncertainty.shift[0] * rng.standard_normal((samples, count))
    along = np.linspace(0, 1, uncertainty.profile.shape[1])
    place = (grid.z - grid.z[0]) / (grid.z[-1] - grid.z[0])
    found = {name: np.empty((samples, *mean.flow.shape)) for name in VARIABLES}
    largest = int(np.bincount(chosen).max(initial=0))
    for number, member in enumerate(uncertainty.members):
        rows = np.flatnonzero(chosen == number)
        if rows.size == 0:
            continue
        # As many draws of each member, some of them twice: another number is compiled anew.
        rows = np.resize(rows, largest)
        try:
            solution = closures.predict(
                parameters.replace(correction=member),
                shift[rows].ravel(),
                np.tile(inflow, (rows.size, 1)),
                np.tile(area_undeformed, (rows.size, 1)),
                grid,
                config,
            )
        except SolveError as error:
            raise SolveError(
                f"The prediction has been computed, but not all of its samples. Of these, each "
                f"with {counted(count, 'case')}, one after the other: {error}"
            ) from error
        for name in VARIABLES:
            found[name][rows] = getattr(solution, name).reshape(rows.size, *mean.flow.shape)
    for number, name in enumerate(VARIABLES):
        centre = getattr(mean, name)
        width = np.interp(place, along, uncertainty.profile[number])
        noise = rng.standard_normal((samples, count, 1, 1)) * width
        found[name] -= centre
        found[name] += noise
        found[name] *= uncertainty.scale[number]
        found[name] += centre
    return found
