"""Result of a prediction: arrays, tidy frame, xarray data set, files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.display import draw
from pcnde_bridge._utils.optional import require
from pcnde_bridge._utils.validation import counted
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.indices import VesselQuantities, with_columns
from pcnde_bridge.data.variables import UNITS
from pcnde_bridge.errors import InputError
from pcnde_bridge.io import predictions

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(VesselQuantities):
    """Flow, area, pressure and wall shear stress over a cycle along the vessel.

    The pressure drop, the fractional flow reserve and other quantities are methods of
    :class:`~pcnde_bridge.data.indices.VesselQuantities`, as for :class:`pcnde_bridge.Cases`.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s.
    area : array of shape (case, time, z)
        S, cm².
    pressure : array of shape (case, time, z) or None
        p, dyn/cm²; None if the model has no pressure stages.
    area_undeformed : array of shape (case, z)
        Undeformed area of the inputs, cm².
    time : array of shape (time,)
        Time points, s.
    z : array of shape (z,)
        Axial positions, cm.
    period : float
        Length of the cycle, s.
    labels : DataFrame
        One row for each case.
    novelty : array of shape (case,) or None
        Distance of the inputs from the training data; 1 is their edge.
    samples : mapping of str to array of shape (sample, case, time, z), or None
        Samples of the variables, if requested.
    wall_shear_stress : array of shape (case, time, z) or None
        Wall shear stress, dyn/cm²; None if the model does not predict it, see the preset
        ``physics``.
    calibrated : bool
        Whether the samples, however few, have the calibrated standard deviation, as those of
        an ensemble have.  That of random samples is an estimate.
    """

    flow: Array
    area: Array
    pressure: Array | None
    area_undeformed: Array
    time: Array
    z: Array
    period: float
    labels: pd.DataFrame
    novelty: Array | None = None
    samples: Mapping[str, Array] | None = None
    wall_shear_stress: Array | None = None
    calibrated: bool = False

    def _facts(self) -> list[str]:
        facts = [f"{counted(len(self), 'case')}: {', '.join(self.variables())}".replace("_", " ")]
        facts += Grid(self.time, self.z, self.period)._facts()
        if self.samples is not None:
            facts.append(f"{len(self.samples['flow'])} samples")
        if self.novelty is not None:
            facts.append(f"novelty up to {self.novelty.max():.2f}")
        return facts

    def plot(
        self, case: int = 0, reference: Cases | None = None, reference_label: str = "reference"
    ) -> Figure:
        """Plot a case, by :func:`pcnde_bridge.plots.time_and_space`, which has the arguments.

        Save the figure that it returns: ``prediction.plot().savefig("case.png")``.

        Raises
        ------
        InputError
            If there is no such case, or the reference has another number of cases.
        """
        return draw("time_and_space", self, reference, case, 0.9, reference_label)

    def standard_deviation(self) -> dict[str, Array]:
        """Return the standard deviation of each variable, shape (case, time, z).

        It is the corrected sample standard deviation; from few samples it is uncertain.

        Raises
        ------
        InputError
            If the prediction has no samples.
        """
        samples = self._given_samples()
        return {name: values.std(axis=0, ddof=1) for name, values in samples.items()}

    def interval(self, level: float = 0.9) -> dict[str, tuple[Array, Array]]:
        """Return the lower and upper limit of each sampled variable, (case, time, z).

        The limits are the prediction minus and plus the standard deviation times the quantile
        of Student's distribution for the number of samples, or of the normal distribution for
        the members of an ensemble.  Their spread is calibrated at 90 %
        on training cases that were left out.

        Parameters
        ----------
        level : float
            Share of the values that should lie inside.

        Raises
        ------
        InputError
            If the level is not between 0 and 1, or there are no samples.
        """
        deviations, factor = self.standard_deviation(), self._quantile(level)
        width = {name: factor * values for name, values in deviations.items()}
        mean = self.variables()
        limits = {name: (mean[name] - width[name], mean[name] + width[name]) for name in width}
        if (name := "wall_shear_stress") in limits:  # a magnitude
            limits[name] = np.maximum(limits[name][0], 0.0), limits[name][1]
        return limits

    def each_sample(self) -> Iterator[Prediction]:
        """Return the samples one by one, each as a prediction without samples.

        The samples are joint: the variables of a sample belong together, at all points and
        time points.  The spread of any quantity is the spread of its values over the samples.

        Raises
        ------
        InputError
            If the prediction has no samples.

        Examples
        --------
        >>> [s.pressure_drop() for s in prediction.each_sample()]  # doctest: +SKIP
        """
        samples = self._given_samples()
        # A variable without samples has no value in a sample.
        fields: dict[str, Any] = dict.fromkeys(self.variables())
        return (
            replace(self, **fields | {k: v[i] for k, v in samples.items()}, samples=None)
            for i in range(len(samples["flow"]))
        )

    def _given_samples(self) -> Mapping[str, Array]:
        if self.samples is None:
            raise InputError(
                "The prediction has no samples: request some, predict(..., samples=64)."
            )
        return self.samples

    def _quantile(self, level: float) -> float:
        """Return half the width of an interval in standard deviations of the samples."""
        from scipy.special import stdtrit

        if not isinstance(level, Real) or not 0 < level < 1:
            raise InputError(f"level must lie between 0 and 1, got {level!r}.")
        count = 2 if self.samples is None else len(self.samples["flow"])
        freedom = np.inf if self.calibrated else count - 1
        return float(stdtrit(freedom, (1 + level) / 2))

    def indices(
        self,
        proximal: npt.ArrayLike | None = None,
        distal: npt.ArrayLike | None = None,
        level: float = 0.9,
    ) -> pd.DataFrame:
        """Return hemodynamic indices, one row for each case, with intervals.

        Parameters
        ----------
        proximal, distal : float or array of shape (case,), optional
            Positions, cm, see :meth:`pressure_drop`.
        level : float
            Share of the values that should lie inside the intervals.

        Returns
        -------
        DataFrame
            Columns of :meth:`pcnde_bridge.Cases.indices`.  With samples, each predicted index
            also has its limits, such as ``ffr_low`` and ``ffr_high``: the index minus and plus
            the quantile of :meth:`interval` times the standard deviation of the index over the
            samples.

        Raises
        ------
        InputError
            If a position or the level is not usable.
        """
        factor = self._quantile(level)
        frame = super().indices(proximal, distal)
        if self.samples is None:
            return frame
        positions = frame["proximal"].to_numpy(), frame["distal"].to_numpy()
        found = [sample._index_values(*positions) for sample in self.each_sample()]
        limits = {}
        for name in found[0]:
            width = factor * np.std([values[name] for values in found], axis=0, ddof=1)
            limits[f"{name}_low"], limits[f"{name}_high"] = frame[name] - width, frame[name] + width
        return with_columns(frame, limits)

    def to_frame(self) -> pd.DataFrame:
        """Return a tidy frame with one row for each case, time point and axial position.

        Returns
        -------
        DataFrame
            Columns of the labels, then ``time`` (s), ``z`` (cm), ``flow`` (mL/s),
            ``area`` (cm²), ``pressure`` and ``wall_shear_stress`` (dyn/cm², if predicted)
            and ``area_undeformed`` (cm²); with samples also
            ``flow_standard_deviation`` and so on, in the same units.
        """
        variables = self.variables()
        if self.samples is not None:
            deviations = self.standard_deviation().items()
            variables |= {f"{name}_standard_deviation": values for name, values in deviations}
        return self._tidy(variables)

    def to_xarray(self) -> xarray.Dataset:
        """Return the prediction as an xarray data set with names, units and labels.

        Returns
        -------
        xarray.Dataset
            The predicted variables with the dimensions (case, time, z), ``area_undeformed``
            (case, z), ``novelty`` (case) and, with samples, ``flow_samples`` and so on
            (sample, case, time, z); the labels are coordinates of ``case``, the units are
            in the attributes.

        Raises
        ------
        MissingExtraError
            If xarray is not installed (extra ``xarray``).
        """
        axes = ("case", "time", "z")
        labels = {name: (axes[:1], column.to_numpy()) for name, column in self.labels.items()}
        coordinates = labels | {name: ((name,), getattr(self, name)) for name in axes[1:]}
        arrays: dict[str, Any] = {name: (axes, v) for name, v in self.variables().items()}
        arrays["area_undeformed"] = axes[::2], self.area_undeformed
        if self.novelty is not None:
            arrays["novelty"] = axes[:1], self.novelty
        arrays |= {f"{k}_samples": (("sample", *axes), v) for k, v in (self.samples or {}).items()}
        dataset = require("xarray", "xarray").Dataset
        result: xarray.Dataset = dataset(arrays, coordinates, {"period": self.period})
        for name, array in result.variables.items():
            if unit := UNITS.get(str(name).removesuffix("_samples")):
                array.attrs["units"] = unit
        return result

    def save(self, path: StrPath) -> list[Path]:
        """Write the prediction to a file in the format that its ending names.

        Parameters
        ----------
        path : path-like
            ``.csv`` (also ``.csv.gz``): the frame; ``.npz`` or ``.h5``: a data set;
            ``.vtp``: a centerline with arrays for each time step, one file for each
            case; ``.pvd``: the same as an animation for ParaView.

        Returns
        -------
        list of Path
            Files that were written.

        Raises
        ------
        FileError
            If the ending is unknown or the file cannot be written.
        InputError
            If the file is a data set, but the prediction has no pressure.
        MissingExtraError
            If VTK is needed and not installed (extra ``vtk``).
        """
        suffix = predictions.check_target(path, self.pressure is not None)
        if suffix in predictions.CENTERLINES:
            return predictions.CENTERLINES[suffix](self, path)
        if suffix == ".csv":
            predictions.save_csv([self], path)
        else:
            self.to_cases().save(path)
        return [Path(path)]

    def to_cases(self) -> Cases:
        """Return the prediction as a data set.

        If the inputs were arrays, each case is a geometry of its own with waveform 0.

        Raises
        ------
        InputError
            If there is no pressure, or a predicted area is not positive.
        """
        if self.pressure is None:
            raise InputError("The model has no pressure stages, so this is not a whole data set.")
        labels = self.labels
        if "geometry" not in labels:
            # Batches number their cases throughout, so that joined files have unique labels.
            numbers = labels.get("case", np.arange(len(self)))
            labels = labels.assign(geometry=numbers + 1, waveform=0)
        arrays: dict[str, Any] = self.variables()
        arrays |= {name: getattr(self, name) for name in ("area_undeformed", "time", "z", "period")}
        # A prediction is checked by its inputs.
        return Cases(**arrays, labels=labels, check=False)
