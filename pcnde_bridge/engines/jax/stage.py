"""Stage of the JAX engine: pads the cases, compiles an equation, and fits it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.jax.bfgs import minimize
from pcnde_bridge.engines.protocol import Stage
from pcnde_bridge.engines.types import Fit, Objective, OnIteration, StageInputs
from pcnde_bridge.errors import SolveError

_LARGEST_BATCH = 128

Inputs = tuple[jax.Array, ...]
"""Arrays of a stage's inputs, each of shape (case, ...)."""

GridArrays = tuple[jax.Array, jax.Array]
"""Points, cm, and period, s."""

Result = tuple[jax.Array, jax.Array]
"""Prediction (case, time, z), and whether it, or each case, was solved."""

Model = Callable[[jax.Array, Inputs, jax.Array, GridArrays, PCNDEConfig], Result]
"""Equation of a stage, for parameters, inputs, weights, grid and configuration.

The weights (case,) are 0 for cases that only pad a batch.
"""


class JaxStage(Stage):
    """Stage that integrates or evaluates an equation in JAX.

    It is compiled once for each shape.  Numbers of cases are rounded up to 2^k or 3·2^(k−1),
    so that few shapes occur: the last, smaller batch of an epoch is padded to the others'.

    Parameters
    ----------
    model : Model
        The equation.
    depends_on : tuple of str
        Groups of settings that the equation needs; a change of other settings
        does not trigger a compilation.
    loss_scale : callable
        ``(config, count) -> divisor`` of the sum of squares.
    case_by_case : callable
        ``config -> bool``, whether :meth:`solve` must map the model over single cases,
        because they influence each other through the step control.
    """

    def __init__(
        self,
        model: Model,
        depends_on: tuple[str, ...],
        *,
        loss_scale: Callable[[PCNDEConfig, Any], Any] = lambda _, count: count,
        case_by_case: Callable[[PCNDEConfig], bool] = lambda _: False,
    ) -> None:
        self._model = model
        self._depends_on = depends_on
        self._loss_scale = loss_scale
        self._case_by_case = case_by_case
        compile_ = partial(jax.jit, static_argnames=("config",))
        self._solve = compile_(self._predict)
        self._value = compile_(self._loss)
        self._value_and_gradient = compile_(jax.value_and_grad(self._loss))
        self._values = compile_(self._losses)

    def solve(
        self, parameters: Array, inputs: StageInputs, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        with double_precision():
            settings = {"grid": on_device(grid), "config": self._relevant(config)}
            (result,) = in_batches(partial(self._solve, parameters, **settings), inputs)
            return result

    def losses(
        self, parameters: Array, inputs: StageInputs, target: Array, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        with double_precision():
            data = _fit_data(inputs, target, grid)
            return np.asarray(self._values(parameters, *data, config=self._relevant(config)))

    def objective(
        self, inputs: StageInputs, target: Array, weight: Array, grid: Grid, config: PCNDEConfig
    ) -> Objective:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        # Cases of weight 0 are retained, so that all selections share one compilation.
        return self._objective(_data(inputs, weight, target, grid), config)

    def fit(
        self,
        parameters: Array,
        inputs: StageInputs,
        target: Array,
        grid: Grid,
        config: PCNDEConfig,
        iterations: int,
        on_iteration: OnIteration | None = None,
    ) -> Fit:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        data, settings = _fit_data(inputs, target, grid), self._relevant(config)
        with double_precision():
            return minimize(
                lambda x: float(self._value(x, *data, config=settings)),
                self._objective(data, config),
                parameters,
                config.optimizer,
                iterations,
                on_iteration,
            )

    def _objective(self, data: tuple[Any, ...], config: PCNDEConfig) -> Objective:
        settings = self._relevant(config)

        def evaluate(parameters: Array) -> tuple[float, Array]:
            with double_precision():
                loss, gradient = self._value_and_gradient(parameters, *data, config=settings)
                return float(loss), np.array(gradient)

        return evaluate

    def _relevant(self, config: PCNDEConfig) -> PCNDEConfig:
        return PCNDEConfig(**{name: getattr(config, name) for name in self._depends_on})

    def _predict(
        self, parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
    ) -> tuple[Inputs, jax.Array]:
        count = inputs[0].shape[0]
        if not self._case_by_case(config):
            predicted, solved = self._model(parameters, inputs, jnp.ones(count), grid, config)
            return (predicted,), jnp.broadcast_to(solved, (count,))

        def one(*case: jax.Array) -> tuple[Inputs, jax.Array]:
            batch_of_one = tuple(a[None] for a in case)
            predicted, solved = self._model(parameters, batch_of_one, jnp.ones(1), grid, config)
            return (predicted[0],), jnp.all(solved)

        return jax.vmap(one)(*inputs)

    def _loss(self, parameters: jax.Array, *data: Any, config: PCNDEConfig) -> jax.Array:
        """Return the loss; the data are those of :func:`_data`."""
        inputs, weight, target, grid = data
        # In the step control every case with a positive weight counts alike.
        counted = (weight > 0).astype(weight.dtype)
        predicted, solved = self._model(parameters, inputs, counted, grid, config)
        # The intermediate area has several cycles, of which the last is compared.
        error = predicted[:, -target.shape[1] :] - target
        count = jnp.sum(weight) * math.prod(target.shape[1:])
        total = jnp.sum(weight[:, None, None] * error**2)
        return jnp.where(jnp.all(solved), total / self._loss_scale(config, count), jnp.inf)

    def _losses(self, rows: jax.Array, *data: Any, config: PCNDEConfig) -> jax.Array:
        """Return the loss of each row of parameters, for a limited number of rows at a time."""
        at_once = max(1, _LARGEST_BATCH // len(data[1]))
        loss = partial(self._loss, config=config)
        found: jax.Array = jax.lax.map(lambda row: loss(row, *data), rows, batch_size=at_once)
        return found


def in_batches(
    compute: Callable[[Inputs], tuple[Inputs, jax.Array]],
    arrays: tuple[Array, ...],
) -> tuple[Array, ...]:
    """Compute cases in batches of a few sizes, and join the results.

    Parameters
    ----------
    compute : callable
        Maps arrays of some cases to results and, for each case, whether it was solved.
    arrays : tuple of arrays of shape (case, ...)
        All cases.

    Raises
    ------
    SolveError
        With the first case that was not solved.
    """
    batches = []
    for start in range(0, len(arrays[0]), _LARGEST_BATCH):
        part = tuple(a[start : start + _LARGEST_BATCH] for a in arrays)
        count = len(part[0])
        results, solved = compute(jax.tree.map(jnp.asarray, _padded(part)))
        failed = np.flatnonzero(~np.asarray(solved)[:count])
        if failed.size:
            raise SolveError(
                f"The momentum equation could not be integrated for case {start + failed[0]} "
                f"({failed.size} of {count} cases failed): the step became too small or a value "
                "not finite. Check the units of inflow and area (mL/s, cm²) and that they "
                "resemble the training data."
            )
        batches.append([np.asarray(r)[:count] for r in results])
    # Copies, because JAX's own arrays are read-only.
    return tuple(np.concatenate(parts) for parts in zip(*batches, strict=True))


def on_device(grid: Grid) -> GridArrays:
    """Return points and period as JAX arrays."""
    return jnp.asarray(grid.z), jnp.asarray(grid.period)


def _data(inputs: StageInputs, weight: Array, target: Array, grid: Grid) -> tuple[Any, ...]:
    """Return inputs, weights and target, and the grid, as JAX arrays."""
    with double_precision():
        arrays = tuple(inputs), weight.astype(float), target
        return *jax.tree.map(jnp.asarray, arrays), on_device(grid)


def _fit_data(inputs: StageInputs, target: Array, grid: Grid) -> tuple[Any, ...]:
    """Return the data of :func:`_data`, padded with cases of weight 0."""
    weight = np.where(np.arange(_rounded_up(len(target))) < len(target), 1.0, 0.0)
    *arrays, padded_target = _padded((*inputs, target))
    return _data(tuple(arrays), weight, padded_target, grid)


def _rounded_up(count: int) -> int:
    power = 1 << max(count - 1, 0).bit_length()
    return power * 3 // 4 if power >= 4 and count <= power * 3 // 4 else power


def _padded(arrays: tuple[Array, ...]) -> tuple[Array, ...]:
    """Repeat the last case up to the next compiled size."""
    count = arrays[0].shape[0]
    missing = _rounded_up(count) - count
    return tuple(np.concatenate([a, np.repeat(a[-1:], missing, 0)]) for a in arrays)
