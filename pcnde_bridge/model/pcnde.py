"""PCNDE: the model that is fitted to 3D simulations and predicts their 1D averages."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge._utils.validation import positive, real_array, whole
from pcnde_bridge.config import (
    PUBLISHED_CODE,
    ClosureConfig,
    PCNDEConfig,
    config_from,
    resolve_config,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import (
    Grid,
    check_grid,
    check_resolution,
)
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.engines import EngineName, select_engine
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import (
    FileError,
    InputError,
    SolveError,
)
from pcnde_bridge.model.metrics import error_table
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.published_weights import read_published_weights
from pcnde_bridge.training import history as histories
from pcnde_bridge.training import recipes
from pcnde_bridge.training.history import Iteration
from pcnde_bridge.training.provenance import provenance
from pcnde_bridge.uncertainty.novelty import (
    EDGE,
    Novelty,
    OutsideTrainingWarning,
)
from pcnde_bridge.uncertainty.sampling import (
    RandomNumbers,
    Uncertainty,
    sample,
)

FORMAT, FORMAT_VERSION = "pcnde-model", 1
_PERIOD_EDGE = 0.1  # relative difference of the period that scores 1
# pandas takes longer to make these names than a case takes to be predicted.
_CASE = pd.Index(["case"])

_Part = TypeVar("_Part", Uncertainty, Novelty)


class PCNDE:
    """Physics-constrained coupled neural differential equations of one vessel type.

    Made by :meth:`fit`, :meth:`load` or :meth:`from_published_weights`.

    Attributes
    ----------
    config : PCNDEConfig or ClosureConfig
        Settings of the fit.
    parameters : Parameters or ClosureParameters
        The learnt numbers.
    grid : Grid
        Instants (s), points (cm) and period (s) of the training cases.
    engine : Engine
        Computes the predictions.
    provenance : dict
        What is needed to run the fit again: seed, batches, labels and
        fingerprint of the cases, engine, versions, command, time.
    uncertainty : Uncertainty or None
        What samples of a prediction are made of; the ``physics`` preset has it.
    novelty : Novelty or None
        Tells whether an input lies outside the training data.
    """

    def __init__(
        self,
        config: PCNDEConfig | ClosureConfig,
        parameters: Parameters | ClosureParameters,
        grid: Grid,
        engine: Engine,
        provenance: Mapping[str, Any] | None = None,
        history: tuple[Iteration, ...] = (),
        uncertainty: Uncertainty | None = None,
        novelty: Novelty | None = None,
    ) -> None:
        recipes.check(config, parameters, grid)
        self.config = config
        self.parameters = parameters
        self.grid = grid
        self.engine = engine
        self.provenance = dict(provenance or {})
        self.uncertainty = uncertainty
        self.novelty = novelty
        self._history = history

    @classmethod
    def fit(
        cls,
        cases: Cases,
        config: PCNDEConfig | ClosureConfig | str = "paper",
        engine: EngineName | Engine = "auto",
        seed: int = 0,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: bool | Callable[[Iteration], None] = True,
    ) -> PCNDE:
        """Train on averaged 3D simulations, as section 2.4 of the paper does.

        Parameters
        ----------
        cases : Cases
            The training cases.
        config : PCNDEConfig, ClosureConfig or str
            Settings, or a preset's name: ``paper`` as published; ``fast`` the same
            equations trained in seconds; ``physics`` the most accurate, on any
            grid, with uncertainty.
        engine : {'auto', 'julia', 'jax'} or Engine
            Who computes; see :func:`pcnde_bridge.engines.select_engine`.
        seed : int
            Gives the first weights and the order of the batches.  The same seed
            on the same machine and engine gives the same bits.
        checkpoint : path-like, optional
            File that keeps the state of training after every epoch.  If it
            exists, training continues from it, to the same result as without
            the interruption, bit for bit.  Ctrl-C writes it too.  The state
            before is kept beside it (``.previous``), should it be damaged.
        progress : bool or callable
            Show progress, or call with every
            :class:`~pcnde_bridge.training.history.Iteration`.

        Returns
        -------
        PCNDE
            The fitted model.

        Raises
        ------
        InputError
            If cases and configuration do not fit together, or the checkpoint
            belongs to another run.
        FileError
            If the checkpoint cannot be read or written.
        EngineUnavailableError
            If the engine asked for cannot be used.
        SolveError
            If an equation diverges.

        Examples
        --------
        >>> from pcnde_bridge import PCNDE, load_cases
        >>> train, test = load_cases("published").split("paper")  # doctest: +SKIP
        >>> model = PCNDE.fit(train)  # doctest: +SKIP
        >>> model.evaluate(test)  # doctest: +SKIP
        """
        if not isinstance(cases, Cases):
            raise InputError(
                f"PCNDE.fit needs a Cases, got {type(cases).__name__}. "
                "Make one with load_cases(path) or Cases(flow=..., ...)."
            )
        seed = whole("seed", seed)
        settings = resolve_config(config)
        engine = select_engine(engine)
        trained = recipes.train(cases, settings, engine, seed, checkpoint, progress)
        return cls(
            trained.config,
            trained.parameters,
            cases.grid,
            engine,
            {**provenance(cases, engine, seed), **trained.facts},
            trained.history,
            trained.uncertainty,
            Novelty.fit(cases.inflow, cases.area_undeformed, cases.z),
        )

    @classmethod
    def from_published_weights(
        cls,
        folder: str | os.PathLike[str],
        config: PCNDEConfig = PUBLISHED_CODE,
        engine: EngineName | Engine = "auto",
    ) -> PCNDE:
        """Model with the authors' published weights of flow and area.

        It works on the grid of the published data, with the published code's
        form of the Fourier area, and solves at rtol 1e-6.  It predicts no
        pressure: the weights behind the paper's pressure are not published.

        Parameters
        ----------
        folder : path-like
            Holds the ``.jld2`` files, itself or in ``trained_weights``.
        config : PCNDEConfig
            Settings; the published code's by default.
        engine : {'auto', 'julia', 'jax'} or Engine
            Who computes.

        Raises
        ------
        FileError
            If the files are missing or damaged.
        """
        from pcnde_bridge.data.published import (
            DT,
            DZ,
            PERIOD,
            SHAPE,
        )

        if config is PUBLISHED_CODE:
            config = PUBLISHED_CODE.replace(flow={"rtol": 1e-6, "atol": 1e-9})
        _, n_times, n_points = SHAPE
        grid = Grid(DT * np.arange(float(n_times)), DZ * np.arange(float(n_points)), PERIOD)
        parameters = read_published_weights(folder)
        return cls(config, parameters, grid, select_engine(engine), {"source": "published weights"})

    @property
    def history(self) -> pd.DataFrame:
        """Every iteration of the fit: stage, epoch, batch, iteration, loss, seconds."""
        return histories.to_frame(self._history)

    @property
    def has_pressure(self) -> bool:
        """Whether the pressure stages are there."""
        return isinstance(self.parameters, ClosureParameters) or self.parameters.has_pressure

    def predict(
        self,
        inflow: npt.ArrayLike | Cases,
        area_undeformed: npt.ArrayLike | None = None,
        *,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
        samples: int = 0,
        seed: int = 0,
    ) -> Prediction:
        """Predict flow, area and pressure.

        Parameters
        ----------
        inflow : array of shape (case, time) or (time,), or Cases
            Q at the inlet, mL/s, at the model's instants (:attr:`grid`); from
            cases, their flow at the first point.  A model of the ``physics``
            preset takes any number of equally spaced instants of one cycle.
        area_undeformed : array of shape (case, z) or (z,)
            S_u, cm², at the model's points, or at ``z``.  One waveform goes with
            many geometries and the other way round.
        z : array of shape (z,), optional
            Points, cm, where they are not the model's (``physics`` preset).
        period : float, optional
            s, where it is not the model's (``physics`` preset).
        samples : int
            Draws of the prediction (``physics`` preset), at least 2: the result's ``samples``,
            ``standard_deviation()`` and ``interval()``.  They take memory of that many
            predictions.
        seed : int
            Of the draws.

        Returns
        -------
        Prediction
            Arrays (case, time, z), and ``to_frame()``; ``novelty`` says how far each
            case lies from the training data.

        Warns
        -----
        OutsideTrainingWarning
            If an input lies outside the training data, or the period is more than a
            tenth off, which is where it scores 1.

        Raises
        ------
        InputError
            If shapes or the grid are not the model's, or a value is not usable.
        SolveError
            If the equations diverge for an input.
        """
        return self.warned(self.predict_silently(inflow, area_undeformed, z, period, samples, seed))

    def predict_silently(
        self,
        inflow: npt.ArrayLike | Cases,
        area_undeformed: npt.ArrayLike | None = None,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
        samples: int = 0,
        seed: int = 0,
    ) -> Prediction:
        """Predict as :meth:`predict` does, without its warning of extrapolation."""
        if isinstance(inflow, Cases):
            if area_undeformed is not None or z is not None or period is not None:
                raise InputError("Give cases, or inflow and area_undeformed, not both.")
            return self._predict_cases(inflow, samples, seed)
        q, s_u, grid = self._inputs(inflow, area_undeformed, z, period)
        numbers, score = self._random_numbers(samples, seed, len(q)), self._score(q, s_u, grid)
        return self._predict(q, s_u, grid, _numbered(0, len(q)), score, numbers)

    def predict_batches(
        self,
        inflow: npt.ArrayLike,
        area_undeformed: npt.ArrayLike,
        *,
        batch: int = 256,
        z: npt.ArrayLike | None = None,
        period: float | None = None,
        samples: int = 0,
        seed: int = 0,
    ) -> Iterator[Prediction]:
        """Predict as :meth:`predict` does, some cases after the others.

        Only the predictions that are still referred to take memory: a batch of 256 cases of
        100 instants and 101 points has 62 MB, where 10 000 cases have 2.4 GB, and so has each
        sample.

        Parameters
        ----------
        inflow, area_undeformed, z, period, samples, seed
            As of :meth:`predict`; the draws are the same.
        batch : int
            Cases in each prediction; fewer in the last.

        Returns
        -------
        iterator of Prediction
            In the order of the cases; the column ``case`` of ``labels`` counts all.
            Arrays are each prediction's own.  What is wrong with the inputs is raised,
            and warned of, before the first.

        Warns
        -----
        OutsideTrainingWarning
            If an input lies outside the training data.

        Raises
        ------
        InputError
            As :meth:`predict`, or if ``batch`` is not a positive whole number.
        SolveError
            If the equations diverge for an input; when its batch is asked for.

        Examples
        --------
        >>> for part in model.predict_batches(inflow, area_undeformed):  # doctest: +SKIP
        ...     highest.append(part.pressure.max(axis=(1, 2)))
        """
        return self.batches(inflow, area_undeformed, batch, z, period, samples, seed, warns=True)

    def batches(
        self,
        inflow: npt.ArrayLike,
        area_undeformed: npt.ArrayLike,
        batch: int,
        z: npt.ArrayLike | None,
        period: float | None,
        samples: int = 0,
        seed: int = 0,
        *,
        warns: bool,
    ) -> Iterator[Prediction]:
        """Predict as :meth:`predict_batches` does, and warn its caller or nobody."""
        batch = whole("batch", batch, 1)
        q, s_u, grid = self._inputs(inflow, area_undeformed, z, period)
        numbers, score = self._random_numbers(samples, seed, len(q)), self._score(q, s_u, grid)
        if warns:
            self._warn(score, q, s_u, grid, level=4)

        def predictions() -> Iterator[Prediction]:
            for start in range(0, len(q), batch):
                rows = slice(start, min(start + batch, len(q)))
                labels = _numbered(rows.start, rows.stop)
                novelty = None if score is None else score[rows]
                some = None if numbers is None else numbers.select(rows)
                try:
                    yield self._predict(q[rows], s_u[rows], grid, labels, novelty, some)
                except SolveError as error:
                    raise SolveError(
                        f"Of the batch that begins with case {start}: {error}"
                    ) from error

        return predictions()

    def _inputs(
        self,
        inflow: npt.ArrayLike,
        area_undeformed: npt.ArrayLike | None,
        z: npt.ArrayLike | None,
        period: float | None,
    ) -> tuple[Array, Array, Grid]:
        """Validate inputs, and return them case by case with their grid."""
        if area_undeformed is None:
            raise InputError("predict needs area_undeformed beside the inflow.")
        grid = self._grid_of(inflow, z, period)
        q = _rows("inflow", inflow, grid.time.size, "instants")
        s_u = _rows("area_undeformed", area_undeformed, grid.z.size, "points")
        if (s_u <= 0).any():
            case, point = np.argwhere(s_u <= 0)[0]
            raise InputError(
                f"area_undeformed[{case}, {point}] is {s_u[case, point]}; areas are positive (cm²)."
            )
        count = max(len(q), len(s_u))
        if not {len(q), len(s_u)} <= {1, count}:
            raise InputError(
                f"inflow has {len(q)} cases and area_undeformed {len(s_u)}: give as many of one "
                "as of the other, or a single one."
            )
        q, s_u = (np.repeat(a, count, axis=0) if len(a) < count else a for a in (q, s_u))
        return q, s_u, grid

    def _predict_cases(self, cases: Cases, samples: int, seed: int) -> Prediction:
        self.check_grid(cases)
        grid = cases.grid
        inputs = cases.inflow, cases.area_undeformed
        score = self._score(*inputs, grid)
        labels = cases.labels.drop(columns=list(SOLVER_LABELS), errors="ignore")
        numbers = self._random_numbers(samples, seed, len(cases))
        return self._predict(*inputs, grid, labels, score, numbers)

    @property
    def any_grid(self) -> bool:
        """Whether the model works on other grids than that of its training (``physics``)."""
        return isinstance(self.config, ClosureConfig)

    def _grid_of(
        self, inflow: npt.ArrayLike, z: npt.ArrayLike | None, period: float | None
    ) -> Grid:
        """Grid of a prediction from arrays."""
        if not self.any_grid:
            if z is not None or period is not None:
                raise InputError(
                    "This model works on the points and the period of its training only: leave z "
                    "and period out. A model of the physics preset takes others."
                )
            return self.grid
        shape = np.shape(inflow)
        n_times = shape[-1] if shape else 0
        points: Array = self.grid.z
        if z is not None:
            points = _rows("z", z, np.size(z), "points")[0]
            if (np.diff(points) <= 0).any():
                raise InputError("z must increase.")
        check_resolution(n_times, points.size)
        cycle = self.grid.period if period is None else positive("period", period, "s")
        time = self.grid.time[0] + np.arange(float(n_times)) * (cycle / n_times)
        return Grid(time, points, cycle)

    def _random_numbers(self, samples: int, seed: int, count: int) -> RandomNumbers | None:
        """Random numbers of the draws for all cases, or None for no draws."""
        samples, seed = whole("samples", samples), whole("seed", seed)
        if samples == 0:
            return None
        if samples == 1:
            raise InputError("samples must be 0 or at least 2: one draw has no deviation.")
        if self.uncertainty is None:
            raise InputError(
                "This model has no uncertainty to draw samples from. Fit it with the preset "
                "'physics' (and correction.folds > 0)."
            )
        return RandomNumbers.generate(self.uncertainty, samples, count, np.random.default_rng(seed))

    def _predict(
        self,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        labels: pd.DataFrame,
        score: Array | None,
        numbers: RandomNumbers | None,
    ) -> Prediction:
        args = inflow, area_undeformed, grid
        solution = recipes.predict(self.engine, self.config, self.parameters, *args)
        drawn = None
        if numbers is not None:
            assert self.uncertainty is not None
            assert isinstance(self.config, ClosureConfig)
            assert isinstance(self.parameters, ClosureParameters)
            drawn = sample(
                self.engine.closures,
                self.parameters,
                self.uncertainty,
                solution,
                *args,
                self.config,
                numbers,
            )
        return Prediction(
            *solution, area_undeformed, grid.time, grid.z, grid.period, labels, score, drawn
        )

    def warned(self, prediction: Prediction) -> Prediction:
        """Warn the caller's caller, who called :meth:`predict`, of inputs outside the training."""
        p = prediction
        self._warn(
            p.novelty, p.flow[:, :, 0], p.area_undeformed, Grid(p.time, p.z, p.period), level=4
        )
        return p

    def novelty_scores(self, inflow: Array, area_undeformed: Array, grid: Grid) -> dict[str, Array]:
        """Say how far each case lies from the training data, by what of it.

        Parameters
        ----------
        inflow : array of shape (case, time)
            Q at the inlet, mL/s.
        area_undeformed : array of shape (case, z)
            S_u, cm².
        grid : Grid
            Of the cases: instants, points and period.

        Returns
        -------
        dict of str to array of shape (case,)
            Scores of ``inflow``, ``undeformed area`` and ``period``; 1 is the edge of the
            training data, and the largest is the prediction's ``novelty``.  Empty if the
            model does not know its training data.
        """
        if self.novelty is None:
            return {}
        of_inflow, of_area = self.novelty.score(inflow, area_undeformed, grid.z)
        of_period = abs(grid.period / self.grid.period - 1) / _PERIOD_EDGE
        return {
            "inflow": of_inflow,
            "undeformed area": of_area,
            "period": np.full(len(inflow), of_period),
        }

    def _score(self, inflow: Array, area_undeformed: Array, grid: Grid) -> Array | None:
        scores = self.novelty_scores(inflow, area_undeformed, grid)
        return np.max(list(scores.values()), axis=0) if scores else None

    def _warn(
        self,
        score: Array | None,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        level: int = 3,
    ) -> None:
        """Warn of inputs outside the training data; the level is that of the caller to blame."""
        outside = 0 if score is None else int((score > EDGE).sum())
        if score is None or outside == 0:
            return
        worst = int(score.argmax())
        scores = self.novelty_scores(inflow[[worst]], area_undeformed[[worst]], grid)
        what = max(scores, key=lambda name: scores[name][0])
        warnings.warn(
            f"{outside} of {len(score)} cases lie outside the training data, most of all "
            f"case {worst} with its {what} (score {score[worst]:.2f}; 1 is the edge of the "
            "training data). The prediction extrapolates.",
            OutsideTrainingWarning,
            stacklevel=level,
        )

    def evaluate(self, cases: Cases) -> pd.DataFrame:
        """Relative errors of the prediction of cases, ‖Y − Y_GT‖ / ‖Y_GT‖.

        The area is compared without the first and last five points.

        Parameters
        ----------
        cases : Cases
            The truth.

        Returns
        -------
        DataFrame
            One row for each case, indexed by geometry and waveform, and a last
            row ``("pooled", "pooled")`` over all cases, as in the paper's table;
            a column for each predicted variable.

        Raises
        ------
        InputError
            If the cases' grid is not the model's.
        """
        if not isinstance(cases, Cases):
            raise InputError(f"evaluate needs Cases, which bring the truth, got {type(cases)}.")
        # Cases that bring the truth need no warning of extrapolation: their errors show it.
        return error_table(self._predict_cases(cases, 0, 0).variables(), cases)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model into one file, atomically and without pickle.

        Raises
        ------
        FileError
            If the file cannot be written.
        """
        write_archive(path, FORMAT, FORMAT_VERSION, *self.to_archive())

    def to_archive(self) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
        """Return all that a file of the model holds: facts for JSON, and arrays."""
        facts = {"config": self.config.to_dict(), "provenance": self.provenance}
        arrays = {
            "time": self.grid.time,
            "z": self.grid.z,
            "period": np.array(self.grid.period),
            "history": histories.to_array(self._history),
            **dict(self.parameters),
        }
        for prefix, part in (("uncertainty", self.uncertainty), ("novelty", self.novelty)):
            if part is not None:
                arrays |= {f"{prefix}_{name}": array for name, array in part}
        return facts, arrays

    @classmethod
    def load(cls, path: str | os.PathLike[str], engine: EngineName | Engine = "auto") -> PCNDE:
        """Read a model back.

        Parameters
        ----------
        path : path-like
            File written by :meth:`save`.
        engine : {'auto', 'julia', 'jax'} or Engine
            Who computes the predictions; need not be the engine of the fit.

        Raises
        ------
        FileError
            If the file is missing, truncated, foreign, or of a newer version.
        """
        facts, arrays = read_archive(path, FORMAT, FORMAT_VERSION, "model")
        return cls.from_archive(facts, arrays, engine, str(path))

    @classmethod
    def from_archive(
        cls,
        facts: Mapping[str, Any],
        arrays: Mapping[str, npt.NDArray[Any]],
        engine: EngineName | Engine = "auto",
        where: str = "The archive",
    ) -> PCNDE:
        """Inverse of :meth:`to_archive`; ``where`` names the source in messages.

        Raises
        ------
        FileError
            If something is missing or does not fit.
        """
        try:
            config = config_from(facts["config"])
            parameters = recipes.parameters_from(config, arrays)
            uncertainty = _part(Uncertainty, "uncertainty", arrays)
            novelty = _part(Novelty, "novelty", arrays)
            grid = Grid(arrays["time"], arrays["z"], float(arrays["period"]))
            history = tuple(histories.from_array(arrays["history"]))
            provenance = dict(facts["provenance"])
            recipes.check(config, parameters, grid)
            if novelty is not None:
                novelty.check()
            if uncertainty is not None and isinstance(parameters, ClosureParameters):
                uncertainty.check(parameters.correction.size)
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise FileError(f"{where} is not a whole model: {error}.") from error
        chosen = select_engine(engine)
        return cls(config, parameters, grid, chosen, provenance, history, uncertainty, novelty)

    def __repr__(self) -> str:
        """Return the grid's size, engine and source."""
        variables = "flow, area, pressure" if self.has_pressure else "flow, area"
        return (
            f"PCNDE({variables}; {self.grid.time.size} instants × {self.grid.z.size} points; "
            f"engine {self.engine.name})"
        )

    def check_grid(self, cases: Cases) -> None:
        """Raise unless the model can predict on the cases' grid.

        Raises
        ------
        InputError
            Naming the first difference.
        """
        if self.any_grid:
            check_resolution(cases.n_times, cases.n_points)
        else:
            check_grid(self.grid, cases.grid)


