"""Effect of noise in an input on the prediction (section 3.5 and appendix of the paper).

    x* = x + ε·σ,   σ = level·max|x|,   ε ~ N(0, 1), independent for every value

where x is the inflow Q_in(t) or the undeformed area S_u(z).
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array, BoolArray, IntArray
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.parallel import Workers, each
from pcnde_bridge._utils.validation import check_memory, whole
from pcnde_bridge.config import Config
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import FIELDS
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import Solution, solve_most
from pcnde_bridge.errors import InputError, PCNDEWarning, TaskError
from pcnde_bridge.model.inputs import Inputs
from pcnde_bridge.model.kinds import kind_of
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.studies._shared import check_single

NoisyInput = Literal["inflow", "area_undeformed"]

_BLOCK = 32  # largest number of rows that are predicted at once


@dataclass(frozen=True, eq=False, repr=False)
class NoiseStudy(Displayed):
    """Predictions of one case from a noisy input.

    Attributes
    ----------
    noisy : {'inflow', 'area_undeformed'}
        Input with noise.
    level : float
        σ relative to the largest value of the input.
    samples : int
        Number of noisy inputs that were predicted.
    case : Cases
        The case, which is the truth.
    unperturbed, mean, standard_deviation : mapping of str to array of shape (time, z)
        Prediction without noise, and mean and standard deviation of those with noise:
        flow (mL/s), area (cm²) and pressure (dyn/cm²).
    """

    noisy: NoisyInput
    level: float
    samples: int
    case: Cases
    unperturbed: Mapping[str, Array]
    mean: Mapping[str, Array]
    standard_deviation: Mapping[str, Array]

    def spread(self) -> dict[str, float]:
        """Return each variable's mean standard deviation over the largest value of its mean."""
        return {
            name: float(self.standard_deviation[name].mean() / np.abs(mean).max())
            for name, mean in self.mean.items()
        }

    def to_frame(self) -> pd.DataFrame:
        """Return scalar measures, a row for each variable.

        Returns
        -------
        DataFrame
            Columns ``spread`` (see :meth:`spread`), and ``bias``: the largest difference
            between the mean and the prediction without noise, over the same value.
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
    samples: int = 90,
    seed: int = 0,
    executor: Workers | None = None,
) -> NoiseStudy:
    """Predict one case many times, each time with different noise in one of its inputs.

    Parameters
    ----------
    model : PCNDE
        Model of any preset.
    case : Cases
        A single case; the paper uses the hardest test case.
    noisy : {'inflow', 'area_undeformed'}
        Input with noise.  Noise that would make an area negative or zero is sampled
        again.
    level : float
        σ relative to the largest value of the input.
    samples : int
        Number of noisy inputs, at least 2.
    seed : int
        Random seed for the noise.
    executor : Executor or int, optional
        Executor, or number of processes, of the predictions; by default they run in this
        process.  Results are equal bit for bit if XLA has as many threads.

    Returns
    -------
    NoiseStudy
        Mean, standard deviation and scalar measures.

    Raises
    ------
    InputError
        If there is not exactly one case, or an argument is invalid.
    TaskError
        If the equations diverge for all samples but one, or without noise.

    Warns
    -----
    PCNDEWarning
        If they diverge for a few samples, which are left out.
    """
    check_single(case, "A noise study needs")
    if noisy not in get_args(NoisyInput):
        raise InputError(f"noisy must be one of {list(get_args(NoisyInput))}, got {noisy!r}.")
    if not (np.isfinite(level) and level >= 0):
        raise InputError(f"level must be a number ≥ 0, got {level!r}.")
    samples, seed = whole("samples", samples, 2), whole("seed", seed)
    numbers = 2 * len(FIELDS) * samples * case.n_times * case.n_points
    check_memory(f"A study of {samples} samples", numbers, "request fewer samples")
    model.check_grid(case)
    # Blocks have one size, because engines compile for each size.  The exact input, needed
    # once anyway, fills the rest.
    count = -(-(samples + 1) // _BLOCK)
    size = -(-(samples + 1) // count)
    exact = count * size - samples
    inflow, area = noisy_inputs(case, noisy, level, samples, seed, exact)
    trained = model.engine, model.config, model.parameters
    tasks = {
        f"samples from {rows[0]}": (*trained, Inputs(inflow[rows], area[rows], case.grid))
        for rows in np.split(np.arange(count * size), count)
    }
    solutions, lost = zip(*each(_predict_most, tasks, executor, progress=False), strict=True)
    failed = np.concatenate(lost)
    settled = exact + np.flatnonzero(~failed[exact:])
    if failed[:exact].any() or settled.size < 2:
        raise TaskError("The equations diverge without noise, or for all samples but one.")
    if settled.size < samples:
        warnings.warn(
            f"The equations diverge for {samples - settled.size} of {samples} samples, which are "
            "left out: mean and standard deviation are those of the others.",
            PCNDEWarning,
            stacklevel=2,
        )
    values = {
        name: np.concatenate(arrays)
        for name, arrays in zip(FIELDS, zip(*solutions, strict=True), strict=True)
        if arrays[0] is not None
    }
    return NoiseStudy(
        noisy,
        float(level),
        settled.size,
        case,
        unperturbed={name: array[0] for name, array in values.items()},
        mean={name: array[settled].mean(axis=0) for name, array in values.items()},
        standard_deviation={k: array[settled].std(axis=0, ddof=1) for k, array in values.items()},
    )


def _predict_most(
    engine: Engine, config: Config, parameters: Any, inputs: Inputs
) -> tuple[Solution, BoolArray]:
    """Predict a block of rows; return also those whose results are another row's."""
    kind = kind_of(config)

    def solve(rows: IntArray) -> Solution:
        given = inputs.inflow[rows], inputs.area_undeformed[rows], inputs.grid
        return kind.predict(engine, config, parameters, Inputs(*given))[0]

    return solve_most(solve, len(inputs))


def noisy_inputs(
    case: Cases, noisy: NoisyInput, level: float, samples: int, seed: int = 0, exact: int = 0
) -> tuple[Array, Array]:
    """Return inflow (row, time) and undeformed area (row, z) of one case, one of them noisy.

    The first ``exact`` rows have no noise.
    """
    rng = np.random.default_rng(seed)
    rows, names = exact + samples, get_args(NoisyInput)
    inputs = {name: np.repeat(getattr(case, name), rows, axis=0) for name in names}
    clean = inputs[noisy][exact:].copy()
    sigma = level * np.abs(clean).max()
    values = clean + sigma * rng.standard_normal(clean.shape)
    if noisy == "area_undeformed":
        # At least half of the samples of each value are positive, so this ends.
        while (empty := values <= 0).any():
            values[empty] = clean[empty] + sigma * rng.standard_normal(int(empty.sum()))
    inputs[noisy][exact:] = values
    return inputs["inflow"], inputs["area_undeformed"]
