"""Distance of an input from the training data, as scores.

Each case is described by quantities with a name, such as the amplitude of the inflow or the
blockage.  A quantity's score is 1 at the edge of the range of the training cases, and 1.2
is 0.2 half widths beyond it.  Where fits that left out cases have shown how far a
model extrapolates, the range reaches as far beyond the training cases as those cases lay beyond
the others.

Models that are bound to their grid learn from the shapes themselves.  For them, inflow and area
profile are each compared with the box that the training cases fill in their principal
components.  The remainder that the components cannot describe is compared with the
largest remainder of the training cases, but at least with 2 % of their size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import check_finite, check_shape
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.errors import PCNDEWarning

EDGE = 1 + 1e-6
"""Score beyond which an input is outside; a little above 1, as inputs may be resampled."""

_HARMONICS = 12
_PLACES = 101  # equally spaced points of an area's description
_SMALLEST_COMPONENT = 1e-3  # relative to the size of all descriptions
_TOLERATED = 0.02  # remainder relative to the size of a description

QUANTITIES = (
    "mean flow",
    "amplitude",
    "frequency",
    "area",
    "blockage",
    "widening",
    "length of the vessel",
    "length of the stenosis",
)
"""Names of the scores, in the order of :func:`describe`."""

_SMALLEST_HALF_WIDTH = 0.1  # of a range, relative to the quantity
_STEADY, _STRAIGHT = 0.02, 0.02  # relative amplitude and blocked fraction without meaning


class OutsideTrainingWarning(PCNDEWarning):
    """An input of a prediction lies outside the training data."""


class _Box(NamedTuple):
    """Box that the training cases' descriptions fill in their principal components.

    Attributes
    ----------
    center : array of shape (n,)
        Mean of the descriptions.
    axes : array of shape (k, n)
        Principal components.
    range : array of shape (2, k)
        Middle and half width along each component.
    rest : array of shape (1,)
        Tolerated size of the remainder.
    """

    center: Array
    axes: Array
    range: Array
    rest: Array

    @classmethod
    def fit(cls, described: Array) -> _Box:
        """Find the box of descriptions of shape (case, n)."""
        center = described.mean(axis=0)
        _, sizes, axes = np.linalg.svd(described - center, full_matrices=False)
        axes = axes[sizes > _SMALLEST_COMPONENT * max(float(np.linalg.norm(described)), 1e-300)]
        along = (described - center) @ axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        span = np.stack([(low + high) / 2, (high - low) / 2])
        rest = np.linalg.norm(described - center - along @ axes, axis=1).max()
        tolerated = max(float(rest), _TOLERATED * float(np.linalg.norm(center)))
        return cls(center, axes, span, np.array([tolerated]))

    def score(self, described: Array) -> Array:
        """Score descriptions of shape (case, n)."""
        moved = described - self.center
        along = moved @ self.axes.T
        beyond = np.abs(along - self.range[0]) / self.range[1]
        rest = np.linalg.norm(moved - along @ self.axes, axis=1) / self.rest
        return np.maximum(beyond.max(axis=1, initial=0.0), rest)

    def ends(self) -> Array:
        """Return the descriptions at both limits of the first component, shape (2, n)."""
        if not len(self.axes):  # a single training case
            return np.stack([self.center, self.center])
        limits = self.range[0, 0] + np.array([[-1.0], [1.0]]) * self.range[1, 0]
        return self.center + limits * self.axes[0]


@dataclass(frozen=True, eq=False, repr=False)
class Novelty(Displayed):
    """Ranges and boxes of the training cases, which score other inputs.

    Attributes
    ----------
    ranges : array of shape (2, 8)
        Middle and half width of each of :data:`QUANTITIES`.
    inflow, area : _Box
        Boxes of the inflows' harmonics and of the area profiles.
    """

    ranges: Array
    inflow: _Box
    area: _Box

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> Novelty:
        """Return the novelty of a model file, whose arrays have the names of ``dict(novelty)``.

        Raises
        ------
        KeyError, InputError
            If an array is missing, has another shape or values that are not finite.
        """
        boxes = []
        for name in ("inflow", "area"):
            boxes.append(_Box(*(arrays[f"{name}_{part}"] for part in _Box._fields)))
            n, k = boxes[-1].center.size, len(boxes[-1].axes)
            for array, shape in zip(boxes[-1], ((n,), (k, n), (2, k), (1,)), strict=True):
                check_shape(f"The novelty's array of {name}", array, shape)
                check_finite(f"The novelty's array of {name}", array)
        check_shape("The novelty's ranges", arrays["ranges"], (2, len(QUANTITIES)))
        check_finite("The novelty's ranges", arrays["ranges"])
        return cls(arrays["ranges"], *boxes)

    @classmethod
    def fit(
        cls,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        left_out: Sequence[Positions] = (),
    ) -> Novelty:
        """Find the ranges and boxes of the training cases.

        Parameters
        ----------
        inflow : array of shape (case, time)
            Q at the inlet, mL/s, over one cycle.
        area_undeformed : array of shape (case, z)
            S_u, cm².
        grid : Grid
            Time points (s) and points (cm).
        left_out : sequence of arrays of int
            Positions of the cases that were left out of fits; each range reaches as far beyond
            the training cases as the cases left out lay beyond the others.
        """
        ranges = _ranges(describe(inflow, area_undeformed, grid), left_out)
        harmonics, profiles = _harmonics(inflow), _profiles(area_undeformed, grid.z)
        return cls(ranges, _Box.fit(np.nan_to_num(harmonics)), _Box.fit(profiles))

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        yield "ranges", self.ranges
        for name, box in (("inflow", self.inflow), ("area", self.area)):
            yield from ((f"{name}_{part}", array) for part, array in box._asdict().items())

    def score(self, inflow: Array, area_undeformed: Array, grid: Grid) -> dict[str, Array]:
        """Score each quantity of each case; values beyond 1 are outside the training data.

        Parameters
        ----------
        inflow, area_undeformed, grid
            Inputs as for :meth:`fit`, on any grid.

        Returns
        -------
        dict of str to array of shape (case,)
            Scores, by the names of :data:`QUANTITIES`.  What an input does not have, such as
            the frequency of a steady flow, scores 0.
        """
        middle, half = self.ranges
        scores = np.abs(describe(inflow, area_undeformed, grid) - middle) / half
        return dict(zip(QUANTITIES, np.nan_to_num(scores.T), strict=True))

    def score_shapes(self, inflow: Array, area_undeformed: Array, z: Array) -> dict[str, Array]:
        """Score the ``shape of the inflow`` and the ``shape of the vessel`` of each case.

        Parameters
        ----------
        inflow, area_undeformed : array
            Inputs as for :meth:`fit`.
        z : array of shape (z,)
            Points, cm.

        Returns
        -------
        dict of str to array of shape (case,)
            Scores; values beyond 1 are outside the training data.
        """
        # Harmonics above Nyquist's frequency count as those of the mean inflow.
        harmonics = _harmonics(inflow)
        harmonics = np.where(np.isnan(harmonics), self.inflow.center, harmonics)
        profiles = _profiles(area_undeformed, z)
        return {
            "shape of the inflow": self.inflow.score(harmonics),
            "shape of the vessel": self.area.score(profiles),
        }

    def inflow_ends(self, n_times: int) -> Array:
        """Return both ends of the training inflows along their first component.

        Parameters
        ----------
        n_times : int
            Number of equal steps of one cycle, from the training cases' first time point.

        Returns
        -------
        array of shape (2, n_times)
            Q_in, mL/s, from the harmonics of the description.
        """
        real, imaginary = np.split(self.inflow.ends(), 2, axis=1)
        return np.fft.irfft((real + 1j * imaginary) * n_times, n=n_times, axis=1)

    def area_ends(self, z: Array) -> Array:
        """Return both ends of the training vessels along their first component.

        Parameters
        ----------
        z : array of shape (z,)
            Points from the inlet to the outlet, cm.

        Returns
        -------
        array of shape (2, z)
            S_u, cm².
        """
        relative = np.linspace(0, 1, _PLACES)
        place = (z - z[0]) / (z[-1] - z[0])
        ends = self.area.ends()
        return np.array([np.interp(place, relative, end[:_PLACES]) ** 2 for end in ends])


def describe(inflow: Array, area_undeformed: Array, grid: Grid) -> Array:
    """Return the quantities of each case, shape (case, 8), in the order of :data:`QUANTITIES`.

    These are the cycle mean Q̄ of the inflow (mL/s); the root mean square of Q − Q̄ (mL/s); the
    root mean square of ∂Q/∂t over that, divided by 2π (1/s); the median S_m of the undeformed
    area (cm²); ln(min S_u / S_m); ln(max S_u / S_m); the length of the vessel (cm); and that of
    the stenosis, ∫ max(1 − S_u/S_m, 0) dz over the blocked fraction (cm).  The frequency of a
    steady flow and the length without a stenosis are NaN.
    """
    harmonics = np.fft.rfft(inflow, axis=1)[:, 1:]
    order = np.arange(1, harmonics.shape[1] + 1)
    mean, amplitude = inflow.mean(axis=1), inflow.std(axis=1)
    power = np.abs(harmonics) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        frequency = np.sqrt(power @ order**2 / power.sum(axis=1)) / grid.period
        middle = np.median(area_undeformed, axis=1)
        ratio = area_undeformed / middle[:, None]
        blocked = np.maximum(1 - ratio, 0)
        largest = blocked.max(axis=1)
        length = np.trapezoid(blocked, grid.z, axis=1) / largest
    frequency[amplitude <= _STEADY * np.abs(mean)] = np.nan
    length[largest <= _STRAIGHT] = np.nan
    whole = np.full(len(inflow), np.ptp(grid.z))
    extremes = np.log(ratio.min(axis=1)), np.log(ratio.max(axis=1))
    return np.stack([mean, amplitude, frequency, middle, *extremes, whole, length], axis=1)


def _ranges(described: Array, left_out: Sequence[Positions]) -> Array:
    """Return middle and half width of the range of each quantity, (2, 8)."""
    low, high = np.fmin.reduce(described), np.fmax.reduce(described)
    beyond = np.zeros((2, len(QUANTITIES)))
    for fold in left_out:
        rest = np.delete(described, fold, axis=0)
        if len(rest):
            beyond = np.fmax(beyond, [np.fmin.reduce(rest) - low, high - np.fmax.reduce(rest)])
    low, high = low - beyond[0], high + beyond[1]
    middle = (low + high) / 2
    size = np.abs(middle)
    # The amplitude is compared with the mean flow, and ratios of areas with 1.
    size[1], size[4:6] = size[0], 1
    half = np.maximum((high - low) / 2, _SMALLEST_HALF_WIDTH * size)
    # What no training case has, such as a frequency, is scored by what it comes from.
    return np.stack([np.nan_to_num(middle), np.nan_to_num(half, nan=np.finfo(half.dtype).max)])


def _harmonics(inflow: Array) -> Array:
    """Return the first harmonics of each inflow, real parts before imaginary ones, (case, 26).

    Coefficients from Nyquist's frequency on are NaN.
    """
    found = np.fft.rfft(inflow, axis=1, norm="forward")[:, : (inflow.shape[1] + 1) // 2]
    harmonics = np.full((len(inflow), _HARMONICS + 1), np.nan, dtype=complex)
    count = min(found.shape[1], harmonics.shape[1])
    harmonics[:, :count] = found[:, :count]
    return np.concatenate([harmonics.real, harmonics.imag], axis=1)


def _profiles(area_undeformed: Array, z: Array) -> Array:
    """Return √S_u at equally spaced places, and the length of the vessel, (case, 102)."""
    places = np.linspace(z[0], z[-1], _PLACES)
    profiles = [np.interp(places, z, np.sqrt(area)) for area in area_undeformed]
    return np.insert(profiles, _PLACES, z[-1] - z[0], axis=1)
