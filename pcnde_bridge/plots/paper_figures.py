"""The paper's figures for a model and a data set, as ``pcnde figures`` writes them.

To add a figure, write a function from :class:`FigureData` to :class:`DrawnFigure` with the
decorator :func:`paper_figure`.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from pcnde_bridge import plots, studies
from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import atomic_write, make_folder
from pcnde_bridge._utils.parallel import Workers
from pcnde_bridge.config import PAPER, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import case_keys
from pcnde_bridge.errors import EngineError, InputError, SolveError
from pcnde_bridge.evaluation.baselines import FEM_WALL, Baseline, Solver1D
from pcnde_bridge.model.metrics import pooled_errors
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.uncertainty.novelty import OutsideTrainingWarning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "pdf")
"""Formats of every figure; its numbers are written as CSV."""

_DPI = 200

_log = logging.getLogger("pcnde_bridge")


def hardest_case(cases: Cases) -> int:
    """Return the position of the largest waveform label in the largest geometry label.

    In the published data this is the narrowest stenosis with the strongest waveform.
    """
    labels = cases.labels
    return int(np.lexsort((labels["waveform"], labels["geometry"]))[-1])


@dataclass
class FigureData:
    """Model and cases of the figures; everything is computed once, on first use.

    Attributes
    ----------
    model : PCNDE
        The model.
    cases : Cases
        The whole data set.
    train : Cases
        Training cases.
    test : Cases or None
        Test cases.
    truth_label : str
        Name of the truth, for legends.
    other : Baseline or None
        Another method for comparison; by default the 1D solver with the wall of the
        paper's "1D FEM".
    executor : Executor, or callable that creates one, or None
        Executor for the tasks of studies.
    """

    model: PCNDE
    cases: Cases
    train: Cases
    test: Cases | None = None
    truth_label: str = "3D, averaged"
    other: Baseline | None = field(default_factory=lambda: Solver1D(FEM_WALL))
    executor: Workers | None = None

    @property
    def evaluated(self) -> Cases:
        """The test cases, or the training cases if there are none."""
        return self.train if self.test is None else self.test

    @cached_property
    def hardest(self) -> Cases:
        """The :func:`hardest_case` of the evaluated ones."""
        return self.evaluated.select(hardest_case(self.evaluated))

    @cached_property
    def _predicted(self) -> dict[str, Array]:
        with warnings.catch_warnings():  # the figures show the errors of extrapolation
            warnings.simplefilter("ignore", OutsideTrainingWarning)
            return self.model.predict(self.cases).variables()

    @cached_property
    def _other(self) -> dict[str, Array] | None:
        if self.other is None:
            return None
        try:
            return self.other.fit(self.train).predict(self.evaluated)
        except (InputError, EngineError) as error:
            _log.warning("The figures omit the other method: %s", error)
            return None

    def predicted(self, subset: Cases) -> dict[str, Array]:
        """Return flow, area and pressure of some of the cases, predicted by the model."""
        return _select(self._predicted, self.cases, subset)

    def by_other(self, subset: Cases) -> dict[str, Array] | None:
        """Return the variables of some evaluated cases, computed by the other method.

        None if there is no other method, or it cannot handle the data.
        """
        return None if self._other is None else _select(self._other, self.evaluated, subset)


def _select(arrays: dict[str, Array], cases: Cases, subset: Cases) -> dict[str, Array]:
    """Return the rows of a subset from arrays of all cases."""
    position = {key: i for i, key in enumerate(case_keys(cases.labels))}
    rows = [position[key] for key in case_keys(subset.labels)]
    return {name: values[rows] for name, values in arrays.items()}


class DrawnFigure(NamedTuple):
    """A figure, and the scalar numbers behind it if it has any."""

    figure: Figure
    numbers: pd.DataFrame | None = None


_Draw = Callable[[FigureData], DrawnFigure]


@dataclass(frozen=True)
class PaperFigure:
    """A figure that can be created.

    Attributes
    ----------
    name : str
        Name of the files, and value of ``--only``.
    description : str
        Content of the figure, and its place in the paper.
    draw : callable
        Function that draws the figure.
    cost : str
        Reason why a study takes long; it is then created on request only.  Empty for
        figures of the model as it is.
    """

    name: str
    description: str
    draw: _Draw
    cost: str = ""


FIGURES: list[PaperFigure] = []
"""All figures, in the order in which they are created."""


def paper_figure(name: str, description: str, cost: str = "") -> Callable[[_Draw], PaperFigure]:
    """Turn a function that draws into a :class:`PaperFigure` of :data:`FIGURES`."""

    def register(draw: _Draw) -> PaperFigure:
        FIGURES.append(PaperFigure(name, description, draw, cost))
        return FIGURES[-1]

    return register


@paper_figure("data-set", "waveforms, geometries and split (figure 2)")
def _data_set(data: FigureData) -> DrawnFigure:
    return DrawnFigure(plots.data_set(data.train, data.test))


@paper_figure("history", "losses of the training (not in the paper)")
def _history(data: FigureData) -> DrawnFigure:
    return DrawnFigure(plots.loss_history(data.model.history))


@paper_figure("results", "flow, area and pressure over time and space (figure 4 a–c)")
def _results(data: FigureData) -> DrawnFigure:
    narrowest = data.evaluated.select(geometry=data.evaluated.labels["geometry"].max())
    figure = plots.results(
        data.predicted(narrowest),
        narrowest,
        other=data.by_other(narrowest),
        area_case=hardest_case(narrowest),
        truth_label=data.truth_label,
    )
    rows = {("PCNDE", "train"): pooled_errors(data.predicted(data.train), data.train)}
    if data.test is not None:
        rows["PCNDE", "test"] = pooled_errors(data.predicted(data.test), data.test)
    other = data.by_other(data.evaluated)
    if other is not None:
        subset = "train" if data.test is None else "test"
        rows["1D solver", subset] = pooled_errors(other, data.evaluated)
    index = pd.MultiIndex.from_tuples(list(rows), names=["method", "set"])
    return DrawnFigure(figure, pd.DataFrame(list(rows.values()), index=index))


@paper_figure("error-matrix", "relative error of every case (figure 4 d)")
def _error_matrix(data: FigureData) -> DrawnFigure:
    matrices = studies.error_matrix(data.predicted(data.cases), data.cases)
    numbers = pd.concat(matrices, names=["variable"])
    return DrawnFigure(plots.error_matrix(matrices, data.train), numbers)


@paper_figure("pressure-drop", "model, and Seeley and Young (figure 5)")
def _pressure_drop(data: FigureData) -> DrawnFigure:
    predicted = data.predicted(data.evaluated)
    if "pressure" not in predicted:
        raise InputError("The model predicts no pressure, so there is no pressure drop to plot.")
    drops = studies.pressure_drops(predicted["pressure"], data.evaluated, data.model.config.physics)
    return DrawnFigure(plots.pressure_drops(drops, truth_label=data.truth_label), drops.to_frame())


@paper_figure("pointwise-errors", "one case at all time points and grid points (figure 6)")
def _pointwise_errors(data: FigureData) -> DrawnFigure:
    errors = studies.pointwise_errors(data.predicted(data.hardest), data.hardest)
    figure = plots.pointwise_errors(errors, truth_label=data.truth_label)
    return DrawnFigure(figure, errors.to_frame())


@paper_figure("box-plots", "distribution of the relative errors (figure 7 a)")
def _box_plots(data: FigureData) -> DrawnFigure:
    methods = {"PCNDE": data.predicted(data.evaluated)}
    other = data.by_other(data.evaluated)
    if other is not None:
        methods["1D solver"] = other
    statistics = studies.box_statistics(methods, data.evaluated)
    return DrawnFigure(plots.box_plots(statistics), statistics)


@paper_figure("fourier-effect", "area before and after the Fourier stage (figure 7 b)")
def _fourier_effect(data: FigureData) -> DrawnFigure:
    effect = studies.fourier_effect(data.model, data.train)
    return DrawnFigure(
        plots.fourier_effect(effect, truth_label=data.truth_label), effect.to_frame()
    )


def _noise(data: FigureData, noisy: studies.NoisyInput) -> DrawnFigure:
    study = studies.noise_study(data.model, data.hardest, noisy, executor=data.executor)
    return DrawnFigure(plots.noise(study, truth_label=data.truth_label), study.to_frame())


@paper_figure("noise-inflow", "90 noisy inflows (figure 8)")
def _noise_inflow(data: FigureData) -> DrawnFigure:
    return _noise(data, "inflow")


@paper_figure("noise-area", "90 noisy undeformed areas (figure 10)")
def _noise_area(data: FigureData) -> DrawnFigure:
    return _noise(data, "area_undeformed")


@paper_figure(
    "activations",
    "pressure networks with five activation functions (section 3.2)",
    cost="fits the pressure stages five times",
)
def _activations(data: FigureData) -> DrawnFigure:
    study = studies.activation_study(data.model, data.train, data.test, executor=data.executor)
    return DrawnFigure(plots.activations(study), study)


def _minibatch_config(model: PCNDE) -> PCNDEConfig:
    """Return the model's settings if they train in minibatches, else the paper's."""
    config = model.config
    if isinstance(config, PCNDEConfig) and config.training == "minibatch":
        return config
    return PAPER


@paper_figure(
    "smoothness",
    "momentum equation in time and in space (figure 3)",
    cost="fits three flow networks",
)
def _smoothness(data: FigureData) -> DrawnFigure:
    config = _minibatch_config(data.model)
    engine = data.model.engine
    study = studies.compare_formulations(data.train, data.test, config=config, engine=engine)
    return DrawnFigure(plots.smoothness(study, truth_label=data.truth_label), study.to_frame())


@paper_figure(
    "loss-landscapes",
    "physics terms in addition to the network (figure 9)",
    cost="fits four flow networks until the first coupling",
)
def _landscapes(data: FigureData) -> DrawnFigure:
    config = _minibatch_config(data.model)
    # The figure needs the training until the first coupling only.
    config = config.replace(flow={"epochs": config.flow.couple_every})
    study = studies.explore_landscapes(data.train, config=config, engine=data.model.engine)
    return DrawnFigure(plots.landscapes(study), study.to_frame())


@dataclass(frozen=True)
class FigureFiles:
    """Files of a figure.

    Attributes
    ----------
    figure : PaperFigure
        The figure.
    files : tuple of pathlib.Path
        Written files; empty if the figure does not suit the model or the data.
    numbers : DataFrame or None
        Numbers in the CSV file.
    reason : str
        Reason why nothing was written.
    """

    figure: PaperFigure
    files: tuple[Path, ...] = ()
    numbers: pd.DataFrame | None = None
    reason: str = ""


def choose(only: Collection[str] = (), with_studies: bool = False) -> list[PaperFigure]:
    """Return the figures with these names, or all.

    Parameters
    ----------
    only : collection of str
        Names; empty for all figures.
    with_studies : bool
        Whether "all" includes the studies that take long.

    Raises
    ------
    InputError
        If there is no figure with one of the names.
    """
    known = [figure.name for figure in FIGURES]
    unknown = [name for name in only if name not in known]
    if unknown:
        raise InputError(f"There is no figure {unknown[0]!r}; the figures are: {', '.join(known)}.")
    if only:
        return [figure for figure in FIGURES if figure.name in only]
    return [figure for figure in FIGURES if with_studies or not figure.cost]


def make_figures(
    data: FigureData,
    out: StrPath,
    *,
    only: Collection[str] = (),
    with_studies: bool = False,
    on_figure: Callable[[int, int, PaperFigure], None] | None = None,
) -> list[FigureFiles]:
    """Draw figures and write them into a folder as PNG and PDF, with their numbers as CSV.

    Parameters
    ----------
    data : FigureData
        Model and cases.
    out : path-like
        Folder, created if missing.  Files with the same names are replaced, each as a
        whole.
    only : collection of str
        Names of the figures; empty for all figures.
    with_studies : bool
        Whether "all" includes the studies that take long (:attr:`PaperFigure.cost`).
    on_figure : callable, optional
        Called with number, count and figure before each figure.

    Returns
    -------
    list of FigureFiles
        Files, or why there are none: a figure is left out if it does not suit the model
        or its equations diverge.

    Raises
    ------
    InputError
        If there is no figure with one of the names, a named figure does not suit the
        model or the data, or the cases are not on the model's grid.
    SolveError
        If the equations of a named figure diverge.
    FileError
        If the folder or a file cannot be written.
    """
    figures = choose(only, with_studies)
    data.model.check_grid(data.cases)
    folder = Path(out)
    make_folder(folder)
    made = []
    for number, figure in enumerate(figures, 1):
        if on_figure is not None:
            on_figure(number, len(figures), figure)
        try:
            drawn = figure.draw(data)
        except (InputError, SolveError) as error:
            if only:
                raise type(error)(f"{figure.name}: {error}") from error
            made.append(FigureFiles(figure, reason=str(error)))
        else:
            files = _write(folder, figure.name, drawn)
            made.append(FigureFiles(figure, files, drawn.numbers))
    return made


def _write(folder: Path, name: str, drawn: DrawnFigure) -> tuple[Path, ...]:
    files = [folder / f"{name}.{suffix}" for suffix in FORMATS]
    for path in files:
        # Without the date, the same figure gives the same file.
        metadata = {"CreationDate": None} if path.suffix == ".pdf" else {}
        with atomic_write(path) as temporary:
            drawn.figure.savefig(temporary, dpi=_DPI, metadata=metadata)
    if drawn.numbers is not None:
        files.append(folder / f"{name}.csv")
        with atomic_write(files[-1]) as temporary:
            drawn.numbers.to_csv(temporary)
    return tuple(files)
