"""The path from inputs to a prediction, shared by ``PCNDE`` and ``Ensemble``."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import AnyArray, Array, StrPath
from pcnde_bridge._utils.archive import interpreting, read_archive, write_archive
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import check_memory, counted, whole
from pcnde_bridge.config import ClosureConfig, Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import FIELDS, MMHG
from pcnde_bridge.engines import EngineChoice, select_engine
from pcnde_bridge.engines.internal_points import internal_points
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import InputError, PCNDEWarning, SolveError
from pcnde_bridge.hemodynamics.geometry import Vessel
from pcnde_bridge.hemodynamics.outlet import Outlet
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.model.inputs import Inputs, check_cases, check_plausible, inputs_from_arrays
from pcnde_bridge.model.kinds import kind_of
from pcnde_bridge.model.metrics import error_table
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.uncertainty.novelty import EDGE, Novelty, OutsideTrainingWarning
from pcnde_bridge.uncertainty.sampling import RandomNumbers, Uncertainty

Facts = Mapping[str, Any]
Arrays = dict[str, AnyArray]

_USUAL_PRESSURE = 50, 150
"""Usual mean pressures of arteries, mmHg."""


class Predictor(Displayed, ABC):
    """Base class of :class:`PCNDE` and :class:`Ensemble`.

    Attributes
    ----------
    config : PCNDEConfig or ClosureConfig
        Settings of the fit.
    grid : Grid
        Time points (s), axial positions (cm) and period (s) of the training cases.
    engine : Engine
        Engine that computes the predictions.
    novelty : Novelty or None
        Measure of the distance from the training data.
    uncertainty : Uncertainty or None
        Source of the samples of a prediction; only a model of the preset ``physics`` has it.
    file_format : tuple of str, int and str
        Format and version of the file, and its name in messages.
    """

    config: Config
    grid: Grid
    engine: Engine
    novelty: Novelty | None = None
    uncertainty: Uncertainty | None = None
    file_format: ClassVar[tuple[str, int, str]]
    _batch: ClassVar[int] = 256
    _copies = 1  # predictions that are in memory at the same time, without samples

    @property
    @abstractmethod
    def has_pressure(self) -> bool:
        """Whether the pressure is predicted."""

    @property
    def any_grid(self) -> bool:
        """Whether predictions may be on another grid than the training cases (``physics``)."""
        return kind_of(self.config).any_grid

    @abstractmethod
    def _with_outlet(self, inputs: Inputs, outlet: Outlet | None = None) -> Inputs:
        """Add the response of an outlet, or of the one given for the fit, to the inputs."""

    @abstractmethod
    def _solve(self, inputs: Inputs) -> Prediction:
        """Predict from checked inputs."""

    def predict(
        self,
        inflow: npt.ArrayLike | Cases | Waveform | Sequence[Waveform],
        area_undeformed: npt.ArrayLike | Vessel | Sequence[Vessel] | None = None,
        *,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
        outlet: Outlet | None = None,
        units: str | Mapping[str, str] | None = None,
        samples: int = 0,
        seed: int = 0,
    ) -> Prediction:
        """Predict flow, area and pressure.

        Parameters
        ----------
        inflow : array of shape (case, time) or (time,), Waveform, or Cases
            Flow rate at the inlet, mL/s, at the time points of :attr:`grid`; for
            ``Cases``, the flow at their first point.  A model of the preset ``physics``
            accepts any number of equally spaced time points of one cycle; if it differs by a
            tenth or less from that of ``grid``, as without the last point, ``period`` is needed.
        area_undeformed : array of shape (case, z) or (z,), or Vessel
            Undeformed area, cm², at the points of :attr:`grid`, or at ``z``.  A single
            waveform is combined with many geometries, and the other way round.  A
            :class:`~pcnde_bridge.hemodynamics.Vessel` and a
            :class:`~pcnde_bridge.hemodynamics.Waveform`, or lists of them, have their own
            length and period, and may be given in either order.
        z : array of shape (z,), optional
            Axial positions, cm, if they differ from the model's (preset ``physics``).
        period : float, optional
            Period, s, if it differs from the model's (preset ``physics``).
        outlet : Outlet, optional
            Outlet of the vessel, such as :class:`~pcnde_bridge.hemodynamics.Windkessel`, with
            one value or one for each case (preset ``physics``); by default that of the
            training.  Pressures over time have the period of the inflow.
        units : str or mapping, optional
            ``"cgs"``, ``"mm-g-s"`` or ``"si"``, or the units that differ from CGS, such as
            ``{"area": "mm^2"}``, or ``{"radius": "mm"}`` for radii in place of areas.  By
            default all numbers are CGS; those outside the training data are rejected if they
            are implausible, or plausible in other units, or as radii or diameters, as well.
        samples : int
            Number of samples (a model of the preset ``physics``), 0 or at least 2, for the
            result's ``samples``, ``standard_deviation()`` and ``interval()``.  They need the
            memory of that many predictions.  An ensemble's samples are its members.
        seed : int
            Random seed of the samples.

        Returns
        -------
        Prediction
            Arrays of shape (case, time, z), and ``to_frame()``; ``novelty`` is the
            distance of each case from the training data.  An ensemble returns the mean of
            its members; its ``samples`` are the members, rescaled about their mean to the
            calibrated standard deviation.

        Warns
        -----
        OutsideTrainingWarning
            If an input lies outside the training data; the message names the quantities.
        PCNDEWarning
            If an area has kinks or noise, to which a model of the preset ``physics`` is sensitive,
            or if the mean pressure at the inlet is unusual for an artery.

        Raises
        ------
        InputError
            If a shape, the grid or a value is not usable, or the units are ambiguous.
        SolveError
            If the equations diverge for an input.
        """
        if not isinstance(self, Predictor):
            what = "predict needs a model: load_model(path).predict(inflow, area_undeformed)"
            raise InputError(f"{what}, got {self!r:.80}.")
        given = inflow, area_undeformed, z, period, units
        prediction = self._solve(self._prepare(None, samples, seed, outlet, *given))
        _warn_of_pressure(prediction, outlet)
        return prediction

    def predict_batches(
        self,
        inflow: npt.ArrayLike | Waveform | Sequence[Waveform],
        area_undeformed: npt.ArrayLike | Vessel | Sequence[Vessel],
        *,
        batch: int | None = None,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
        outlet: Outlet | None = None,
        units: str | Mapping[str, str] | None = None,
        samples: int = 0,
        seed: int = 0,
    ) -> Iterator[Prediction]:
        """Predict as :meth:`predict` does, batch by batch.

        Only predictions that are still in use need memory: a batch of 256 cases with
        100 time points and 101 points has 62 MB, 10 000 cases have 2.4 GB; each sample and
        each member of an ensemble needs as much again.

        Parameters
        ----------
        inflow, area_undeformed, z, period, outlet, units, samples, seed
            See :meth:`predict`; the samples are the same.
        batch : int, optional
            Number of cases in each prediction; the last may have fewer.  By default 256, and
            64 for an ensemble.

        Returns
        -------
        iterator of Prediction
            Predictions in the order of the cases; the column ``case`` of ``labels``
            numbers all cases.  Each prediction has its own arrays.  Errors and warnings
            about the inputs come before the first prediction.

        Warns
        -----
        OutsideTrainingWarning
            If an input lies outside the training data.

        Raises
        ------
        InputError
            If an input is not usable, or ``batch`` is not a positive whole number.
        SolveError
            If the equations diverge for an input, when its batch is computed.

        Examples
        --------
        >>> for part in model.predict_batches(inflow, area_undeformed):  # doctest: +SKIP
        ...     highest.append(part.pressure.max(axis=(1, 2)))
        """
        size = self._batch if batch is None else whole("batch", batch, 1)
        given = inflow, area_undeformed, z, period, units
        return self._each_batch(self._prepare(size, samples, seed, outlet, *given), size, outlet)

    def _each_batch(self, inputs: Inputs, size: int, outlet: Outlet | None) -> Iterator[Prediction]:
        warned = False
        for start in range(0, len(inputs), size):
            try:
                prediction = self._solve(inputs.select(slice(start, start + size)))
            except SolveError as error:
                raise SolveError(f"In the batch that starts at case {start}: {error}") from error
            warned = warned or _warn_of_pressure(prediction, outlet, start)
            yield prediction

    def _prepare(
        self, batch: int | None, samples: int, seed: int, outlet: Outlet | None, *given: Any
    ) -> Inputs:
        """Check the inputs, score their distance from the training data, generate random numbers.

        At most ``batch`` cases are predicted at once, None for all.  ``given`` are inflow,
        area_undeformed, z, period and units of :meth:`predict`.  The warning of extrapolation
        is attributed to the caller of the calling method.
        """
        inflow, *others = given
        if isinstance(inflow, Cases):
            if any(other is not None for other in others):
                raise InputError("Give cases, or inflow and area_undeformed, not both.")
            self.check_grid(inflow)
            inputs = Inputs.from_cases(inflow)
        else:
            inputs = inputs_from_arrays(self.grid, self.any_grid, *given)
        inputs = self._with_outlet(inputs, outlet)
        samples, at_once = whole("samples", samples), min(batch or len(inputs), len(inputs))
        fields = len(FIELDS) * at_once * inputs.grid.time.size * inputs.grid.z.size
        numbers = (self._copies + samples) * fields + 8 * samples * len(inputs)
        what = f"A prediction of {counted(at_once, 'case')} with {counted(samples, 'sample')}"
        check_memory(what, numbers, "request fewer samples, or use predict_batches or fewer cases")
        random = self._random_numbers(samples, seed, len(inputs))
        scores = self.novelty_scores(inputs.inflow, inputs.area_undeformed, inputs.grid)
        novelty = np.max(list(scores.values()), axis=0) if scores else None
        if isinstance(self.config, ClosureConfig) and (spacing := self.config.losses.spacing):
            rough = internal_points(inputs.grid.z, spacing).is_rough(inputs.area_undeformed)
            if rough.any():
                warnings.warn(
                    f"{rough.sum()} of {len(rough)} areas have kinks or noise (the first in "
                    f"case {np.argmax(rough)}): pressure drop and wall shear stress change with "
                    "them. Smooth the area; interpolate it with a cubic spline, not linearly.",
                    PCNDEWarning,
                    stacklevel=3,
                )
        outside = np.ones(len(inputs), dtype=bool) if novelty is None else novelty > EDGE
        # The novelty of a steady inflow does not depend on the period.
        other = not 0.2 < inputs.grid.period / self.grid.period < 5
        if (other or outside.any()) and not isinstance(inflow, Cases):
            check_plausible(inputs, outside | other, self.novelty)
        if novelty is not None and outside.any():
            worst = int(novelty.argmax())
            beyond = {name: score[worst] for name, score in scores.items() if score[worst] > EDGE}
            ranked = sorted(beyond, key=lambda name: -beyond[name])
            count, verb = outside.sum(), "lies" if outside.sum() == 1 else "lie"
            several = f"{count} of {len(novelty)} cases {verb} outside the training data; "
            several += f"the farthest is case {worst}, in "
            warnings.warn(
                (several if len(novelty) > 1 else "The case lies outside the training data, in ")
                # 1.00 would be inside.
                + ", ".join(f"{name} (score {max(beyond[name], 1.01):.2f})" for name in ranked)
                + "; 1 is the limit of the tested range. The prediction extrapolates.",
                OutsideTrainingWarning,
                stacklevel=3,
            )
        return replace(inputs, random=random, novelty=novelty)

    def _random_numbers(self, samples: int, seed: int, count: int) -> RandomNumbers | None:
        """Return the random numbers of the samples of ``count`` cases."""
        seed = whole("seed", seed)
        if (spread := self.check_samples(samples)) is None:
            return None
        return RandomNumbers.generate(spread, samples, count, np.random.default_rng(seed))

    def check_samples(self, samples: int) -> Uncertainty | None:
        """Return the source of samples, None for no samples, or raise if there is none.

        Raises
        ------
        InputError
            If the model has no samples, or their number is 1.
        """
        if samples == 0:
            return None
        if samples == 1:
            raise InputError(
                "samples must be 0 or at least 2: a standard deviation needs at least two samples."
            )
        if self.uncertainty is None:
            raise InputError(
                "This model has no uncertainty to draw samples from: only the preset 'physics' "
                "has, with at least four training cases and correction.folds > 0. For other "
                "presets fit an ensemble (Ensemble.fit, pcnde fit --members 5), which has "
                "intervals without samples."
            )
        return self.uncertainty

    def check_grid(self, cases: Cases) -> None:
        """Raise unless the model predicts on the grid of these cases.

        Raises
        ------
        InputError
            If the grid is another one; the message names the first difference.
        """
        kind_of(self.config).check_grid(self.grid, cases.grid)

    def novelty_scores(self, inflow: Array, area_undeformed: Array, grid: Grid) -> dict[str, Array]:
        """Score the distance of each case from the training data, for each input.

        Parameters
        ----------
        inflow : array of shape (case, time)
            Flow rate at the inlet, mL/s.
        area_undeformed : array of shape (case, z)
            Undeformed area, cm².
        grid : Grid
            Time points (s), axial positions (cm) and period (s) of the cases.

        Returns
        -------
        dict of str to array of shape (case,)
            Scores by :data:`~pcnde_bridge.uncertainty.novelty.QUANTITIES` and, for models that
            are bound to their grid, of the shapes; 1 is the edge of the
            training data, and the largest is the prediction's ``novelty``.  Empty if the
            model has no record of its training data.
        """
        if self.novelty is None:
            return {}
        scores = self.novelty.score(inflow, area_undeformed, grid)
        if not self.any_grid:
            scores |= self.novelty.score_shapes(inflow, area_undeformed, grid.z)
        return scores

    def evaluate(self, cases: Cases, outlet: Outlet | None = None) -> pd.DataFrame:
        """Return relative errors of the prediction of cases, ‖Y − Y_GT‖ / ‖Y_GT‖.

        The area is compared without the first and last five points.

        Parameters
        ----------
        cases : Cases
            Inputs and reference values.
        outlet : Outlet, optional
            See :meth:`predict`.

        Returns
        -------
        DataFrame
            One row for each case, indexed by geometry and waveform, and a last
            row ``("pooled", "pooled")`` over all cases, as in the paper's table;
            a column for each predicted variable of the cases and for quantities that
            follow from them, such as the ``pressure_drop`` across the stenosis, see
            :func:`~pcnde_bridge.model.metrics.pooled_errors`.

        Raises
        ------
        InputError
            If the model does not predict on the grid of the cases.
        """
        check_cases("The reference of an evaluation", cases)
        return error_table(predict(self, cases, outlet).variables(), cases)

    def save(self, path: StrPath) -> None:
        """Write the model or ensemble into one file, atomically and without pickle.

        Raises
        ------
        FileError
            If the file cannot be written.
        """
        write_archive(path, *self.file_format[:2], *self.to_archive())

    @classmethod
    def load(cls, path: StrPath, engine: EngineChoice = "auto") -> Self:
        """Read a file that :meth:`save` has written.

        Parameters
        ----------
        path : path-like
            File of the model or ensemble.
        engine : {'auto', 'julia', 'jax'} or Engine
            Compute engine of the predictions; may differ from the engine of the fit.

        Raises
        ------
        FileError
            If the file is missing, truncated, foreign, or of a newer version.
        EngineUnavailableError
            If the engine cannot be used.
        """
        return cls.from_archive(*read_archive(path, *cls.file_format), engine, str(path))

    @abstractmethod
    def to_archive(self) -> tuple[dict[str, Any], Arrays]:
        """Return the content of the file: facts for JSON, and arrays."""

    @classmethod
    def from_archive(
        cls, facts: Facts, arrays: Arrays, engine: EngineChoice, where: str = "The archive"
    ) -> Self:
        """Create a model or ensemble from the result of :meth:`to_archive`.

        ``where`` names the source in messages.

        Raises
        ------
        FileError
            If a part is missing or does not fit.
        """
        selected = select_engine(engine)
        with interpreting(where, cls.file_format[2]):
            return cls._from_parts(facts, arrays, selected)

    @classmethod
    @abstractmethod
    def _from_parts(cls, facts: Facts, arrays: Arrays, engine: Engine) -> Self:
        """Create a model or ensemble; raise any error if a part is missing or does not fit."""


def _warn_of_pressure(prediction: Prediction, outlet: Outlet | None, first: int = 0) -> bool:
    """Warn, and return True, if the mean pressure at the inlet is unusual for an artery.

    Inside the training data, pressures are usual for the training's vessels, unless an outlet is
    given.
    """
    if prediction.pressure is None:
        return False
    mean = prediction.pressure[..., 0].mean(axis=1) / MMHG
    low, high = _USUAL_PRESSURE
    new = outlet is not None or prediction.novelty is None or prediction.novelty > EDGE
    unusual = np.flatnonzero(((mean < low) | (mean > high)) & new)
    if not unusual.size:
        return False
    case = int(unusual[0])
    warnings.warn(
        f"The mean pressure at the inlet of case {first + case} is {mean[case]:.0f} mmHg; {low} to "
        f"{high} mmHg are usual in arteries. FFR depends on it, and the outlet determines it: "
        "give the vessel's own (outlet, --outlet).",
        PCNDEWarning,
        stacklevel=3,
    )
    return True


def predict(model: Predictor, cases: Cases, outlet: Outlet | None = None) -> Prediction:
    """Predict cases without a warning of extrapolation, which their errors will show."""
    model.check_grid(cases)
    return model._solve(model._with_outlet(Inputs.from_cases(cases), outlet))
