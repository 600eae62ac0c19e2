"""The figures of ``pcnde figures``: the paper's, for a model and a data set.

To add a figure, write a function from :class:`FigureData` to a figure and its numbers, and
add it to :data:`FIGURES`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from pcnde_bridge import plots, studies
from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import atomic_write, make_folder, write_csv
from pcnde_bridge._utils.parallel import Workers
from pcnde_bridge.config import PAPER, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import case_keys
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import EngineError, InputError, SolveError
from pcnde_bridge.evaluation.baselines import FEM_WALL, Baseline, Solver1D
from pcnde_bridge.model.metrics import pooled_errors
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.predictor import predict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OTHER = "1D solver"
"""Name of the method that the model is compared with."""

_log = logging.getLogger("pcnde_bridge")


def hardest_case(cases: Cases) -> int:
    """Return the position of the largest waveform label in the largest geometry label.

    In the published data this is the narrowest stenosis with the strongest waveform.
    """
    return int(cases.labels.sort_values(["geometry", "waveform"]).index[-1])


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
    executor : Executor, int or None
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
        found, known = predict(self.model, self.cases).variables(), self.cases.variables()
        return {name: values for name, values in found.items() if name in known}

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
        """Return the variables of some of the cases that the model predicts."""
        return _select(self._predicted, self.cases, subset)

    def by_method(self, subset: Cases) -> dict[str, dict[str, Array]]:
        """Return the variables of some evaluated cases by method.

        The other method is omitted if there is none, or it cannot handle the data.
        """
        methods = {"PCNDE": self.predicted(subset)}
        if self._other is not None:
            methods[OTHER] = _select(self._other, self.evaluated, subset)
        return methods


def _select(arrays: dict[str, Array], cases: Cases, subset: Cases) -> dict[str, Array]:
    """Return the rows of a subset from arrays of all cases."""
    position = {key: i for i, key in enumerate(case_keys(cases.labels))}
    rows = [position[key] for key in case_keys(subset.labels)]
    return {name: values[rows] for name, values in arrays.items()}


Drawn = tuple["Figure", pd.DataFrame | None]
"""A figure, and the scalar numbers behind it if it has any."""


def _data_set(data: FigureData) -> Drawn:
    return plots.data_set(data.train, data.test), None


def _history(data: FigureData) -> Drawn:
    return plots.loss_history(data.model.history), None


def _results(data: FigureData) -> Drawn:
    narrowest = data.evaluated.select(geometry=data.evaluated.labels["geometry"].max())
    methods = data.by_method(narrowest)
    figure = plots.results(
        methods["PCNDE"],
        narrowest,
        other=methods.get(OTHER),
        area_case=hardest_case(narrowest),
        truth_label=data.truth_label,
    )
    errors = {("PCNDE", "train"): pooled_errors(data.predicted(data.train), data.train)}
    for method, variables in data.by_method(data.evaluated).items():
        subset = "train" if data.test is None else "test"
        errors[method, subset] = pooled_errors(variables, data.evaluated)
    return figure, pd.DataFrame(errors).T.rename_axis(["method", "set"])


def _error_matrix(data: FigureData) -> Drawn:
    matrices = studies.error_matrix(data.predicted(data.cases), data.cases)
    return plots.error_matrix(matrices, data.train), pd.concat(matrices, names=["variable"])


def _box_plots(data: FigureData) -> Drawn:
    # The wall shear stress has no bounded relative error, being near 0 where the flow separates.
    methods = {
        method: {name: values for name, values in found.items() if name in VARIABLES}
        for method, found in data.by_method(data.evaluated).items()
    }
    statistics = studies.box_statistics(methods, data.evaluated)
    return plots.box_plots(statistics), statistics


def _pressure_drop(data: FigureData) -> Drawn:
    predicted = data.predicted(data.evaluated)
    if "pressure" not in predicted:
        raise InputError("The model predicts no pressure, so there is no pressure drop to plot.")
    drops = studies.pressure_drops(predicted["pressure"], data.evaluated, data.model.config.physics)
    return _drawn(plots.pressure_drops, drops, data)


def _pointwise_errors(data: FigureData) -> Drawn:
    errors = studies.pointwise_errors(data.predicted(data.hardest), data.hardest)
    return _drawn(plots.pointwise_errors, errors, data)


def _fourier_effect(data: FigureData) -> Drawn:
    return _drawn(plots.fourier_effect, studies.fourier_effect(data.model, data.train), data)


def _noise(data: FigureData, noisy: studies.NoisyInput) -> Drawn:
    study = studies.noise_study(data.model, data.hardest, noisy, executor=data.executor)
    return _drawn(plots.noise, study, data)


def _activations(data: FigureData) -> Drawn:
    study = studies.activation_study(data.model, data.train, data.test, executor=data.executor)
    return plots.activations(study), study


def _smoothness(data: FigureData) -> Drawn:
    config, engine = _minibatch_config(data.model), data.model.engine
    study = studies.compare_formulations(data.train, data.test, config=config, engine=engine)
    return _drawn(plots.smoothness, study, data)


def _landscapes(data: FigureData) -> Drawn:
    config, engine = _minibatch_config(data.model), data.model.engine
    # The figure needs the training until the first coupling only.
    config = config.replace(flow={"epochs": config.flow.couple_every})
    study = studies.explore_landscapes(data.train, config=config, engine=engine)
    return plots.landscapes(study), study.to_frame()


def _drawn(plot: Callable[..., Figure], study: Any, data: FigureData) -> Drawn:
    """Plot a study that includes the truth, and return its numbers."""
    return plot(study, truth_label=data.truth_label), study.to_frame()


def _minibatch_config(model: PCNDE) -> PCNDEConfig:
    """Return the model's settings if they train in minibatches, else the paper's."""
    config = model.config
    if isinstance(config, PCNDEConfig) and config.training == "minibatch":
        return config
    return PAPER


FIGURES: dict[str, tuple[Callable[[FigureData], Drawn], str]] = {
    "data-set": (_data_set, "waveforms, geometries and split (figure 2)"),
    "history": (_history, "losses of the training (not in the paper)"),
    "results": (_results, "the variables over time and space (figure 4 a–c)"),
    "error-matrix": (_error_matrix, "relative error of every case (figure 4 d)"),
    "pressure-drop": (_pressure_drop, "model, and Seeley and Young (figure 5)"),
    "pointwise-errors": (_pointwise_errors, "one case at all times and positions (figure 6)"),
    "box-plots": (_box_plots, "distribution of the relative errors (figure 7 a)"),
    "fourier-effect": (_fourier_effect, "area before and after the Fourier stage (figure 7 b)"),
    "noise-inflow": (partial(_noise, noisy="inflow"), "90 noisy inflows (figure 8)"),
    "noise-area": (partial(_noise, noisy="area_undeformed"), "90 noisy areas S_u (figure 10)"),
    "activations": (_activations, "five activation functions of the pressure (section 3.2)"),
    "smoothness": (_smoothness, "momentum equation in time and in space (figure 3)"),
    "loss-landscapes": (_landscapes, "physics terms in addition to the network (figure 9)"),
}
"""Function and description of each figure by its name, in the order in which they are drawn."""

COSTS = {
    "activations": "fits the pressure stages five times",
    "smoothness": "fits three flow networks",
    "loss-landscapes": "fits four flow networks until the first coupling",
}
"""Reason why a figure takes long; such figures are drawn on request only."""


def choose(only: Collection[str] = (), with_studies: bool = False) -> list[str]:
    """Return the names of figures in their order.

    Parameters
    ----------
    only : collection of str
        Names of the figures; empty for all figures.
    with_studies : bool
        Whether "all" includes the figures that take long (:data:`COSTS`).

    Raises
    ------
    InputError
        If there is no figure with one of the names.
    """
    for name in only:
        if name not in FIGURES:
            raise InputError(f"There is no figure {name!r}; the figures are: {', '.join(FIGURES)}.")
    wanted = only or [name for name in FIGURES if with_studies or name not in COSTS]
    return [name for name in FIGURES if name in wanted]


def make_figures(
    data: FigureData,
    out: StrPath,
    *,
    only: Collection[str] = (),
    with_studies: bool = False,
    announce: Callable[[str], object] = _log.info,
) -> dict[str, list[Path]]:
    """Draw figures and write them into a folder as PNG and PDF, with their numbers as CSV.

    A figure is left out if it does not suit the model or its equations diverge.

    Parameters
    ----------
    data : FigureData
        Model and cases.
    out : path-like
        Folder, created if missing.  Files with the same names are replaced, each as a
        whole.
    only, with_studies
        See :func:`choose`; a figure that is named is not left out.
    announce : callable
        Called with a description of each figure before it is drawn, and with the reason
        if it is left out.

    Returns
    -------
    dict of str to list of pathlib.Path
        Files by the name of the figure; none if it is left out.

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
    names = choose(only, with_studies)
    data.model.check_grid(data.cases)
    folder = Path(out)
    make_folder(folder)
    files: dict[str, list[Path]] = {}
    for number, name in enumerate(names, 1):
        draw, description = FIGURES[name]
        cost = f"; {COSTS[name]}" if name in COSTS else ""
        announce(f"[{number}/{len(names)}] {name}: {description}{cost}")
        try:
            drawn = draw(data)
        except (InputError, SolveError) as error:
            if only:
                raise type(error)(f"{name}: {error}") from error
            announce(f"{name} is left out. {error}")
            files[name] = []
        else:
            files[name] = _write(folder / name, *drawn)
    return files


def _write(stem: Path, figure: Figure, numbers: pd.DataFrame | None) -> list[Path]:
    """Write a figure and its numbers into files that differ in their endings."""
    files = []
    # Without the date, the same figure gives the same file.
    for suffix, metadata in ((".png", {}), (".pdf", {"CreationDate": None})):
        files.append(stem.with_suffix(suffix))
        with atomic_write(files[-1]) as temporary:
            figure.savefig(temporary, dpi=200, metadata=metadata)
    if numbers is not None:
        files.append(stem.with_suffix(".csv"))
        write_csv(files[-1], numbers)
    return files
