"""Whether an input lies outside the training data, with a score.

Inflow and area profile are each described by few numbers that do not depend on the
grid, and compared with the box that the training cases fill in their principal
components.  The score is 1 at the edge of the box: 1.2 is a fifth of its half width
beyond it.  What the components cannot describe at all counts against the largest such
remainder of the training cases, but at least 2 % of their size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.errors import InputError, PCNDEWarning

EDGE = 1 + 1e-6
"""Scores beyond are outside; a little above 1, as the training cases may be resampled."""

_HARMONICS = 12
_PLACES = 101
_KEPT = 1e-3
_TOLERATED = 0.02
_TOGETHER = 256  # cases, whose descriptions fit the processor's cache


class OutsideTrainingWarning(PCNDEWarning):
    """An input of a prediction lies outside the training data."""


@dataclass(frozen=True, eq=False)
class Novelty:
    """The training cases' box, of inflow and of area.

    Attributes
    ----------
    inflow_centre, area_centre : array of shape (n,)
        Middle of the descriptions.
    inflow_axes, area_axes : array of shape (k, n)
        Principal components.
    inflow_range, area_range : array of shape (2, k)
        Middle and half width along each.
    inflow_rest, area_rest : array of shape (1,)
        Tolerated size of what the components leave.
    """

    inflow_centre: Array
    inflow_axes: Array
    inflow_range: Array
    inflow_rest: Array
    area_centre: Array
    area_axes: Array
    area_range: Array
    area_rest: Array

    @classmethod
    def of(cls, inflow: Array, area_undeformed: Array, z: Array) -> Novelty:
        """Find the box of the training cases: Q_in (case, time), S_u (case, z), z (z,)."""
        return cls(*_box(_harmonics(inflow)), *_box(_profile(area_undeformed, z)))

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        return ((f.name, getattr(self, f.name)) for f in fields(self))

    def score(self, inflow: Array, area_undeformed: Array, z: Array) -> tuple[Array, Array]:
        """Score of each case's inflow and of its area, (case,) each; beyond 1 is outside."""
        of_inflow, of_area = _inflow_scale(self, inflow.shape[1]), _area_scale(self, z.tobytes())
        scores = np.empty((2, len(inflow)))
        for start in range(0, len(inflow), _TOGETHER):
            rows = slice(start, start + _TOGETHER)
            scores[0, rows] = of_inflow.score(inflow[rows])
            scores[1, rows] = of_area.score(np.sqrt(area_undeformed[rows]))
        return scores[0], scores[1]

    def inflow_ends(self, n_times: int) -> Array:
        """Both ends of the training inflows along their first component.

        Parameters
        ----------
        n_times : int
            Equal steps of one cycle, from the training cases' first instant.

        Returns
        -------
        array of shape (2, n_times)
            Q_in, mL/s, of the harmonics that the description keeps.
        """
        ends = _ends(self.inflow_centre, self.inflow_axes, self.inflow_range)
        real, imaginary = np.split(ends, 2, axis=1)
        inflow: Array = np.fft.irfft((real + 1j * imaginary) * n_times, n=n_times, axis=1)
        return inflow

    def area_ends(self, z: Array) -> Array:
        """Both ends of the training vessels along their first component.

        Parameters
        ----------
        z : array of shape (z,)
            Points from the inlet to the outlet, cm.

        Returns
        -------
        array of shape (2, z)
            S_u, cm².
        """
        at = np.linspace(0, 1, _PLACES)
        place = (z - z[0]) / (z[-1] - z[0])
        ends = _ends(self.area_centre, self.area_axes, self.area_range)
        return np.array([np.interp(place, at, end[:_PLACES]) ** 2 for end in ends])

    def check(self) -> None:
        """Raise if the arrays do not belong together.

        Raises
        ------
        InputError
            Naming the part.
        """
        for name, array in self:
            if not np.isfinite(array).all():
                raise InputError(f"The novelty's {name} holds values that are not finite.")
        for part in ("inflow", "area"):
            centre, axes, span, rest = (
                getattr(self, f"{part}_{name}") for name in ("centre", "axes", "range", "rest")
            )
            if not (
                centre.ndim == 1
                and axes.shape[1:] == centre.shape
                and span.shape == (2, len(axes))
                and rest.shape == (1,)
            ):
                raise InputError(f"The novelty's arrays of {part} do not belong together.")


