"""The paper's figures from a model and a data set: what ``pcnde figures`` makes.

To add a figure, write a function from :class:`Material` to :class:`Drawn` and name it
in :data:`FIGURES`.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from pcnde_bridge import plots, studies
from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import atomic_write, make_folder
from pcnde_bridge._utils.parallel import Workers
from pcnde_bridge.config import PAPER, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import (
    EngineError,
    FileError,
    InputError,
    SolveError,
)
from pcnde_bridge.evaluation.baselines import (
    FEM_WALL,
    Baseline,
    Solver1D,
)
from pcnde_bridge.hemodynamics.synthetic import fewer_words
from pcnde_bridge.model.metrics import pooled_errors
from pcnde_bridge.model.pcnde import PCNDE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "pdf")
"""Every figure is written in each of these; its numbers as CSV."""

_DPI = 200

_log = logging.getLogger("pcnde_bridge")


def outermost(cases: Cases) -> int:
    """Position of the case with the largest geometry, and there the largest waveform label.

    In the published data that is the narrowest stenosis under the strongest wave.
    """
    labels = cases.labels
    return int(np.lexsort((labels["waveform"], labels["geometry"]))[-1])


@dataclass
class Material:
    """What figures are made of; whatever is computed is computed once, when asked for.

    Attributes
    ----------
    model : PCNDE
        The model.
    cases : Cases
        The whole data set.
    train : Cases
        The training cases.
    test : Cases or None
        The test cases.
    truth_label : str
        What the cases are, for legends.
    other : Baseline or None
        Another method to compare with; by default the 1D solver with the wall that
        the paper's "1D FEM" was computed with.
    executor : Executor, or callable that makes one, or None
        Who runs the tasks of studies.
    """

    model: PCNDE
    cases: Cases
    train: Cases
    test: Cases | None = None
    truth_label: str = "3D, averaged"
    other: Baseline | None = field(default_factory=lambda: Solver1D(FEM_WALL))
    executor: Workers | None = None

    @property
    def judged(self) -> Cases:
        """The test cases, or the training cases if there are none."""
        return self.train if self.test is None else self.test

    @cached_property
    def hardest(self) -> Cases:
        """One case: :func:`outermost` of those judged."""
        return self.judged.select(outermost(self.judged))

    @cached_property
    def _predicted(self) -> dict[str, Array]:
        # The truth is at hand: the errors show what extrapolation does.
        return self.model.predict_silently(self.cases).variables()

    def predicted(self, of: Cases) -> dict[str, Array]:
        """Flow, area and pressure of some of the cases, by the model."""
        rows = _positions(self.cases, of)
        return {name: values[rows] for name, values in self._predicted.items()}

    @cached_property
    def _other(self) -> dict[str, Array]:
        assert self.other is not None
        with fewer_words():
            return self.other.fit(self.train).predict(self.judged)

    def by_other(self, of: Cases) -> dict[str, Array] | None:
        """Flow, area and pressure of some of the judged cases by the other method.

        None if there is none, or if it does not suit the data.
        """
        if self.other is None:
            return None
        try:
            found = self._other
        except (InputError, EngineError) as error:
            _log.warning("The figures leave the other method out: %s", error)
            self.other = None
            return None
        rows = _positions(self.judged, of)
        return {name: values[rows] for name, values in found.items()}


def _positions(cases: Cases, of: Cases) -> list[int]:
    """Where some of the cases are among all."""
    names = ["geometry", "waveform"]
    place = {key: i for i, key in enumerate(cases.labels[names].itertuples(False, None))}
    return [place[key] for key in of.labels[names].itertuples(False, None)]


class Drawn(NamedTuple):
    """A figure, and the numbers behind it if it has scalar ones."""

    figure: Figure
    numbers: pd.DataFrame | None = None


@dataclass(frozen=True)
class Entry:
    """A figure that can be made.

    Attributes
    ----------
    name : str
        Of the files, and for ``--only``.
    about : str
        What it shows, and its place in the paper.
    draw : callable
        Makes it.
    cost : str
        Of a study that is made only when asked for: what takes long.  Empty for
        figures of the model as it is.
    """

    name: str
    about: str
    draw: Callable[[Material], Drawn]
    cost: str = ""


def _data_set(material: Material) -> Drawn:
    return Drawn(plots.data_set(material.train, material.test))


def _history(material: Material) -> Drawn:
    return Drawn(plots.loss_history(material.model.history))


def _results(material: Material) -> Drawn:
    labels = material.judged.labels["geometry"]
    shown = material.judged.select(geometry=labels.max())
    figure = plots.results(
        material.predicted(shown),
        shown,
        other=material.by_other(shown),
        area_case=outermost(shown),
        truth_label=material.truth_label,
    )
    rows = {("PCNDE", "train"): pooled_errors(material.predicted(material.train), material.train)}
    if material.test is not None:
        rows["PCNDE", "test"] = pooled_errors(material.predicted(material.test), material.test)
    other = material.by_other(material.judged)
    if other is not None:
        name = "train" if material.test is None else "test"
        rows["1D solver", name] = pooled_errors(other, material.judged)
    index = pd.MultiIndex.from_tuples(list(rows), names=["method", "set"])
    return Drawn(figure, pd.DataFrame(list(rows.values()), index=index))


def _error_matrix(material: Material) -> Drawn:
    matrices = studies.error_matrix(material.predicted(material.cases), material.cases)
    return Drawn(
        plots.error_matrix(matrices, material.train), pd.concat(matrices, names=["variable"])
    )


def _pressure_drop(material: Material) -> Drawn:
    predicted = material.predicted(material.judged)
    if "pressure" not in predicted:
        raise InputError("The model predicts no pressure, so it has no pressure drop.")
    drops = studies.pressure_drops(
        predicted["pressure"], material.judged, material.model.config.physics
    )
    figure = plots.pressure_drops(drops, truth_label=material.truth_label)
    return Drawn(figure, drops.to_frame())


def _pointwise_errors(material: Material) -> Drawn:
    errors = studies.pointwise_errors(material.predicted(material.hardest), material.hardest)
    figure = plots.pointwise_errors(errors, truth_label=material.truth_label)
    return Drawn(figure, errors.to_frame())


def _box_plots(material: Material) -> Drawn:
    methods = {"PCNDE": material.predicted(material.judged)}
    other = material.by_other(material.judged)
    if other is not None:
        methods["1D solver"] = other
    statistics = studies.box_statistics(methods, material.judged)
    return Drawn(plots.box_plots(statistics), statistics)


def _fourier_effect(material: Material) -> Drawn:
    effect = studies.fourier_effect(material.model, material.train)
    figure = plots.fourier_effect(effect, truth_label=material.truth_label)
    return Drawn(figure, effect.to_frame())


def _noise(material: Material, noisy: studies.NoisyInput) -> Drawn:
    study = studies.noise_study(material.model, material.hardest, noisy, executor=material.executor)
    return Drawn(plots.noise(study, truth_label=material.truth_label), study.to_frame())


def _noise_inflow(material: Material) -> Drawn:
    return _noise(material, "inflow")


def _noise_area(material: Material) -> Drawn:
    return _noise(material, "area_undeformed")


def _activations(material: Material) -> Drawn:
    study = studies.activation_study(
        material.model, material.train, material.test, executor=material.executor
    )
    return Drawn(plots.activations(study), study)


def _recipe(material: Material) -> PCNDEConfig:
    """Take the model's settings for studies that train anew, if they train in batches."""
    config = material.model.config
    if isinstance(config, PCNDEConfig) and config.training == "minibatch":
        return config
    return PAPER


