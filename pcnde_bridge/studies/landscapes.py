"""Loss landscapes of the momentum equation with physics terms in addition to its network.

Section 3.6 of the paper trains the network alone, and with one term each of

    ∂Q/∂z = f_θ(Q, S) + N/(2(1+δ)) + ½ (Q/S) ∂S/∂z − (S/Q) ∂Q/∂t / (2(1+δ)).

The loss is evaluated around the parameters θ on a grid θ + α₁v₁ + α₂v₂ along two random
directions: after the first batch's BFGS iterations, and after the first coupling of the area.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.ndimage import minimum_filter

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import check_memory, positive, whole
from pcnde_bridge.config import PAPER, PCNDEConfig, resolve_pcnde_config
from pcnde_bridge.config.settings import Term
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import EngineChoice, select_engine
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import FitData, StageInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.metrics import compared, relative_error
from pcnde_bridge.studies._shared import describe_outcome, train_until_divergence
from pcnde_bridge.training import history as histories
from pcnde_bridge.training.history import Iteration
from pcnde_bridge.training.staged_training import StagedTraining, TrainingState
from pcnde_bridge.training.trainer import staged_training, training_session

Moment = Literal["initial", "coupled"]

RIGHT_HAND_SIDES: Mapping[str, tuple[Term, ...]] = {
    "network": (),
    "friction": ("friction",),
    "convection": ("convection",),
    "inertia": ("inertia",),
}
"""Right-hand sides of the paper: the network alone, and with one term each."""


@dataclass(frozen=True, eq=False, repr=False)
class Landscape(Displayed):
    """Loss on a grid of two amplitudes.

    Attributes
    ----------
    right_hand_side : str
        Name of the equation.
    moment : {'initial', 'coupled'}
        After the first batch's iterations, or after the first coupling of the area.
    amplitudes : array of shape (n,)
        α₁ and α₂; the middle one is 0.
    losses : array of shape (n, n)
        Mean loss at (α₁, α₂), mL²/s²; infinite where the equation diverges.
    area_error : float
        Relative error of the area that the network uses.
    """

    right_hand_side: str
    moment: Moment
    amplitudes: Array
    losses: Array
    area_error: float

    @property
    def diverged(self) -> npt.NDArray[np.bool_]:
        """Mask of the points where the equation could not be integrated, shape (n, n)."""
        return ~np.isfinite(self.losses)

    @property
    def center(self) -> float:
        """Loss at zero amplitudes."""
        middle = len(self.amplitudes) // 2
        return float(self.losses[middle, middle])

    @property
    def minima(self) -> int:
        """Number of inner grid points with a lower loss than all eight neighbors."""
        neighbors = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])
        lower = self.losses < minimum_filter(self.losses, footprint=neighbors)
        return int(lower[1:-1, 1:-1].sum())

    @property
    def roughness(self) -> float:
        """Fraction of the variation of log L that a cubic in (α₁, α₂) does not explain.

        1 − R² of the least-squares fit where L is finite: 0 is a smooth surface; NaN with
        too few points.
        """
        first, second = np.meshgrid(self.amplitudes, self.amplitudes, indexing="ij")
        scale = np.abs(self.amplitudes).max()
        finite = ~self.diverged & (self.losses > 0)
        values = np.log(self.losses[finite])
        powers = [(i, j) for i in range(4) for j in range(4 - i)]
        if finite.sum() <= 2 * len(powers) or values.std() == 0:
            return float("nan")
        x, y = first[finite] / scale, second[finite] / scale
        matrix = np.stack([x**i * y**j for i, j in powers], axis=1)
        residual = values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]
        return float((residual @ residual) / ((values - values.mean()) ** 2).sum())

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each point: equation, moment, amplitudes, loss and divergence."""
        first, second = np.meshgrid(self.amplitudes, self.amplitudes, indexing="ij")
        found = {"amplitude_1": first, "amplitude_2": second, "loss": self.losses}
        columns = {name: values.ravel() for name, values in found.items()}
        about = {"right_hand_side": self.right_hand_side, "moment": self.moment}
        return pd.DataFrame({**about, **columns, "diverged": self.diverged.ravel()})