def _rows(name: str, values: npt.ArrayLike, length: int, of: str) -> Array:
    """Validate (case, length) or (length,) and return the former, a copy."""
    array = np.atleast_2d(real_array(name, values))
    if array.ndim != 2 or array.shape[1] != length or array.shape[0] == 0:
        hint = " It looks transposed." if array.ndim == 2 and array.shape[0] == length else ""
        raise InputError(
            f"{name} must have the shape (case, {length}), {length} {of} as in the training data, "
            f"got {np.shape(values)}.{hint}"
        )
    finite = np.isfinite(array)
    if not finite.all():
        bad = np.argwhere(~finite)
        case, i = bad[0]
        raise InputError(f"{name}[{case}, {i}] is {array[case, i]} ({len(bad)} such values).")
    return array


def _numbered(start: int, stop: int) -> pd.DataFrame:
    """Labels of cases that have no other than their number."""
    return pd.DataFrame(np.arange(start, stop)[:, None], columns=_CASE, copy=False)


def _part(of: type[_Part], prefix: str, arrays: Mapping[str, Array]) -> _Part | None:
    """Make an optional part of a model from those arrays of its file that are its own."""
    start = f"{prefix}_"
    mine = {k.removeprefix(start): v for k, v in arrays.items() if k.startswith(start)}
    return of(**mine) if mine else None
