"""Deep ensembles: several fits from different seeds, and how far they may be off.

The prediction is the mean of the members, which all learn from all training cases.  Their
standard deviation, which grows away from the training data, is calibrated
(:mod:`pcnde_bridge.uncertainty.calibration`) on training cases that were left out,
whole waveforms and whole geometries at a time
(:func:`pcnde_bridge.data.splits.neighboring_folds`): for each part,
a small ensemble is fitted to the rest.  After Lakshminarayanan, Pritzel and Blundell
(2017), with the calibration in place of their variance network.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.archive import (
    archive_kind,
    read_archive,
    write_archive,
)
from pcnde_bridge._utils.parallel import Workers, run
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.config import (
    ClosureConfig,
    PCNDEConfig,
    resolve_config,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.splits import neighboring_folds
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines import EngineName
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import (
    FileError,
    InputError,
    PCNDEWarning,
    TaskError,
)
from pcnde_bridge.model.fit_task import (
    FitTask,
    common_facts,
    fit_model,
    model_of,
    same_everywhere,
)
from pcnde_bridge.model.metrics import error_table
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.training.provenance import provenance
from pcnde_bridge.uncertainty.calibration import Calibration, shared_error

FORMAT, FORMAT_VERSION = "pcnde-ensemble", 1
_LEFT_OUT_FITS = 2  # without each part: the fewest that have a deviation


class Ensemble:
    """Several models of the same cases, with calibrated uncertainty.

    Made by :meth:`fit` or :meth:`load`.

    Attributes
    ----------
    members : tuple of PCNDE
        The models.
    calibration : Calibration
        What makes a deviation of their spread.
    provenance : dict
        What is needed to fit the ensemble again.
    """

    def __init__(
        self,
        members: Sequence[PCNDE],
        calibration: Calibration,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        if len(members) < 2:
            raise InputError(f"An ensemble has at least 2 members, got {len(members)}.")
        if len({(m.grid.time.tobytes(), m.grid.z.tobytes(), m.grid.period) for m in members}) > 1:
            raise InputError("The members were trained on different grids: they have no mean.")
        calibration.check()
        self.members = tuple(members)
        self.calibration = calibration
        self.provenance = dict(provenance or {})

    @classmethod
    def fit(
        cls,
        cases: Cases,
        config: PCNDEConfig | ClosureConfig | str = "fast",
        engine: EngineName | Engine = "auto",
        seed: int = 0,
        *,
        members: int = 5,
        folds: int = 3,
        executor: Workers | None = None,
        retries: int = 1,
        folder: str | os.PathLike[str] | None = None,
        progress: bool = True,
    ) -> Ensemble:
        """Fit the members, and calibrate their spread on training cases left out.

        Parameters
        ----------
        cases : Cases
            The training cases.
        config, engine
            As of :meth:`PCNDE.fit`.
        seed : int
            Of the first member; the others have the next ones.
        members : int
            At least 2.
        folds : int
            Parts into which the geometries, and once more the waveforms, are cut to be
            left out: two fits for each.
        executor, retries, folder, progress
            As of :func:`pcnde_bridge._utils.parallel.run`: the fits are independent.

        Returns
        -------
        Ensemble
            Of the members whose fits succeeded.

        Warns
        -----
        PCNDEWarning
            If some of the fits failed.

        Raises
        ------
        InputError
            If an argument is not usable, or the cases are too few to leave some out.
        TaskError
            If so many fits failed that no ensemble can be made.
        """
        if not isinstance(cases, Cases):
            raise InputError(f"Ensemble.fit needs a Cases, got {type(cases).__name__}.")
        members, folds = whole("members", members, 2), whole("folds", folds, 2)
        seed = whole("seed", seed)
        settings = resolve_config(config)
        engine = same_everywhere(engine)
        left_out = neighboring_folds(cases, folds)
        if not left_out:
            raise InputError(
                f"{len(cases)} cases are too few to leave out {folds} parts: give fewer folds."
            )
        everything = np.arange(len(cases))
        tasks = {f"member {k}": FitTask(cases, settings, engine, seed + k) for k in range(members)}
        for number, positions in enumerate(left_out):
            rest = cases.select(np.setdiff1d(everything, positions))
            for k in range(_LEFT_OUT_FITS):
                tasks[f"without part {number}, {k}"] = FitTask(rest, settings, engine, seed + k)
        outcome = run(
            fit_model,
            tasks,
            executor=executor,
            retries=retries,
            folder=folder,
            facts={
                **common_facts("ensemble", cases, settings, engine),
                "seed": seed,
                "folds": folds,
            },
            progress=progress,
        )
        models = {name: model_of(result, engine) for name, result in outcome.results.items()}
        fitted = [model for name, model in models.items() if name.startswith("member")]
        held = []
        for number, positions in enumerate(left_out):
            names = [f"without part {number}, {k}" for k in range(_LEFT_OUT_FITS)]
            if all(name in models for name in names):
                held.append(([models[name] for name in names], cases.select(positions)))
        if len(fitted) < 2 or not held:
            raise TaskError(f"{outcome.complaint()} The rest make no ensemble.")
        if outcome.failures:
            complaint = f"{outcome.complaint()} The ensemble is without them."
            warnings.warn(complaint, PCNDEWarning, stacklevel=2)
        facts = {
            **provenance(cases, fitted[0].engine, seed),
            "members": len(fitted),
            "folds": folds,
            "failures": outcome.failures,
            "seconds": sum(float(model.provenance["seconds"]) for model in models.values()),
        }
        return cls(fitted, _calibrated(held), facts)

    @property
    def config(self) -> PCNDEConfig | ClosureConfig:
        """Settings of the members."""
        return self.members[0].config

    @property
    def grid(self) -> Grid:
        """Instants (s), points (cm) and period (s) of the training cases."""
        return self.members[0].grid

    @property
    def engine(self) -> Engine:
        """Who computes the predictions."""
        return self.members[0].engine

    @property
    def has_pressure(self) -> bool:
        """Whether the members predict pressure."""
        return self.members[0].has_pressure

    @property
    def any_grid(self) -> bool:
        """Whether the members work on other grids than that of their training."""
        return self.members[0].any_grid

    def predict(
        self,
        inflow: npt.ArrayLike | Cases,
        area_undeformed: npt.ArrayLike | None = None,
        *,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
    ) -> Prediction:
        """Predict flow, area and pressure, with their uncertainty.

        Parameters
        ----------
        inflow, area_undeformed, z, period
            As of :meth:`PCNDE.predict`.

        Returns
        -------
        Prediction
            The mean of the members.  Its ``samples`` are the members, moved away from the
            mean so that their standard deviation is the calibrated one;
            ``standard_deviation()`` and ``interval()`` follow.

        Warns
        -----
        OutsideTrainingWarning
            If an input lies outside the training data.
        """
        return self.members[0].warned(self._predict(inflow, area_undeformed, z, period))

    def predict_batches(
        self,
        inflow: npt.ArrayLike,
        area_undeformed: npt.ArrayLike,
        *,
        batch: int = 64,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
    ) -> Iterator[Prediction]:
        """Predict as :meth:`predict` does, some cases after the others.

        A prediction takes the memory of one of each member and of their mean.

        Parameters
        ----------
        inflow, area_undeformed, batch, z, period
            As of :meth:`PCNDE.predict_batches`.

        Returns
        -------
        iterator of Prediction
            As of :meth:`PCNDE.predict_batches`, with samples.

        Warns
        -----
        OutsideTrainingWarning
            If an input lies outside the training data.

        Raises
        ------
        InputError, SolveError
            As :meth:`PCNDE.predict_batches`.
        """
        given = inflow, area_undeformed, batch, z, period
        # All know the same training data: one warning is enough.
        first = self.members[0].batches(*given, warns=True)
        others = [member.batches(*given, warns=False) for member in self.members[1:]]
        return (self._joined(predictions) for predictions in zip(first, *others, strict=True))

    def _predict(self, *inputs: Any) -> Prediction:
        return self._joined([member.predict_silently(*inputs) for member in self.members])

    def _joined(self, all_of_them: Sequence[Prediction]) -> Prediction:
        """Mean of the members' predictions, and samples with the calibrated deviation."""
        first, count = all_of_them[0], len(all_of_them)
        means, samples = {}, {}
        for name in first.variables():
            values = np.stack([prediction.variables()[name] for prediction in all_of_them])
            means[name] = values.mean(axis=0)
            away = values - means[name]
            spread = values.std(axis=0, ddof=1)
            wanted = self.calibration.standard_deviation(name, spread, first.z)
            # Where the members agree to the last digits, they point nowhere.
            agree = spread <= 1e-12 * np.abs(means[name])
            away = np.where(agree, _directions(count)[:, None, None, None], away)
            samples[name] = means[name] + away * (wanted / np.where(agree, 1.0, spread))
        return replace(first, **means, samples=samples)

    def evaluate(self, cases: Cases) -> pd.DataFrame:
        """Relative errors of the mean; see :meth:`PCNDE.evaluate`."""
        return error_table(self._predict(cases).variables(), cases)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the ensemble into one file, atomically and without pickle.

        Raises
        ------
        FileError
            If the file cannot be written.
        """
        arrays = {"profile": self.calibration.profile, "scale": self.calibration.scale}
        members = []
        for number, member in enumerate(self.members):
            facts, own = member.to_archive()
            members.append(facts)
            arrays |= {f"member_{number}_{name}": array for name, array in own.items()}
        facts = {"members": members, "provenance": self.provenance}
        write_archive(path, FORMAT, FORMAT_VERSION, facts, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str], engine: EngineName | Engine = "auto") -> Ensemble:
        """Read an ensemble back; see :meth:`PCNDE.load`.

        Raises
        ------
        FileError
            If the file is missing, truncated, foreign, or of a newer version.
        """
        facts, arrays = read_archive(path, FORMAT, FORMAT_VERSION, "ensemble")
        try:
            members = []
            for number, own_facts in enumerate(facts["members"]):
                start = f"member_{number}_"
                own = {k.removeprefix(start): v for k, v in arrays.items() if k.startswith(start)}
                members.append(PCNDE.from_archive(own_facts, own, engine, f"{path}, {start[:-1]}"))
            calibration = Calibration(arrays["profile"], arrays["scale"])
            return cls(members, calibration, facts["provenance"])
        except (KeyError, TypeError, InputError) as error:
            raise FileError(f"{path} is not a whole ensemble: {error}.") from error

    def __repr__(self) -> str:
        """Return the number of members, and the first."""
        return f"Ensemble({len(self.members)} × {self.members[0]!r})"


def load_model(
    path: str | os.PathLike[str], engine: EngineName | Engine = "auto"
) -> PCNDE | Ensemble:
    """Read a model or an ensemble, whichever the file holds.

    Raises
    ------
    FileError
        If it holds neither.
    """
    return (Ensemble if archive_kind(path) == FORMAT else PCNDE).load(path, engine)


def _directions(count: int) -> Array:
    """Numbers with the mean 0 and the deviation 1."""
    line = np.arange(count) - (count - 1) / 2
    result: Array = line / line.std(ddof=1)
    return result


def _calibrated(held: Sequence[tuple[Sequence[PCNDE], Cases]]) -> Calibration:
    """Find profile and factor on cases that the models before them have not seen."""
    errors, spreads = [], []
    for models, cases in held:
        found = [model.predict_silently(cases).variables() for model in models]
        values = np.array([[variables[name] for variables in found] for name in VARIABLES])
        true = np.stack([getattr(cases, name) for name in VARIABLES])
        errors.append(np.abs(values.mean(axis=1) - true))
        spreads.append(values.std(axis=1, ddof=1))
    error = np.concatenate(errors, axis=1)
    return Calibration.fit(shared_error(error), error, np.concatenate(spreads, axis=1))