def _smoothness(material: Material) -> Drawn:
    study = studies.compare_formulations(
        material.train, material.test, config=_recipe(material), engine=material.model.engine
    )
    figure = plots.smoothness(study, truth_label=material.truth_label)
    return Drawn(figure, study.to_frame())


def _landscapes(material: Material) -> Drawn:
    recipe = _recipe(material)
    # The figure needs no more than the first coupling.
    recipe = recipe.replace(flow={"epochs": recipe.flow.couple_every})
    study = studies.explore_landscapes(material.train, config=recipe, engine=material.model.engine)
    return Drawn(plots.landscapes(study), study.to_frame())


FIGURES = (
    Entry("data-set", "waveforms, geometries and split (figure 2)", _data_set),
    Entry("history", "losses of the training (not in the paper)", _history),
    Entry("results", "flow, area and pressure over time and space (figure 4 a–c)", _results),
    Entry("error-matrix", "relative error of every case (figure 4 d)", _error_matrix),
    Entry("pressure-drop", "model, and Seeley and Young (figure 5)", _pressure_drop),
    Entry("pointwise-errors", "one case at all instants and points (figure 6)", _pointwise_errors),
    Entry("box-plots", "spread of the relative errors (figure 7 a)", _box_plots),
    Entry(
        "fourier-effect", "area before and after the Fourier stage (figure 7 b)", _fourier_effect
    ),
    Entry("noise-inflow", "90 noisy inflows (figure 8)", _noise_inflow),
    Entry("noise-area", "90 noisy undeformed areas (figure 10)", _noise_area),
    Entry(
        "activations",
        "pressure networks with five activation functions (section 3.2)",
        _activations,
        cost="fits the pressure stages five times",
    ),
    Entry(
        "smoothness",
        "momentum in time and in space (figure 3)",
        _smoothness,
        cost="fits three flow networks",
    ),
    Entry(
        "loss-landscapes",
        "physics terms beside the network (figure 9)",
        _landscapes,
        cost="fits four flow networks until the first coupling",
    ),
)
"""All figures, in the order in which they are made."""


