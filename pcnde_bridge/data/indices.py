"""Pressure drop, fractional flow reserve and other quantities along a vessel.

Data sets and predictions share them through :class:`VesselQuantities`, so that reference
and prediction are computed by the same code.  Arrays are (..., time, z), units are CGS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import check_values, real_array
from pcnde_bridge.data.stenosis import NO_STENOSIS, diameter, measuring_positions, throats
from pcnde_bridge.data.units import FACTORS
from pcnde_bridge.data.variables import FIELDS, MMHG
from pcnde_bridge.errors import InputError

Position = npt.ArrayLike | None
"""Axial position in cm, one for all cases or one for each; None is the default."""


def reynolds_number(flow: Any, area: Any, density: float = 1.06, viscosity: float = 0.04) -> Any:
    """Return the Reynolds number of the mean velocity and the diameter, ρ·|Q|·D/(S·μ).

    Parameters
    ----------
    flow, area : array, shape (...)
        Q (mL/s) and S (cm²); numpy or JAX arrays.
    density, viscosity : float
        ρ (g/cm³) and μ (poise).
    """
    return 2 * density / viscosity * abs(flow) / (math.pi * area) ** 0.5  # D/S = 2/√(π·S)


def poiseuille_wall_shear_stress(flow: Array, area: Array, viscosity: float = 0.04) -> Array:
    """Return Poiseuille's wall shear stress 4·μ·Q/(π·r³), dyn/cm².

    Parameters
    ----------
    flow, area : array, shape (...)
        Q (mL/s) and S (cm²).
    viscosity : float
        μ, poise.
    """
    return np.asarray(4 * viscosity * flow / (math.pi * (diameter(area) / 2) ** 3))


def values_at(values: Array, z: Array, position: Array) -> Array:
    """Interpolate values linearly in z.

    Parameters
    ----------
    values : array of shape (case, time, z)
        Values at the points.
    z : array of shape (z,)
        Points, cm.
    position : array of shape (case,)
        One position for each case, cm.

    Returns
    -------
    array of shape (case, time)
    """
    left = np.clip(np.searchsorted(z, position, side="right") - 1, 0, len(z) - 2)
    share = ((position - z[left]) / (z[left + 1] - z[left]))[:, None]
    case = np.arange(len(values))
    return np.asarray((1 - share) * values[case, :, left] + share * values[case, :, left + 1])


def pressure_drop(pressure: Array, z: Array, proximal: Array, distal: Array) -> Array:
    """Return the drop p(proximal) − p(distal), dyn/cm², shape (case, time).

    Parameters
    ----------
    pressure : array of shape (case, time, z)
        p, dyn/cm².
    z : array of shape (z,)
        Points, cm.
    proximal, distal : array of shape (case,)
        Positions, cm.
    """
    return values_at(pressure, z, proximal) - values_at(pressure, z, distal)


def one_minus_ffr(pressure: Array, z: Array, proximal: Array, distal: Array) -> Array:
    """Return 1 − FFR, the mean drop over the mean p(proximal), shape (case,).

    Parameters
    ----------
    pressure, z, proximal, distal
        See :func:`pressure_drop`.
    """
    mean_drop = pressure_drop(pressure, z, proximal, distal).mean(axis=1)
    return np.asarray(mean_drop / values_at(pressure, z, proximal).mean(axis=1))


def with_columns(labels: pd.DataFrame, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Return a table of labels with further columns.

    Raises
    ------
    InputError
        If a label has the name of a column.
    """
    if taken := [name for name in columns if name in labels]:
        raise InputError(
            f"the label {taken[0]!r} has the name of a column of this table: rename the label."
        )
    return labels.assign(**columns)


