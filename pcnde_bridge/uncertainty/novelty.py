"""Distance of an input from the training data, as a score.

Inflow and area profile are each described by a few numbers that do not depend on the
grid, and compared with the box that the training cases fill in their principal
components.  The score is 1 at the edge of the box, and 1.2 a fifth of its half width
beyond the edge.  The remainder that the components cannot describe is compared with the
largest remainder of the training cases, but at least with 2 % of their size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import check_finite, check_shape
from pcnde_bridge.errors import PCNDEWarning

EDGE = 1 + 1e-6
"""Score beyond which an input is outside; a little above 1, as inputs may be resampled."""

_HARMONICS = 12
_PLACES = 101  # equally spaced points of an area's description
_SMALLEST_COMPONENT = 1e-3  # relative to the size of all descriptions
_TOLERATED = 0.02  # remainder relative to the size of a description
_CHUNK = 256  # cases whose descriptions fit the processor's cache


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

    def ends(self) -> Array:
        """Return the descriptions at both limits of the first component, shape (2, n)."""
        if not len(self.axes):  # a single training case
            return np.stack([self.center, self.center])
        limits = self.range[0, 0] + np.array([[-1.0], [1.0]]) * self.range[1, 0]
        ends: Array = self.center + limits * self.axes[0]
        return ends


@dataclass(frozen=True, eq=False)
class Novelty:
    """Boxes of the training cases' inflows and areas, which score other inputs."""

    inflow: _Box
    area: _Box

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> Novelty:
        """Return the boxes of a model file, whose arrays have the names of ``dict(novelty)``.

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
        return cls(*boxes)

    @classmethod
    def fit(cls, inflow: Array, area_undeformed: Array, z: Array) -> Novelty:
        """Find the box of the training cases.

        Parameters
        ----------
        inflow : array of shape (case, time)
            Q at the inlet, mL/s, over one cycle.
        area_undeformed : array of shape (case, z)
            S_u, cm².
        z : array of shape (z,)
            Points, cm.
        """
        harmonics = inflow @ _harmonic_analysis(inflow.shape[1])
        interpolation, length = _interpolation(z)
        profiles = np.sqrt(area_undeformed) @ interpolation + length
        return cls(_Box.fit(harmonics), _Box.fit(profiles))

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        for name, box in (("inflow", self.inflow), ("area", self.area)):
            yield from ((f"{name}_{part}", array) for part, array in box._asdict().items())

    def score(self, inflow: Array, area_undeformed: Array, z: Array) -> tuple[Array, Array]:
        """Score each case's inflow and area; values beyond 1 are outside the training data.

        Parameters
        ----------
        inflow, area_undeformed, z
            Inputs as for :meth:`fit`, on any grid.

        Returns
        -------
        tuple of two arrays of shape (case,)
            Scores of the inflow and of the area.
        """
        of_inflow, of_area = _inflow_scorer(self, inflow.shape[1]), _area_scorer(self, z.tobytes())
        scores = np.empty((2, len(inflow)))
        for start in range(0, len(inflow), _CHUNK):
            rows = slice(start, start + _CHUNK)
            scores[0, rows] = of_inflow(inflow[rows])
            scores[1, rows] = of_area(np.sqrt(area_undeformed[rows]))
        return scores[0], scores[1]

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
        inflow: Array = np.fft.irfft((real + 1j * imaginary) * n_times, n=n_times, axis=1)
        return inflow

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


def _harmonic_analysis(n_times: int) -> Array:
    """Return the matrix (time, n) that gives the first harmonics, real and imaginary parts.

    Coefficients from Nyquist's frequency on are 0.
    """
    harmonic = np.arange(_HARMONICS + 1)
    phase = 2 * np.pi / n_times * (np.arange(n_times)[:, None] * harmonic % n_times)
    waves = np.stack([np.cos(phase), -np.sin(phase)], axis=1) * (harmonic < n_times / 2)
    return waves.reshape(n_times, -1) / n_times


def _interpolation(z: Array) -> tuple[Array, Array]:
    """Return the matrix (z, n) that interpolates to equally spaced places, and the length (n,).

    Applied to √S_u, the radius up to √π, their sum describes a vessel.
    """
    place = (z - z[0]) / (z[-1] - z[0])
    at = np.linspace(0, 1, _PLACES)
    after = np.clip(np.searchsorted(place, at), 1, z.size - 1)
    share = (at - place[after - 1]) / (place[after] - place[after - 1])
    matrix = np.zeros((z.size, _PLACES + 1))
    matrix[after - 1, np.arange(_PLACES)] = 1 - share
    matrix[after, np.arange(_PLACES)] = share
    return matrix, np.append(np.zeros(_PLACES), z[-1] - z[0])


_Scorer = Callable[[Array], Array]


def _scorer(matrix: Array, constant: Array, box: _Box) -> _Scorer:
    """Return the function that scores inputs x whose description is ``x @ matrix + constant``.

    It is an affine map first: to the components, in half widths from the middle of the box,
    and to the remainder, relative to the tolerated remainder.
    """
    n_axes, remainder = len(box.axes), np.eye(box.center.size) - box.axes.T @ box.axes
    directions = np.concatenate([box.axes.T / box.range[1], remainder / box.rest[0]], axis=1)
    offset = (box.center - constant) @ directions
    offset[:n_axes] += box.range[0] / box.range[1]
    whole = matrix @ directions

    def score(x: Array) -> Array:
        moved = x @ whole - offset
        beyond, left = np.abs(moved[:, :n_axes]), moved[:, n_axes:]
        size = np.sqrt(np.einsum("ij,ij->i", left, left))
        result: Array = np.maximum(beyond.max(axis=1, initial=0.0), size)
        return result

    return score


@lru_cache(maxsize=8)
def _inflow_scorer(novelty: Novelty, n_times: int) -> _Scorer:
    analysis, box = _harmonic_analysis(n_times), novelty.inflow
    # Harmonics above Nyquist's frequency count as those of the mean inflow.
    unseen = np.where(analysis.any(axis=0), 0.0, box.center)
    return _scorer(analysis, unseen, box)


@lru_cache(maxsize=8)
def _area_scorer(novelty: Novelty, points: bytes) -> _Scorer:
    return _scorer(*_interpolation(np.frombuffer(points)), novelty.area)
