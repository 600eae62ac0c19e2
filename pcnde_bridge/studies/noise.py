"""How noise in an input spreads into the prediction (section 3.5 and appendix of the paper).

    x* = x + ε·σ,   σ = level·max|x|,   ε ~ N(0, 1), drawn for every value on its own

with x the inflow Q_in(t) or the undeformed area S_u(z).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.parallel import Workers, each
from pcnde_bridge._utils.validation import whole
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import Solution
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.training import recipes

NoisyInput = Literal["inflow", "area_undeformed"]

_BLOCK = 32  # at most so many rows are predicted at once


@dataclass(frozen=True, eq=False)
class NoiseStudy:
    """Predictions of one case from a noisy input.

    Attributes
    ----------
    noisy : {'inflow', 'area_undeformed'}
        The input with noise.
    level : float
        σ over the input's largest value.
    draws : int
        How many noisy inputs.
    case : Cases
        The case, which is the truth.
    unperturbed, mean, deviation : mapping of str to array of shape (time, z)
        Prediction without noise; mean and standard deviation of those with noise:
        flow (mL/s), area (cm²) and pressure (dyn/cm²).
    """

    noisy: NoisyInput
    level: float
    draws: int
    case: Cases = field(repr=False)
    unperturbed: Mapping[str, Array] = field(repr=False)
    mean: Mapping[str, Array] = field(repr=False)
    deviation: Mapping[str, Array] = field(repr=False)

    def spread(self) -> dict[str, float]:
        """Return each variable's mean deviation over the largest value of its mean."""
        return {
            name: float(deviation.mean() / np.abs(self.mean[name]).max())
            for name, deviation in self.deviation.items()
        }

    def to_frame(self) -> pd.DataFrame:
        """Scalar measures, a row for each variable.

        Returns
        -------
        DataFrame
            Columns ``spread`` (see :meth:`spread`), and ``bias``: the largest
            difference of mean and prediction without noise, over the same value.
        """
        bias = {
            name: float(np.abs(mean - self.unperturbed[name]).max() / np.abs(mean).max())
            for name, mean in self.mean.items()
        }
        return pd.DataFrame({"spread": self.spread(), "bias": bias}).rename_axis("variable")


def noise_study(
    model: PCNDE,
    case: Cases,
    noisy: NoisyInput = "inflow",
    *,
    level: float = 0.05,
    draws: int = 90,
    seed: int = 0,
    executor: Workers | None = None,
) -> NoiseStudy:
    """Predict one case many times, each time with other noise in one of its inputs.

    Parameters
    ----------
    model : PCNDE
        Of any preset.
    case : Cases
        A single case; the paper takes the hardest test case.
    noisy : {'inflow', 'area_undeformed'}
        The input that gets the noise.  Values of the area that the noise would make
        negative or zero are drawn again.
    level : float
        σ over the input's largest value.
    draws : int
        How many noisy inputs, at least 2.
    seed : int
        Of the noise.
    executor : Executor, or callable that makes one, optional
        Who predicts the draws; None predicts them here.  The same bits come of
        as many threads of XLA, see :mod:`pcnde_bridge._utils.parallel`.

    Returns
    -------
    NoiseStudy
        Mean, deviation and scalar measures.

    Raises
    ------
    InputError
        If there is not exactly one case, or an argument is not usable.
    SolveError
        If the equations diverge for a draw.
    """
    if len(case) != 1:
        raise InputError(
            f"A noise study takes one case, got {len(case)}. Select it: "
            "cases.select(geometry=…, waveform=…)."
        )
    if noisy not in get_args(NoisyInput):
        raise InputError(f"noisy must be one of {list(get_args(NoisyInput))}, got {noisy!r}.")
    if not (np.isfinite(level) and level >= 0):
        raise InputError(f"level must be a number ≥ 0, got {level!r}.")
    draws, seed = whole("draws", draws, 2), whole("seed", seed)
    model.check_grid(case)
    # Blocks of one size, as engines compile for each size.  What the draws leave of them
    # is filled with the exact input, of which one is needed anyway.
    count = -(-(draws + 1) // _BLOCK)
    size = -(-(draws + 1) // count)
    exact = count * size - draws
    inflow, area_undeformed = noisy_inputs(case, noisy, level, draws, seed, exact)
    blocks = [slice(i, i + size) for i in range(0, count * size, size)]
    trained = (model.engine, model.config, model.parameters)
    grid = case.grid
    tasks = {
        f"draws from {block.start}": (*trained, inflow[block], area_undeformed[block], grid)
        for block in blocks
    }
    solutions = each(_predict, tasks, executor, progress=False)
    drawn = {
        name: np.concatenate(parts)
        for name, parts in zip(VARIABLES, zip(*solutions, strict=True), strict=True)
        if parts[0] is not None
    }
    return NoiseStudy(
        noisy,
        float(level),
        draws,
        case,
        {name: values[0] for name, values in drawn.items()},
        {name: values[exact:].mean(axis=0) for name, values in drawn.items()},
        {name: values[exact:].std(axis=0, ddof=1) for name, values in drawn.items()},
    )


def noisy_inputs(
    case: Cases, noisy: NoisyInput, level: float, draws: int, seed: int = 0, exact: int = 0
) -> tuple[Array, Array]:
    """Inflow (row, time) and undeformed area (row, z) of one case, one of them noisy.

    The first ``exact`` rows have no noise.
    """
    rng = np.random.default_rng(seed)
    inputs = {
        "inflow": np.repeat(case.inflow, exact + draws, axis=0),
        "area_undeformed": np.repeat(case.area_undeformed, exact + draws, axis=0),
    }
    clean = inputs[noisy][exact:].copy()
    size = level * np.abs(clean).max()
    values = clean + size * rng.standard_normal(clean.shape)
    if noisy == "area_undeformed":
        # At least half of the draws of each value are positive, so this ends.
        while (empty := values <= 0).any():
            values[empty] = clean[empty] + size * rng.standard_normal(int(empty.sum()))
    inputs[noisy][exact:] = values
    return inputs["inflow"], inputs["area_undeformed"]


def _predict(
    engine: Engine,
    config: recipes.Config,
    parameters: Parameters | ClosureParameters,
    inflow: Array,
    area_undeformed: Array,
    grid: Grid,
) -> Solution:
    """Flow, area and pressure of some draws."""
    return recipes.predict(engine, config, parameters, inflow, area_undeformed, grid)
