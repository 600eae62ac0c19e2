r"""How far a prediction of the ``physics`` preset may be off.

Three things make a draw of a prediction:

- the correction of one of the fits that left out a part of the training cases (whole
  geometries, or whole waveforms), drawn at random: what the data do not decide;
- a normal shift of the correction's logit, the same for a whole case: cases differ in
  how much of the storage the averaged flow hides, and nothing in the inputs says so;
- a normal multiple of a profile along the vessel, for each variable: what is left where
  the correction does nothing.

The width of the last two is found on the cases that each fit had left out
(:mod:`pcnde_bridge.uncertainty.calibration`), with the shift that leads to the narrowest intervals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import counted
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.splits import Positions
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.closure_protocol import Closures
from pcnde_bridge.engines.protocol import Solution
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.uncertainty.calibration import Calibration, shared_error

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
    profile, scale : arrays of shape (3, point) and (3,)
        As of :class:`~pcnde_bridge.uncertainty.calibration.Calibration`.
    """

    members: Array
    shift: Array
    profile: Array
    scale: Array

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        return ((f.name, getattr(self, f.name)) for f in fields(self))

    @property
    def calibration(self) -> Calibration:
        """Profile and scale."""
        return Calibration(self.profile, self.scale)

    def check(self, width: int) -> None:
        """Raise if the arrays do not belong together, or to a correction of ``width`` numbers.

        Raises
        ------
        InputError
            Saying what their shapes are, or which is not finite.
        """
        self.calibration.check()
        for name in ("members", "shift"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"The uncertainty's {name} holds values that are not finite.")
        shapes = {name: array.shape for name, array in self}
        if shapes["members"][1:] != (width,) or shapes["shift"] != (1,):
            raise InputError(f"The uncertainty's arrays do not belong together: {shapes}.")


class Chances(NamedTuple):
    """The random numbers of some draws: those of few cases are the same as among many.

    Attributes
    ----------
    member : array of int of shape (sample,)
        Which fit's correction.
    shift : array of shape (sample, case)
        Of the correction's logit.
    noise : array of shape (3, sample, case)
        Multiples of the profiles of flow, area and pressure.
    """

    member: npt.NDArray[np.int64]
    shift: Array
    noise: Array

    @classmethod
    def draw(
        cls, uncertainty: Uncertainty, samples: int, count: int, rng: np.random.Generator
    ) -> Chances:
        """Draw them for ``count`` cases."""
        member = rng.integers(len(uncertainty.members), size=samples)
        shift = uncertainty.shift[0] * rng.standard_normal((samples, count))
        return cls(member, shift, rng.standard_normal((len(VARIABLES), samples, count)))

    def of(self, cases: slice) -> Chances:
        """Those of some of the cases."""
        return Chances(self.member, self.shift[:, cases], self.noise[:, :, cases])


def calibrate(
    closures: Closures,
    parameters: ClosureParameters,
    members: Sequence[Array],
    left_out: Sequence[Positions],
    cases: Cases,
    config: ClosureConfig,
    rng: np.random.Generator,
) -> Uncertainty:
    """Find profile, shift and scale on the cases that each member's fit left out."""
    grid = cases.grid
    normal = rng.standard_normal((_DRAWS, max(len(part) for part in left_out)))
    errors: list[Array] = []
    spreads: dict[float, list[Array]] = {shift: [] for shift in _SHIFTS}
    for member, part in zip(members, left_out, strict=True):
        held = cases.select(part)
        vectors = parameters.replace(correction=member)

        def predict(
            shift: Array, held: Cases = held, vectors: ClosureParameters = vectors
        ) -> list[Array]:
            """Flow, area and pressure, each (draw, case, time, z), with shifts (draw, case)."""
            inflow, s_u = (np.tile(a, (len(shift), 1)) for a in (held.inflow, held.area_undeformed))
            solution = closures.predict(vectors, shift.ravel(), inflow, s_u, grid, config)
            return [getattr(solution, name).reshape(-1, *held.flow.shape) for name in VARIABLES]

        plain, true = predict(np.zeros((1, len(held)))), (getattr(held, n) for n in VARIABLES)
        errors.append(np.abs([values[0] - t for values, t in zip(plain, true, strict=True)]))
        spreads[0.0].append(np.zeros_like(errors[-1]))
        for shift in _SHIFTS[1:]:
            draws = predict(shift * normal[:, : len(held)])
            spreads[shift].append(np.stack([values.std(axis=0, ddof=1) for values in draws]))
    error = np.concatenate(errors, axis=1)
    profile, size = shared_error(error), error.mean(axis=(1, 2, 3)) + _LEAST

    def calibrated(spread: Array) -> tuple[float, Calibration]:
        """Mean widths of the intervals, in terms of the errors and summed, and what gives them."""
        calibration = Calibration.fit(profile, error, spread)
        width = calibration.scale * np.hypot(spread, profile[:, None, None]).mean(axis=(1, 2, 3))
        return float(np.sum(width / size)), calibration

    found = {shift: calibrated(np.concatenate(of, axis=1)) for shift, of in spreads.items()}
    best = min(_SHIFTS, key=lambda shift: found[shift][0])
    _, calibration = found[best]
    return Uncertainty(np.array(members), np.array([best]), calibration.profile, calibration.scale)


def draw(
    closures: Closures,
    parameters: ClosureParameters,
    uncertainty: Uncertainty,
    mean: Solution,
    inflow: Array,
    area_undeformed: Array,
    grid: Grid,
    config: ClosureConfig,
    chances: Chances,
) -> dict[str, Array]:
    """Compute the draws of predictions.

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
    calibration = uncertainty.calibration
    found = {name: np.empty((len(chances.member), *mean.flow.shape)) for name in VARIABLES}
    largest = int(np.bincount(chances.member).max(initial=0))
    for number, member in enumerate(uncertainty.members):
        rows = np.flatnonzero(chances.member == number)
        if rows.size == 0:
            continue
        # As many draws of each member, some of them twice: another number is compiled anew.
        rows = np.resize(rows, largest)
        try:
            solution = closures.predict(
                parameters.replace(correction=member),
                chances.shift[rows].ravel(),
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
        shared = calibration.shared(name, grid.z)
        found[name] -= centre
        found[name] += chances.noise[number, :, :, None, None] * shared
        found[name] *= calibration.scale[number]
        found[name] += centre
    return found
