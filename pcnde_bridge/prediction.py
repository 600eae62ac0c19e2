"""What a model predicts: arrays, and the same as a tidy frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge.cases import Cases
from pcnde_bridge.errors import InputError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Flow, area and pressure over a cycle along the vessel.

    Attributes
    ----------
    flow : array of shape (case, time, z)
        Q, mL/s.
    area : array of shape (case, time, z)
        S, cm².
    pressure : array of shape (case, time, z) or None
        p, dyn/cm²; None from a model without pressure stages.
    area_undeformed : array of shape (case, z)
        S_u, cm², as given.
    time, z : array
        s and cm.
    period : float
        s.
    labels : DataFrame
        One row for each case.
    novelty : array of shape (case,) or None
        How far the inputs lie from the training data; 1 is its edge.
    samples : mapping of str to array of shape (sample, case, time, z), or None
        Draws of flow, area and pressure, if they were asked for.
    """

    flow: Array
    area: Array
    pressure: Array | None
    area_undeformed: Array
    time: Array
    z: Array
    period: float
    labels: pd.DataFrame = field(repr=False)
    novelty: Array | None = field(default=None, repr=False)
    samples: Mapping[str, Array] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.flow)

    def variables(self) -> dict[str, Array]:
        """Return the predicted variables by name, without those that are missing."""
        found = {"flow": self.flow, "area": self.area, "pressure": self.pressure}
        return {name: values for name, values in found.items() if values is not None}

    def deviation(self) -> dict[str, Array]:
        """Return the standard deviation of each variable's draws, (case, time, z).

        Raises
        ------
        InputError
            If the prediction was made without samples.
        """
        return {name: drawn.std(axis=0) for name, drawn in self._drawn().items()}

    def interval(self, level: float = 0.9) -> dict[str, tuple[Array, Array]]:
        """Return the lower and upper limit of each variable, (case, time, z).

        The limits are the prediction, less and plus the deviation times the normal
        quantile: calibrated at 90 % on training cases that were left out.

        Parameters
        ----------
        level : float
            Share of values that should lie inside.

        Raises
        ------
        InputError
            If the level is not between 0 and 1, or there are no samples.
        """
        if not 0 < level < 1:
            raise InputError(f"level must lie between 0 and 1, got {level!r}.")
        factor = NormalDist().inv_cdf((1 + level) / 2)
        width = {name: factor * deviation for name, deviation in self.deviation().items()}
        return {
            name: (values - width[name], values + width[name])
            for name, values in self.variables().items()
        }

    def _drawn(self) -> Mapping[str, Array]:
        if self.samples is None:
            raise InputError(
                "The prediction has no samples: ask for some, predict(..., samples=64)."
            )
        return self.samples

    def to_frame(self) -> pd.DataFrame:
        """Tidy frame: one row for each case, instant and point.

        Returns
        -------
        DataFrame
            Columns of the labels, then ``time`` (s), ``z`` (cm), ``flow`` (mL/s),
            ``area`` (cm²), ``pressure`` (dyn/cm², if predicted) and
            ``area_undeformed`` (cm²); of a prediction with samples, also
            ``flow_deviation`` and so on, in the same units.
        """
        n_cases, n_times, n_points = self.flow.shape
        rows = np.repeat(np.arange(n_cases), n_times * n_points)
        frame = self.labels.iloc[rows].reset_index(drop=True)
        frame["time"] = np.tile(np.repeat(self.time, n_points), n_cases)
        frame["z"] = np.tile(self.z, n_cases * n_times)
        for name, values in self.variables().items():
            frame[name] = values.ravel()
        if self.samples is not None:
            for name, values in self.deviation().items():
                frame[f"{name}_deviation"] = values.ravel()
        frame["area_undeformed"] = np.repeat(self.area_undeformed, n_times, axis=0).ravel()
        return frame

    def to_cases(self) -> Cases:
        """Return the prediction as a data set.

        Of arrays, each case is a geometry of its own, under waveform 0.

        Raises
        ------
        InputError
            If there is no pressure, or a predicted area is not positive.
        """
        if self.pressure is None:
            raise InputError("The model has no pressure stages, so this is not a whole data set.")
        labels = self.labels
        if "geometry" not in labels:
            labels = labels.assign(geometry=np.arange(len(self)), waveform=0)
        return Cases(
            self.flow,
            self.area,
            self.pressure,
            self.area_undeformed,
            self.time,
            self.z,
            period=self.period,
            labels=labels,
        )