@dataclass(frozen=True)
class Made:
    """What became of an entry.

    Attributes
    ----------
    entry : Entry
        The entry.
    files : tuple of pathlib.Path
        What was written; empty if the figure does not suit the model or the data.
    numbers : DataFrame or None
        As in the CSV.
    reason : str
        Why nothing was written.
    """

    entry: Entry
    files: tuple[Path, ...] = ()
    numbers: pd.DataFrame | None = None
    reason: str = ""


def choose(only: Collection[str] = (), with_studies: bool = False) -> list[Entry]:
    """Entries by their names, or all; studies are left out unless named or wanted.

    Raises
    ------
    InputError
        If there is no figure of a name.
    """
    known = [entry.name for entry in FIGURES]
    unknown = [name for name in only if name not in known]
    if unknown:
        raise InputError(
            f"There is no figure {', '.join(map(repr, unknown))}; the figures are: "
            f"{', '.join(known)}."
        )
    if only:
        return [entry for entry in FIGURES if entry.name in only]
    return [entry for entry in FIGURES if with_studies or not entry.cost]


def make_figures(
    material: Material,
    out: str | os.PathLike[str],
    *,
    only: Collection[str] = (),
    with_studies: bool = False,
    on_entry: Callable[[int, int, Entry], None] | None = None,
) -> list[Made]:
    """Make figures and write them into a folder, as PNG, PDF and, of their numbers, CSV.

    Parameters
    ----------
    material : Material
        Model and data.
    out : path-like
        The folder, made if it is not there.  Files of the same names are replaced, each
        as a whole.
    only : collection of str
        Names of the figures to make; empty makes all.
    with_studies : bool
        Whether all includes those that take long (:attr:`Entry.cost`).
    on_entry : callable, optional
        Called with number, count and entry before each figure.

    Returns
    -------
    list of Made
        Files, or why there are none: a figure that does not suit the model, or whose
        equations diverge, is left out.

    Raises
    ------
    InputError
        If there is no figure of a name, one asked for by name does not suit the model
        or the data, or the data's grid is not the model's.
    SolveError
        If the equations of a figure asked for by name diverge.
    FileError
        If the folder or a file cannot be written.
    """
    entries = choose(only, with_studies)
    material.model.check_grid(material.cases)
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder} is a file; give a folder for the figures.")
    make_folder(folder)
    made = []
    for number, entry in enumerate(entries, 1):
        if on_entry is not None:
            on_entry(number, len(entries), entry)
        try:
            drawn = entry.draw(material)
        except (InputError, SolveError) as error:
            if only:
                raise type(error)(f"{entry.name}: {error}") from error
            made.append(Made(entry, reason=str(error)))
            continue
        made.append(Made(entry, _write(folder, entry.name, drawn), drawn.numbers))
    return made


def _write(folder: Path, name: str, drawn: Drawn) -> tuple[Path, ...]:
    files = []
    for suffix in FORMATS:
        # Without the date, the same figure is the same file.
        options = {"metadata": {"CreationDate": None}} if suffix == "pdf" else {}
        with atomic_write(path := folder / f"{name}.{suffix}") as temporary:
            drawn.figure.savefig(temporary, dpi=_DPI, **options)  # type: ignore[arg-type]
        files.append(path)
    if drawn.numbers is not None:
        with atomic_write(path := folder / f"{name}.csv") as temporary:
            drawn.numbers.to_csv(temporary)
        files.append(path)
    return tuple(files)