@dataclass(frozen=True, eq=False, repr=False)
class LandscapeStudy(Displayed):
    """Landscapes of several right-hand sides, and the outcomes of their training.

    Attributes
    ----------
    landscapes : tuple of Landscape
        Two for each right-hand side, or one where training diverged before the coupling.
    outcomes : mapping of str to str
        For each right-hand side ``"trained"``, or where it diverged.
    history : DataFrame
        Every iteration of training, with a column ``right_hand_side``.
    """

    landscapes: tuple[Landscape, ...]
    outcomes: Mapping[str, str]
    history: pd.DataFrame

    def landscape(self, right_hand_side: str, moment: Moment) -> Landscape | None:
        """Return one landscape; None if training diverged before that moment."""
        known = {(each.right_hand_side, each.moment): each for each in self.landscapes}
        return known.get((right_hand_side, moment))

    def to_frame(self) -> pd.DataFrame:
        """Return all points of all landscapes; see :meth:`Landscape.to_frame`."""
        return pd.concat([each.to_frame() for each in self.landscapes], ignore_index=True)

    def summary(self) -> pd.DataFrame:
        """Return a row for each landscape: losses, minima, roughness, divergence, outcome."""
        rows = []
        for each in self.landscapes:
            finite = each.losses[~each.diverged]
            rows.append(
                {
                    "right_hand_side": each.right_hand_side,
                    "moment": each.moment,
                    "center": each.center,
                    "lowest": finite.min(initial=np.inf),
                    "median": float(np.median(each.losses)),
                    "highest": finite.max() if finite.size else np.inf,
                    "minima": each.minima,
                    "roughness": each.roughness,
                    "diverged": float(each.diverged.mean()),
                    "area_error": each.area_error,
                    "outcome": self.outcomes[each.right_hand_side],
                }
            )
        return pd.DataFrame(rows)


def loss_landscape(
    engine: Engine,
    parameters: Array,
    inputs: StageInputs,
    target: Array,
    grid: Grid,
    config: PCNDEConfig,
    *,
    amplitude: float = 0.1,
    points: int = 21,
    seed: int = 0,
) -> Array:
    """Evaluate the loss of the flow stage on a grid around its parameters.

    Parameters
    ----------
    engine : Engine
        Engine, which computes all points at once.
    parameters : array of shape (size,)
        θ in the middle of the grid.
    inputs, target, grid, config
        Arguments of the flow stage; see :class:`pcnde_bridge.engines.protocol.Stage`.
    amplitude : float
        Largest |α₁| and |α₂|.
    points : int
        Number of points in each direction; odd, so that θ is one of them.
    seed : int
        Random seed for the directions v₁ and v₂, independent standard normal numbers.

    Returns
    -------
    array of shape (points, points)
        Loss at θ + α₁v₁ + α₂v₂, infinite where the equation diverges.

    Raises
    ------
    InputError
        If ``points`` is even or less than 3, or ``amplitude`` not positive.
    """
    first, second = np.random.default_rng(seed).standard_normal((2, parameters.size))
    along = amplitudes(amplitude, points)
    shifts = along[:, None, None] * first + along[None, :, None] * second
    vectors = parameters + shifts.reshape(-1, parameters.size)
    losses = engine.flow.losses(vectors, FitData(inputs, target, grid, config))
    return np.where(np.isfinite(losses), losses, np.inf).reshape(points, points)


def amplitudes(largest: float, points: int) -> Array:
    """Return amplitudes from −largest to largest, with 0 exactly in the middle.

    Raises
    ------
    InputError
        If ``points`` is even or less than 3, or ``largest`` is not a positive number.
    """
    points = whole("points", points, 3)
    if points % 2 == 0:
        raise InputError(f"points must be odd, so that one has amplitude 0; got {points}.")
    check_memory(f"A grid of {points} × {points} points", 3 * points**2, "ask for fewer points")
    largest = positive("amplitude", largest)
    half = points // 2
    return largest * np.arange(-half, half + 1) / half


