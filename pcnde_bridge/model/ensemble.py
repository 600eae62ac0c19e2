"""Deep ensembles: fits with different seeds, and a calibrated uncertainty from their spread.

The prediction is the mean of the members, which are all trained on all training cases.
Their standard deviation, which grows away from the training data, is calibrated
(:mod:`pcnde_bridge.uncertainty.calibration`) on training cases that were left out,
whole waveforms and whole geometries at a time
(:func:`pcnde_bridge.data.splits.neighboring_folds`): for each fold,
a small ensemble is fitted to the rest.  After Lakshminarayanan, Pritzel and Blundell
(2017), with the calibration in place of their variance network.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self, Unpack

import numpy as np

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.archive import archive_kind, with_prefix
from pcnde_bridge._utils.parallel import RunOptions, run
from pcnde_bridge._utils.validation import all_of, whole
from pcnde_bridge.config import Config, resolve_config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.splits import neighboring_folds
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines import EngineChoice
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import InputError, PCNDEWarning, TaskError
from pcnde_bridge.hemodynamics.outlet import Outlet
from pcnde_bridge.model.fit_task import FitTask, common_facts, fit_model, model_of, same_everywhere
from pcnde_bridge.model.inputs import Inputs, check_cases
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.predictor import Arrays, Facts, Predictor, predict
from pcnde_bridge.training.provenance import provenance as current_provenance
from pcnde_bridge.training.provenance import provenance_from
from pcnde_bridge.uncertainty.calibration import (
    Calibration,
    amplitude,
    fit_scales,
    relative_amplitude,
    shared_error,
)

MEMBER_PREFIX = "member_{}_"  # of the names of a member's arrays in the file
_FITS_PER_FOLD = 2  # the fewest that have a standard deviation


@dataclass(eq=False, repr=False)
class Ensemble(Predictor):
    """Several models of the same cases, with calibrated uncertainty.

    Create an ensemble by :meth:`fit` or :meth:`load`.

    Attributes
    ----------
    members : tuple of PCNDE
        Models; configuration, grid and engine of the ensemble are those of the first.
    calibration : Calibration
        Relation between the spread of the members and the standard deviation.
    provenance : dict
        Facts needed to reproduce the fit.
    """

    file_format = "pcnde-ensemble", 1, "ensemble"
    _batch = 64

    members: Sequence[PCNDE]
    calibration: Calibration
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.members = all_of(PCNDE, "Ensemble.members", self.members)
        if len(self.members) < 2:
            raise InputError(f"An ensemble needs at least 2 members, got {len(self.members)}.")
        grids = {(m.grid.time.tobytes(), m.grid.z.tobytes(), m.grid.period) for m in self.members}
        if len(grids) > 1:
            raise InputError(
                "The members were trained on different grids: they cannot be averaged."
            )
        if not isinstance(self.calibration, Calibration):
            raise InputError("Ensemble.calibration must be a Calibration: use Ensemble.fit.")
        self.calibration.check()
        self.provenance = dict(self.provenance)
        first = self.members[0]
        self.config, self.grid, self.engine = first.config, first.grid, first.engine
        self.novelty = first.novelty  # all members have the same training cases
        self._copies = 1 + 3 * len(self.members)

    @classmethod
    def fit(
        cls,
        cases: Cases,
        config: Config | str = "fast",
        engine: EngineChoice = "auto",
        seed: int = 0,
        *,
        members: int = 5,
        folds: int = 3,
        outlet: Outlet | None = None,
        **options: Unpack[RunOptions],
    ) -> Ensemble:
        """Fit the members, and calibrate their spread on training cases that are left out.

        Parameters
        ----------
        cases : Cases
            Training cases.
        config, engine
            See :meth:`PCNDE.fit`.
        seed : int
            Random seed of the first member; the others have the following seeds.
        members : int
            Number of members, at least 2.
        folds : int
            Number of folds of the geometries and of the waveforms; two fits omit each.
        outlet : Outlet, optional
            See :meth:`PCNDE.fit`.
        **options
            ``executor``, ``retries``, ``folder`` and ``progress``, see
            :func:`pcnde_bridge._utils.parallel.run`.

        Returns
        -------
        Ensemble
            Ensemble of the members whose fits succeeded.

        Warns
        -----
        PCNDEWarning
            If some of the fits failed.

        Raises
        ------
        InputError
            If an argument is not usable, or the cases are too few to leave some out.
        TaskError
            If too few fits succeeded for an ensemble.
        """
        check_cases("The cases of a fit", cases)
        members, folds = whole("members", members, 2), whole("folds", folds, 2)
        seed = whole("seed", seed)
        settings = resolve_config(config)
        engine = same_everywhere(engine)
        left_out = neighboring_folds(cases, folds)
        if not left_out:
            raise InputError(f"{len(cases)} cases are too few for {folds} folds: give fewer folds.")
        facts = common_facts("ensemble", cases, settings, engine, outlet)
        facts |= {"seed": seed, "folds": folds}
        tasks = {
            f"member {k}": FitTask(cases, settings, engine, seed + k, outlet=outlet)
            for k in range(members)
        }
        fits_of_folds = []
        for number, positions in enumerate(left_out):
            others = np.setdiff1d(np.arange(len(cases)), positions)
            rest, of_rest = cases.select(others), outlet and outlet.select(others)
            names = [f"without fold {number}, {k}" for k in range(_FITS_PER_FOLD)]
            for k, name in enumerate(names):
                tasks[name] = FitTask(rest, settings, engine, seed + k, outlet=of_rest)
            fold = cases.select(positions), outlet and outlet.select(positions)
            fits_of_folds.append((names, *fold))
        outcome = run(fit_model, tasks, facts=facts, **options)
        models = {name: model_of(result, engine) for name, result in outcome.results.items()}
        fitted = [model for name, model in models.items() if name.startswith("member")]
        complete = [
            ([models[name] for name in names], *fold)
            for names, *fold in fits_of_folds
            if models.keys() >= set(names)
        ]
        if len(fitted) < 2 or not complete:
            raise TaskError(f"{outcome.complaint()} Too few fits remain for an ensemble.")
        if outcome.failures:
            message = f"{outcome.complaint()} The ensemble does not contain them."
            warnings.warn(message, PCNDEWarning, stacklevel=2)
        provenance = current_provenance(cases, fitted[0].engine, seed) | {
            "members": len(fitted),
            "folds": folds,
            "failures": outcome.failures,
            "seconds": sum(float(model.provenance["seconds"]) for model in models.values()),
        }
        return cls(fitted, _calibrate(complete), provenance)

    @property
    def has_pressure(self) -> bool:
        """Whether the members predict the pressure."""
        return self.members[0].has_pressure

    def _with_outlet(self, inputs: Inputs, outlet: Outlet | None = None) -> Inputs:
        return self.members[0]._with_outlet(inputs, outlet)

    def _solve(self, inputs: Inputs) -> Prediction:
        """Average the members' predictions; spread them to the calibrated standard deviation."""
        predictions = [member._solve(inputs) for member in self.members]
        first, count = predictions[0], len(predictions)
        # Numbers with mean 0 and standard deviation 1, for members that agree up to round-off
        # and so have no direction from their mean.
        line = np.arange(count) - (count - 1) / 2
        directions = (line / line.std(ddof=1))[:, None, None, None]
        means, samples = {}, {}
        for name in first.variables():
            values = np.stack([prediction.variables()[name] for prediction in predictions])
            mean, spread = values.mean(axis=0), values.std(axis=0, ddof=1)
            means[name] = mean
            if name not in VARIABLES:
                continue  # not calibrated
            wanted = self.calibration.standard_deviation(name, spread, inputs.inflow, first.z)
            agree = spread <= 1e-12 * np.abs(mean)
            away = np.where(agree, directions, values - mean)
            samples[name] = mean + away * (wanted / np.where(agree, 1.0, spread))
        return replace(first, **means, samples=samples, calibrated=True)

    def to_archive(self) -> tuple[dict[str, Any], Arrays]:
        """Return the content of the ensemble's file: facts for JSON, and arrays."""
        arrays: Arrays = dict(vars(self.calibration))
        members = []
        for number, member in enumerate(self.members):
            facts, own = member.to_archive()
            members.append(facts)
            arrays |= {f"{MEMBER_PREFIX.format(number)}{name}": a for name, a in own.items()}
        return {"members": members, "provenance": self.provenance}, arrays

    @classmethod
    def _from_parts(cls, facts: Facts, arrays: Arrays, engine: Engine) -> Self:
        members = [
            PCNDE._from_parts(member, with_prefix(MEMBER_PREFIX.format(number), arrays), engine)
            for number, member in enumerate(facts["members"])
        ]
        calibration = Calibration(*(arrays[f.name] for f in fields(Calibration)))
        return cls(members, calibration, provenance_from(facts["provenance"]))

    def _facts(self) -> list[str]:
        return [f"{len(self.members)} × {self.members[0]!r}"]


def load_model(path: StrPath, engine: EngineChoice = "auto") -> PCNDE | Ensemble:
    """Read a model or an ensemble, whichever the file holds.

    Raises
    ------
    FileError
        If it holds neither.
    """
    kind = Ensemble if archive_kind(path) == Ensemble.file_format[0] else PCNDE
    return kind.load(path, engine)


def _calibrate(folds: Sequence[Any]) -> Calibration:
    """Fit profile and scale on folds: models, cases on which they were not trained, outlet."""
    errors, spreads = [], []
    for models, cases, outlet in folds:
        found = [predict(model, cases, outlet).variables() for model in models]
        values = np.array([[variables[name] for variables in found] for name in VARIABLES])
        true = np.stack([getattr(cases, name) for name in VARIABLES])
        errors.append(np.abs(values.mean(axis=1) - true))
        spreads.append(values.std(axis=1, ddof=1))
    error, spread = np.concatenate(errors, axis=1), np.concatenate(spreads, axis=1)
    inflow = np.concatenate([cases.inflow for _, cases, _ in folds])
    reference = amplitude(inflow)
    relative = relative_amplitude(inflow, reference)
    profile = shared_error(error, relative)
    return Calibration(profile, fit_scales(profile, error, spread, relative)[0], reference)
