"""The path from inputs to a prediction, shared by ``PCNDE`` and ``Ensemble``."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.units import SYSTEMS
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import InputError, SolveError
from pcnde_bridge.model.inputs import Inputs, check_plausible, inputs_from_arrays, inputs_from_cases
from pcnde_bridge.model.kinds import kind_of
from pcnde_bridge.model.metrics import error_table
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.uncertainty.novelty import EDGE, Novelty, OutsideTrainingWarning
from pcnde_bridge.uncertainty.sampling import RandomNumbers, Uncertainty

_PERIOD_EDGE = 0.1  # relative difference of the period that scores 1


class Predictor(ABC):
    """Common part of a model and an ensemble.

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
    """

    config: Config
    grid: Grid
    engine: Engine
    novelty: Novelty | None = None
    uncertainty: Uncertainty | None = None

    @property
    @abstractmethod
    def has_pressure(self) -> bool:
        """Whether the pressure is predicted."""

    @property
    def any_grid(self) -> bool:
        """Whether predictions may be on another grid than the training cases (``physics``)."""
        return kind_of(self.config).any_grid

    @abstractmethod
    def _solve(self, inputs: Inputs) -> Prediction:
        """Predict from checked inputs."""

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
            Scores of ``inflow``, ``undeformed area`` and ``period``; 1 is the edge of the
            training data, and the largest is the prediction's ``novelty``.  Empty if the
            model has no record of its training data.
        """
        if self.novelty is None:
            return {}
        of_inflow, of_area = self.novelty.score(inflow, area_undeformed, grid.z)
        of_period = abs(grid.period / self.grid.period - 1) / _PERIOD_EDGE
        period = np.full(len(inflow), of_period)
        return {"inflow": of_inflow, "undeformed area": of_area, "period": period}

    def evaluate(self, cases: Cases) -> pd.DataFrame:
        """Return relative errors of the prediction of cases, ‖Y − Y_GT‖ / ‖Y_GT‖.

        The area is compared without the first and last five points.

        Parameters
        ----------
        cases : Cases
            Inputs and reference values.

        Returns
        -------
        DataFrame
            One row for each case, indexed by geometry and waveform, and a last
            row ``("pooled", "pooled")`` over all cases, as in the paper's table;
            a column for each predicted variable and, with a pressure, for the
            ``pressure_drop`` across the stenosis and for 1 − FFR (``one_minus_ffr``), see
            :func:`~pcnde_bridge.model.metrics.pooled_errors`.

        Raises
        ------
        InputError
            If the model does not predict on the grid of the cases.
        """
        if not isinstance(cases, Cases):
            raise InputError(
                f"evaluate needs Cases, which hold the reference values, got {type(cases)}."
            )
        return error_table(predict(self, cases).variables(), cases)


def predict(model: Predictor, cases: Cases) -> Prediction:
    """Predict cases without a warning of extrapolation, which their errors will show."""
    return model._solve(prepare(model, cases))


def prepare(
    model: Predictor,
    inflow: npt.ArrayLike | Cases,
    area_undeformed: npt.ArrayLike | None = None,
    z: npt.ArrayLike | None = None,
    period: float | None = None,
    units: str | Mapping[str, str] | None = None,
    samples: int = 0,
    seed: int = 0,
    *,
    warn: bool = False,
) -> Inputs:
    """Check the inputs, score their distance from the training data, generate random numbers.

    The arguments are those of :meth:`pcnde_bridge.PCNDE.predict`; ``warn`` is whether to warn
    of extrapolation; the warning is attributed to the caller of the calling method.
    """
    if isinstance(inflow, Cases):
        if any(given is not None for given in (area_undeformed, z, period, units)):
            raise InputError("Give cases, or inflow and area_undeformed, not both.")
        model.check_grid(inflow)
        inputs = inputs_from_cases(inflow)
    else:
        given = inflow, area_undeformed, z, period, units
        inputs = inputs_from_arrays(*given, model.grid, model.any_grid)
    random = _random_numbers(model.uncertainty, samples, seed, len(inputs))
    scores = model.novelty_scores(inputs.inflow, inputs.area_undeformed, inputs.grid)
    novelty = np.max(list(scores.values()), axis=0) if scores else None
    beyond = np.ones(len(inputs), dtype=bool) if novelty is None else novelty > EDGE
    outside = int(beyond.sum())
    if outside and not isinstance(inflow, Cases):
        known = set(SYSTEMS["cgs"]) if isinstance(units, str) else set(units or ())
        known |= {name for name, given in (("z", z), ("time", period)) if given is None}
        _check_plausible(model, inputs, beyond, known)
    if novelty is None:
        return replace(inputs, random=random)
    if warn and outside:
        worst = int(novelty.argmax())
        farthest = max(scores, key=lambda name: float(scores[name][worst]))
        warnings.warn(
            f"{outside} of {len(novelty)} cases lie outside the training data, most of all "
            f"case {worst} with its {farthest} (score {novelty[worst]:.2f}; 1 is the edge of the "
            "training data). The prediction extrapolates.",
            OutsideTrainingWarning,
            stacklevel=3,
        )
    return replace(inputs, random=random, novelty=novelty)


def _check_plausible(
    model: Predictor, inputs: Inputs, chosen: npt.NDArray[np.bool_], known: set[str]
) -> None:
    """Check the units of chosen cases, those outside the training data."""
    few = replace(
        inputs,
        inflow=inputs.inflow[chosen],
        area_undeformed=inputs.area_undeformed[chosen],
    )
    novelty = model.novelty
    score = None if novelty is None else lambda area: novelty.score(few.inflow, area, few.grid.z)[1]
    check_plausible(few, known, score)


def in_batches(model: Predictor, inputs: Inputs, batch: int) -> Iterator[Prediction]:
    """Predict batch by batch, from inputs that were arrays."""
    for start in range(0, len(inputs), batch):
        try:
            yield model._solve(inputs.rows(start, start + batch))
        except SolveError as error:
            raise SolveError(f"In the batch that starts at case {start}: {error}") from error


def _random_numbers(
    uncertainty: Uncertainty | None, samples: int, seed: int, count: int
) -> RandomNumbers | None:
    samples, seed = whole("samples", samples), whole("seed", seed)
    if samples == 0:
        return None
    if samples == 1:
        raise InputError(
            "samples must be 0 or at least 2: a standard deviation needs at least two samples."
        )
    if uncertainty is None:
        raise InputError(
            "This model has no uncertainty to draw samples from. Fit it with the preset "
            "'physics' (and correction.folds > 0)."
        )
    return RandomNumbers.generate(uncertainty, samples, count, np.random.default_rng(seed))