class VesselQuantities(Displayed):
    """Quantities that follow from flow, area and pressure along vessels.

    Positions ``proximal`` and ``distal`` are axial positions in cm: a number, or one for each
    case.  Between points, values are interpolated linearly.  By default the positions are
    those of :func:`~pcnde_bridge.data.stenosis.measuring_positions`: one healthy diameter
    beyond either end of the narrowest stenosis, or the ends of a vessel without a stenosis.
    """

    if TYPE_CHECKING:  # arrays of the data set or prediction
        flow: Array
        area: Array
        pressure: Array | None
        wall_shear_stress: Array | None
        area_undeformed: Array
        time: Array
        z: Array
        period: float

        @property
        def labels(self) -> pd.DataFrame:
            """Labels, one row for each case."""

    def __len__(self) -> int:
        return len(self.flow)

    def variables(self) -> dict[str, Array]:
        """Return flow, area, pressure and wall shear stress by name, if there are such."""
        return {name: v for name in FIELDS if (v := getattr(self, name)) is not None}

    def to_frame(self) -> pd.DataFrame:
        """Return a tidy table, one row for each case, time point and point.

        Returns
        -------
        DataFrame
            Columns of the labels (geometry, waveform, blockage and any other), time (s),
            z (cm), flow (mL/s), area (cm²), pressure and wall_shear_stress (dyn/cm², where
            there are such) and area_undeformed (cm²); z varies fastest.
        """
        return self._tidy(self.variables())

    def _tidy(self, variables: Mapping[str, Array]) -> pd.DataFrame:
        """Return a row for each case, time point and axial position; z varies fastest."""
        _, n_times, n_points = shape = self.flow.shape
        axes = {"time": self.time[:, None], "z": self.z}
        columns = {**axes, **variables, "area_undeformed": self.area_undeformed[:, None]}
        flat = {name: np.broadcast_to(values, shape).ravel() for name, values in columns.items()}
        labels = self.labels.iloc[np.repeat(np.arange(shape[0]), n_times * n_points)]
        return with_columns(labels.reset_index(drop=True), flat)

    def pressure_drop(
        self, proximal: Position = None, distal: Position = None, units: str = "dyn/cm^2"
    ) -> Array:
        """Return the pressure drop between two positions, p(proximal) − p(distal).

        Parameters
        ----------
        proximal, distal : float or array of shape (case,), optional
            Positions, cm; by default on either side of the narrowest stenosis, see
            :func:`~pcnde_bridge.data.stenosis.measuring_positions`.
        units : {'dyn/cm^2', 'Pa', 'kPa', 'mmHg'}
            Unit of the result; 1 mmHg is 1333.22 dyn/cm².

        Returns
        -------
        array of shape (case, time)

        Raises
        ------
        InputError
            If there is no pressure, or a position or the unit is not usable.
        """
        factor, positions = _factor("pressure", units), self._positions(proximal, distal)
        return np.asarray(pressure_drop(self._given_pressure(), self.z, *positions) / factor)

    def ffr(self, proximal: Position = None, distal: Position = None) -> Array:
        """Return the fractional flow reserve, the ratio of the mean pressures over a cycle.

        It is p̄(distal)/p̄(proximal), dimensionless, after Pijls et al. (1996, New England
        Journal of Medicine 334:1703).  By definition it applies to maximal (hyperemic) flow;
        for another flow the same ratio is returned.

        Parameters
        ----------
        proximal, distal : float or array of shape (case,), optional
            Positions, see :meth:`pressure_drop`.

        Returns
        -------
        array of shape (case,)

        Raises
        ------
        InputError
            If there is no pressure, or a position is not usable.
        """
        positions = self._positions(proximal, distal)
        return np.asarray(1 - one_minus_ffr(self._given_pressure(), self.z, *positions))

    def pressure_ratio(self, proximal: Position = None, distal: Position = None) -> Array:
        """Return the instantaneous pressure ratio p(distal)/p(proximal), dimensionless.

        Parameters
        ----------
        proximal, distal : float or array of shape (case,), optional
            Positions, see :meth:`pressure_drop`.

        Returns
        -------
        array of shape (case, time)

        Raises
        ------
        InputError
            If there is no pressure, or a position is not usable.
        """
        pressure, (upstream, downstream) = self._given_pressure(), self._positions(proximal, distal)
        return values_at(pressure, self.z, downstream) / values_at(pressure, self.z, upstream)

    def stenosis_resistance(self, proximal: Position = None, distal: Position = None) -> Array:
        """Return the transstenotic resistance, mean pressure drop over mean flow, dyn·s/cm⁵.

        The flow is that at the proximal position; both means are over a cycle.

        Parameters
        ----------
        proximal, distal : float or array of shape (case,), optional
            Positions, see :meth:`pressure_drop`.

        Returns
        -------
        array of shape (case,)

        Raises
        ------
        InputError
            If there is no pressure, or a position is not usable.
        """
        drop = self.pressure_drop(proximal, distal).mean(axis=1)
        position = self._positions(proximal, distal)[0]
        return np.asarray(drop / values_at(self.flow, self.z, position).mean(axis=1))

    def velocity(self) -> Array:
        """Return the mean velocity over the cross-section, Q/S, cm/s, (case, time, z)."""
        return np.asarray(self.flow / self.area)

    def reynolds(self, density: float = 1.06, viscosity: float = 0.04) -> Array:
        """Return the Reynolds number ρ·|Q|·D/(S·μ) of the local diameter D.

        Parameters
        ----------
        density, viscosity : float
            ρ (g/cm³) and μ (poise).

        Returns
        -------
        array of shape (case, time, z)
        """
        return np.asarray(reynolds_number(self.flow, self.area, density, viscosity))

    def poiseuille_wall_shear_stress(self, viscosity: float = 0.04) -> Array:
        """Return Poiseuille's wall shear stress 4·μ·Q/(π·r³), dyn/cm².

        Its shape is (case, time, z).  It holds for steady, developed flow in a straight tube;
        in a stenosis the wall shear stress is several times larger.

        Parameters
        ----------
        viscosity : float
            μ, poise.
        """
        return poiseuille_wall_shear_stress(self.flow, self.area, viscosity)

    def time_averaged_wall_shear_stress(self, units: str = "dyn/cm^2") -> Array:
        """Return the mean of the wall shear stress's magnitude over a cycle (TAWSS).

        Parameters
        ----------
        units : {'dyn/cm^2', 'Pa'}
            Unit of the result; 1 Pa is 10 dyn/cm².

        Returns
        -------
        array of shape (case, z)

        Raises
        ------
        InputError
            If there is no wall shear stress, or the unit is unknown.
        """
        factor = _factor("wall_shear_stress", units)
        return np.asarray(np.abs(self._given_wall_shear_stress()).mean(axis=1) / factor)

    def peak_wall_shear_stress(self, units: str = "dyn/cm^2") -> tuple[Array, Array]:
        """Return the largest magnitude of the wall shear stress, and where it occurs.

        Parameters
        ----------
        units : {'dyn/cm^2', 'Pa'}
            Unit of the stress.

        Returns
        -------
        stress, position : array of shape (case,)
            The largest magnitude at all points and time points, and its position, cm.

        Raises
        ------
        InputError
            If there is no wall shear stress, or the unit is unknown.
        """
        factor = _factor("wall_shear_stress", units)
        largest = np.abs(self._given_wall_shear_stress()).max(axis=1)
        return largest.max(axis=1) / factor, self.z[largest.argmax(axis=1)]

    def indices(self, proximal: Position = None, distal: Position = None) -> pd.DataFrame:
        """Return hemodynamic indices, one row for each case.

        Parameters
        ----------
        proximal, distal : float or array of shape (case,), optional
            Positions, see :meth:`pressure_drop`.

        Returns
        -------
        DataFrame
            Columns of the labels; ``blockage`` (1 − smallest S_u over S_u at the inlet, unless
            it is a label); ``positions``: "stenosis", "whole vessel" (there is no stenosis) or
            "given"; ``proximal`` and ``distal`` (cm); ``mean_flow`` and ``peak_flow`` at the
            proximal position (mL/s); ``peak_velocity`` (cm/s) and ``peak_reynolds``, the
            largest along the vessel; and, if there is a pressure, ``mean_pressure_mmHg``,
            ``systolic_mmHg`` and ``diastolic_mmHg`` (mean, largest and smallest pressure at the
            proximal position), ``mean_drop_mmHg`` and ``peak_drop_mmHg`` (see
            :meth:`pressure_drop`), ``ffr`` (:meth:`ffr`) and ``resistance`` (dyn·s/cm⁵,
            :meth:`stenosis_resistance`).  If there is a wall shear stress, ``peak_wss``
            (dyn/cm²) and ``peak_wss_z`` (cm), see :meth:`peak_wall_shear_stress`, and
            ``peak_tawss`` (dyn/cm²), the largest :meth:`time_averaged_wall_shear_stress` along
            the vessel.

        Raises
        ------
        InputError
            If a position is not usable.
        """
        upstream, downstream = self._positions(proximal, distal)
        frame = self.labels.reset_index(drop=True)
        if "blockage" not in frame:
            frame["blockage"] = 1 - self.area_undeformed.min(axis=1) / self.area_undeformed[:, 0]
        _, ratios = throats(self.z, self.area_undeformed)
        found = np.where(ratios <= NO_STENOSIS, "stenosis", "whole vessel")
        given = proximal is not None or distal is not None
        columns = {"positions": "given" if given else found}
        columns |= {"proximal": upstream, "distal": downstream}
        return with_columns(frame, columns | self._index_values(upstream, downstream))

    def _index_values(self, proximal: Array, distal: Array) -> dict[str, Array]:
        """Return the columns of :meth:`indices` that depend on the samples, each (case,)."""
        flow = values_at(self.flow, self.z, proximal)
        found = {"mean_flow": flow.mean(axis=1), "peak_flow": flow.max(axis=1)}
        found["peak_velocity"] = self.velocity().max(axis=(1, 2))
        found["peak_reynolds"] = self.reynolds().max(axis=(1, 2))
        if self.pressure is not None:
            upstream = values_at(self.pressure, self.z, proximal) / MMHG
            found["mean_pressure_mmHg"] = upstream.mean(axis=1)
            found["systolic_mmHg"] = upstream.max(axis=1)
            found["diastolic_mmHg"] = upstream.min(axis=1)
            drop = self.pressure_drop(proximal, distal, "mmHg")
            found |= {"mean_drop_mmHg": drop.mean(axis=1), "peak_drop_mmHg": drop.max(axis=1)}
            found["ffr"] = self.ffr(proximal, distal)
            found["resistance"] = self.stenosis_resistance(proximal, distal)
        if self.wall_shear_stress is not None:
            found["peak_wss"], found["peak_wss_z"] = self.peak_wall_shear_stress()
            found["peak_tawss"] = self.time_averaged_wall_shear_stress().max(axis=1)
        return found

    def _given_pressure(self) -> Array:
        if self.pressure is None:
            raise InputError("There is no pressure: the model has no pressure stages.")
        return self.pressure

    def _given_wall_shear_stress(self) -> Array:
        if self.wall_shear_stress is None:
            raise InputError(
                "There is no wall shear stress: a data set has it if its files do, only models of "
                "the preset 'physics' predict it, and only those trained with one have samples of "
                "it."
            )
        return self.wall_shear_stress

    def _positions(self, proximal: Position, distal: Position) -> tuple[Array, Array]:
        """Return the positions of every case, (case,): those given, else the default."""
        if proximal is None or distal is None:
            upstream, downstream = measuring_positions(self.z, self.area_undeformed)
        if proximal is not None:
            upstream = _checked_position("proximal", proximal, len(self.flow), self.z)
        if distal is not None:
            downstream = _checked_position("distal", distal, len(self.flow), self.z)
        if (wrong := np.flatnonzero(upstream >= downstream)).size:
            case = int(wrong[0])
            raise InputError(
                f"proximal ({upstream[case]:g} cm) must lie upstream of distal "
                f"({downstream[case]:g} cm) in case {case}; exchange them, or give both."
            )
        return upstream, downstream


def _factor(quantity: str, units: str) -> float:
    """Return the factor of a unit to CGS."""
    if units not in FACTORS[quantity]:
        raise InputError(f"Unknown units {units!r}; use one of {list(FACTORS[quantity])}.")
    return FACTORS[quantity][units]


def _checked_position(name: str, given: npt.ArrayLike, count: int, z: Array) -> Array:
    """Return a position for each case, within the vessel."""
    position = real_array(name, given)
    if position.shape not in ((), (count,)):
        wanted = f"a position in cm, or one for each of the {count} cases"
        raise InputError(f"{name} must be {wanted}; it has shape {position.shape}.")
    tolerance = 1e-9 * (z[-1] - z[0])
    outside = ~((position >= z[0] - tolerance) & (position <= z[-1] + tolerance))
    rule = f"positions must lie in the vessel, from {z[0]:g} to {z[-1]:g} cm"
    check_values(name, position, outside, rule)
    return np.broadcast_to(np.clip(position, z[0], z[-1]), (count,))
