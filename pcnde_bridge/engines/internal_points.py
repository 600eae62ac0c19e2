"""Points along the vessel at which the closures are solved.

Layer, jet and wall shear stress contain derivatives of S_u, and the losses are largest at the
throat.  All vessels therefore have points with the same spacing, whatever the points of the data.
S_u is read at knots that are twice as far apart, and a cubic spline through the knots gives
it in between: more points of the data do not add detail that fewer points do not show.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, IntArray

POINTS_PER_RADIUS = 10
"""Points per radius of the training cases' vessels."""

_POINTS_PER_KNOT = 2
_FEWEST_KNOTS = 5
_ROUGH = 0.8  # fourth over second differences of ln S_u at the knots; smooth stenoses: 0.6
_NEGLIGIBLE = 0.004  # second difference of ln S_u


@dataclass(frozen=True, eq=False)
class InternalPoints:
    """Internal points of one grid, and the way from the given points to them and back.

    Attributes
    ----------
    z : array of shape (internal,)
        Internal points, cm.
    inward : array of shape (z, internal)
        Cubic interpolation from the given points: ``values @ inward``.
    before : array of int, shape (z,)
        Internal point before each given point.
    share : array of shape (z,)
        Distance of each given point from it, in intervals between internal points.
    """

    z: Array
    inward: Array
    before: IntArray
    share: Array

    @cached_property
    def outward(self) -> Array:
        """:meth:`at_given` as a matrix (internal, z)."""
        return np.asarray(self.at_given(np.eye(self.z.size)))

    def at_given(self, values: Any) -> Any:
        """Interpolate NumPy or JAX arrays (..., internal) linearly to the given points."""
        before, after = values[..., self.before], values[..., self.before + 1]
        return before + self.share * (after - before)

    def area(self, area_undeformed: Array) -> Array:
        """Interpolate S_u, cm², (case, z); it stays positive."""
        return np.exp(np.log(area_undeformed) @ self.inward)

    def is_rough(self, area_undeformed: Array) -> npt.NDArray[np.bool_]:
        """Return whether S_u, (case, z), has kinks or noise at the scale of the knots, (case,)."""
        knots = (np.log(area_undeformed) @ self.inward)[:, ::_POINTS_PER_KNOT]
        bends, kinks = (np.linalg.norm(np.diff(knots, n), axis=1) for n in (2, 4))
        clear = bends > _NEGLIGIBLE * np.sqrt(knots.shape[1])
        return np.asarray(clear & (kinks > _ROUGH * bends))


def internal_points(z: Array, spacing: float | None) -> InternalPoints:
    """Return the points of a vessel that are about ``spacing`` apart, cm; None: those given."""
    return _internal_points(z.tobytes(), spacing)


@lru_cache(maxsize=8)
def _internal_points(given: bytes, spacing: float | None) -> InternalPoints:
    from scipy.interpolate import CubicSpline

    z = np.frombuffer(given)
    if spacing is None:
        before = np.minimum(np.arange(z.size), z.size - 2)
        return InternalPoints(
            z, np.eye(z.size), before, np.asarray(np.arange(z.size) - before, float)
        )
    intervals = max(round((z[-1] - z[0]) / (_POINTS_PER_KNOT * spacing)), _FEWEST_KNOTS - 1)
    knots = np.linspace(z[0], z[-1], intervals + 1)
    points = np.linspace(z[0], z[-1], _POINTS_PER_KNOT * intervals + 1)
    inward = CubicSpline(knots, CubicSpline(z, np.eye(z.size))(knots))(points).T
    place = (z - z[0]) / (points[1] - points[0])
    before = np.minimum(place.astype(int), points.size - 2)
    return InternalPoints(points, inward, before, np.asarray(place - before, float))