def _harmonics(inflow: Array) -> Array:
    """Fourier coefficients of the first harmonics, real and imaginary: (case, n)."""
    described: Array = inflow @ _analysis(inflow.shape[1])
    return described


def _analysis(n_times: int) -> Array:
    """Matrix (time, n) of those coefficients; they are 0 from Nyquist's frequency on."""
    harmonic = np.arange(_HARMONICS + 1)
    phase = 2 * np.pi / n_times * (np.arange(n_times)[:, None] * harmonic % n_times)
    waves = np.stack([np.cos(phase), -np.sin(phase)], axis=1) * (harmonic < n_times / 2)
    return waves.reshape(n_times, -1) / n_times


def _profile(area_undeformed: Array, z: Array) -> Array:
    """Radius, up to √π, at equally spaced places, and the length: (case, n)."""
    matrix, length = _interpolation(z)
    described: Array = np.sqrt(area_undeformed) @ matrix + length
    return described


def _interpolation(z: Array) -> tuple[Array, Array]:
    """Matrix (z, n) of linear interpolation to equally spaced places, and the length (n,)."""
    place = (z - z[0]) / (z[-1] - z[0])
    at = np.linspace(0, 1, _PLACES)
    after = np.clip(np.searchsorted(place, at), 1, z.size - 1)
    share = (at - place[after - 1]) / (place[after] - place[after - 1])
    matrix = np.zeros((z.size, _PLACES + 1))
    matrix[after - 1, np.arange(_PLACES)] = 1 - share
    matrix[after, np.arange(_PLACES)] = share
    return matrix, np.append(np.zeros(_PLACES), z[-1] - z[0])


def _box(described: Array) -> tuple[Array, Array, Array, Array]:
    centre = described.mean(axis=0)
    _, sizes, axes = np.linalg.svd(described - centre, full_matrices=False)
    axes = axes[sizes > _KEPT * max(float(np.linalg.norm(described)), 1e-300)]
    along = (described - centre) @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    rest = np.linalg.norm(described - centre - along @ axes, axis=1).max()
    tolerated = max(float(rest), _TOLERATED * float(np.linalg.norm(centre)))
    return centre, axes, np.stack([(low + high) / 2, (high - low) / 2]), np.array([tolerated])


def _ends(centre: Array, axes: Array, span: Array) -> Array:
    """Descriptions at the lower and upper limit of the first component, (2, n)."""
    if not len(axes):  # a single training case
        return np.stack([centre, centre])
    limits = span[0, 0] + np.array([[-1.0], [1.0]]) * span[1, 0]
    ends: Array = centre + limits * axes[0]
    return ends


class _Scale(NamedTuple):
    """How scores are read from inputs on one grid: ``x @ matrix − offset``.

    The first ``n_axes`` numbers are the components, in half widths from the middle of the box;
    the others are what these leave, in what is tolerated.
    """

    matrix: Array
    offset: Array
    n_axes: int

    def score(self, x: Array) -> Array:
        """Score of each row."""
        moved = x @ self.matrix - self.offset
        beyond, left = np.abs(moved[:, : self.n_axes]), moved[:, self.n_axes :]
        size = np.sqrt(np.einsum("ij,ij->i", left, left))
        score: Array = np.maximum(beyond.max(axis=1, initial=0.0), size)
        return score


def _scale(
    matrix: Array, constant: Array | float, centre: Array, axes: Array, span: Array, rest: Array
) -> _Scale:
    """Make the scale for inputs that ``x @ matrix + constant`` describes."""
    remainder = np.eye(centre.size) - axes.T @ axes
    directions = np.concatenate([axes.T / span[1], remainder / rest[0]], axis=1)
    offset = (centre - constant) @ directions
    offset[: len(axes)] += span[0] / span[1]
    return _Scale(matrix @ directions, offset, len(axes))


@lru_cache(maxsize=8)
def _inflow_scale(of: Novelty, n_times: int) -> _Scale:
    box = of.inflow_centre, of.inflow_axes, of.inflow_range, of.inflow_rest
    analysis = _analysis(n_times)
    # Harmonics that so few instants do not show are taken to be the usual ones.
    unseen = np.where(analysis.any(axis=0), 0.0, of.inflow_centre)
    return _scale(analysis, unseen, *box)


@lru_cache(maxsize=8)
def _area_scale(of: Novelty, points: bytes) -> _Scale:
    box = of.area_centre, of.area_axes, of.area_range, of.area_rest
    return _scale(*_interpolation(np.frombuffer(points)), *box)