def explore_landscapes(
    cases: Cases,
    right_hand_sides: Mapping[str, tuple[Term, ...]] = RIGHT_HAND_SIDES,
    config: PCNDEConfig | str = PAPER,
    engine: EngineChoice = "auto",
    *,
    amplitude: float = 0.1,
    points: int = 21,
    seed: int = 0,
    progress: bool | Callable[[Iteration], None] = True,
) -> LandscapeStudy:
    """Train with each right-hand side, and evaluate its loss before and after the coupling.

    Training is that of :meth:`pcnde_bridge.PCNDE.fit` without the pressure, for all
    ``config.flow.epochs``; it ends where an equation diverges, which ``outcomes`` reports.
    The loss is that of the first batch, which the first iterations minimize.

    Parameters
    ----------
    cases : Cases
        Training cases.
    right_hand_sides : mapping of str to tuple of str
        Names, and ``config.flow.terms`` of each.
    config : PCNDEConfig or str
        All other settings.
    engine : {'auto', 'julia', 'jax'} or Engine
        Compute engine.
    amplitude, points : float and int
        Grid of each landscape; see :func:`loss_landscape`.
    seed : int
        Random seed for the initial parameters, the batches, and the directions.
    progress : bool or callable
        Whether to show progress, or a function that is called with every
        :class:`~pcnde_bridge.training.history.Iteration`.

    Returns
    -------
    LandscapeStudy
        Divergence is a result: infinite losses and outcomes, no exception.

    Raises
    ------
    InputError
        If an argument is invalid.
    """
    amplitudes(amplitude, points)
    config, seed = resolve_pcnde_config(config), whole("seed", seed)
    if config.training != "minibatch":
        raise InputError("Loss landscapes need training='minibatch'; change the config.")
    if not right_hand_sides:
        raise InputError("right_hand_sides is empty: name at least one, such as 'network': ().")
    chosen = select_engine(engine)
    procedures = {
        name: staged_training(cases, config.replace(flow={"terms": terms}), chosen)
        for name, terms in right_hand_sides.items()
    }
    start = next(iter(procedures.values())).start(seed)
    tasks = [step.task for step in next(iter(procedures.values())).steps(start)]
    moments: dict[int, Moment] = {1: "initial", tasks.index("coupling") + 1: "coupled"}
    steps = tasks.index("temporal_pressure")
    pressure = config.temporal_pressure.iterations + config.spatial_pressure.iterations
    total = sum(each.count_iterations(start) - pressure for each in procedures.values())
    evaluate = partial(_evaluate, amplitude=amplitude, points=points, seed=seed)
    landscapes, outcomes, frames = [], {}, []
    with training_session(progress, total) as session:
        for name, procedure in procedures.items():
            for state in train_until_divergence(procedure, start, session, steps):
                if state.finished in moments:
                    landscapes.append(evaluate(name, procedure, moments[state.finished], state))
            if not state.finished:
                landscapes.append(evaluate(name, procedure, "initial", start))
            outcomes[name] = describe_outcome(state, steps)
            frames.append(histories.to_frame(state.history).assign(right_hand_side=name))
    return LandscapeStudy(tuple(landscapes), outcomes, pd.concat(frames, ignore_index=True))


def _evaluate(
    name: str, procedure: StagedTraining, moment: Moment, state: TrainingState, **around: Any
) -> Landscape:
    """Return the landscape of the first batch, with the area that the network then uses."""
    cases, area, batch = procedure.cases, state.area, state.batches[0]
    inputs, target = (cases.inflow[batch], area[batch]), cases.flow[batch]
    run = inputs, target, cases.grid, procedure.config
    losses = loss_landscape(procedure.engine, state.parameters.flow, *run, **around)
    error = relative_error(compared("area", area), compared("area", cases.area))
    along = amplitudes(around["amplitude"], around["points"])
    return Landscape(name, moment, along, losses, error)
