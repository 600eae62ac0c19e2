"""Stage of the JAX engine: pads the cases, compiles an equation, and fits it."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import compiled, double_precision
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.jax.bfgs import minimize
from pcnde_bridge.engines.protocol import Stage
from pcnde_bridge.engines.types import Fit, FitData, Objective, OnIteration, StageInputs, ignore
from pcnde_bridge.errors import SolveError

_LARGEST_BATCH = 128

Inputs = tuple[jax.Array, ...]
"""Arrays of a stage's inputs, each of shape (case, ...)."""

GridArrays = tuple[jax.Array, jax.Array]
"""Points, cm, and period, s."""

Model = Callable[[jax.Array, Inputs, jax.Array, GridArrays, PCNDEConfig], jax.Array]
"""Equation of a stage, for parameters, inputs, weights, grid and configuration.

The weights (case,) are 0 for cases that only pad a batch.  The result (case, time, z) is not
finite where the equation cannot be solved.
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
    integrates : bool
        Whether the equation may diverge; the loss is infinite then.
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
        integrates: bool = False,
        loss_scale: Callable[[PCNDEConfig, Any], Any] = lambda _, count: count,
        case_by_case: Callable[[PCNDEConfig], bool] = lambda _: False,
    ) -> None:
        self._model = model
        self._depends_on = depends_on
        self._integrates = integrates
        self._loss_scale = loss_scale
        self._case_by_case = case_by_case
        compile_ = compiled("config")
        self._solve = compile_(self._predict)
        self._value = compile_(self._loss)
        self._value_and_gradient = compile_(jax.value_and_grad(self._loss))
        self._values = compile_(self._losses)

    def solve(self, vector: Array, inputs: StageInputs, grid: Grid, config: PCNDEConfig) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        with double_precision():
            settings = {"grid": on_device(grid), "config": self._relevant(config)}
            return in_batches(partial(self._solve, vector, **settings), inputs)[0]

    def losses(self, vectors: Array, data: FitData) -> Array:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        with double_precision():
            arrays, settings = _padded_data(data), self._relevant(data.config)
            return np.asarray(self._values(vectors, *arrays, config=settings))

    def objective(self, data: FitData, weight: Array) -> Objective:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        # Cases of weight 0 are retained, so that all selections share one compilation.
        return self._objective(_on_device(data, weight), data.config)

    def fit(
        self, start: Array, data: FitData, iterations: int, on_iteration: OnIteration = ignore
    ) -> Fit:
        """See :class:`pcnde_bridge.engines.protocol.Stage`."""
        arrays, settings = _padded_data(data), self._relevant(data.config)

        def value(parameters: Array) -> float:
            return float(self._value(parameters, *arrays, config=settings))

        objective, optimizer = self._objective(arrays, data.config), data.config.optimizer
        with double_precision():
            return minimize(value, objective, start, optimizer, iterations, on_iteration)

    def _objective(self, arrays: tuple[Any, ...], config: PCNDEConfig) -> Objective:
        settings = self._relevant(config)

        def evaluate(parameters: Array) -> tuple[float, Array]:
            with double_precision():
                loss, gradient = self._value_and_gradient(parameters, *arrays, config=settings)
                return float(loss), np.array(gradient)

        return evaluate

    def _relevant(self, config: PCNDEConfig) -> PCNDEConfig:
        return PCNDEConfig(**{name: getattr(config, name) for name in self._depends_on})

    def _predict(
        self, parameters: jax.Array, inputs: Inputs, grid: GridArrays, config: PCNDEConfig
    ) -> Inputs:
        def predict(cases: Inputs) -> jax.Array:
            return self._model(parameters, cases, jnp.ones(len(cases[0])), grid, config)

        if self._case_by_case(config):
            return (jax.vmap(lambda *case: predict(tuple(a[None] for a in case))[0])(*inputs),)
        return (predict(inputs),)

    def _loss(self, parameters: jax.Array, *arrays: Any, config: PCNDEConfig) -> jax.Array:
        """Return the loss; the arrays are those of :func:`_on_device`."""
        inputs, weight, target, grid = arrays
        # In the step control every case with a positive weight counts alike.
        counted = (weight > 0).astype(weight.dtype)
        predicted = self._model(parameters, inputs, counted, grid, config)
        # The intermediate area has several cycles, of which the last is compared.
        error = predicted[:, -target.shape[1] :] - target
        count = jnp.sum(weight) * math.prod(target.shape[1:])
        total = jnp.sum(weight[:, None, None] * error**2)
        loss = total / self._loss_scale(config, count)
        if not self._integrates:
            return loss
        return jnp.where(jnp.all(jnp.isfinite(predicted)), loss, jnp.inf)

    def _losses(self, rows: jax.Array, *arrays: Any, config: PCNDEConfig) -> jax.Array:
        """Return the loss of each row of parameters, for a limited number of rows at a time."""
        at_once = max(1, _LARGEST_BATCH // len(arrays[1]))
        loss = partial(self._loss, config=config)
        return jax.lax.map(lambda row: loss(row, *arrays), rows, batch_size=at_once)


def in_batches(compute: Callable[[Inputs], Inputs], arrays: StageInputs) -> StageInputs:
    """Compute cases in batches of a few sizes, and join the results.

    Parameters
    ----------
    compute : callable
        Maps arrays of several cases to results, of which the first, (case, time, z), is not finite
        in cases that could not be solved.
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
        computed = compute(jax.device_put(_padded(part)))
        results = [np.asarray(result)[:count] for result in computed]
        failed = np.flatnonzero(~np.isfinite(results[0]).all(axis=(1, 2)))
        if failed.size:
            raise SolveError(
                f"The momentum equation could not be integrated for case {start + failed[0]} "
                f"({failed.size} of {count} cases failed): the step became too small or a value "
                "not finite. Check the units of inflow and area (mL/s, cm²) and that they "
                "resemble the training data.",
                start + failed,
            )
        batches.append(results)
    # Copies, because JAX's own arrays are read-only.
    return tuple(np.concatenate(parts) for parts in zip(*batches, strict=True))


def on_device(grid: Grid) -> GridArrays:
    """Return points and period as JAX arrays."""
    return jax.device_put((grid.z, grid.period))


def _on_device(data: FitData, weight: Array) -> tuple[Any, ...]:
    """Return inputs, weights and target, and the grid, as JAX arrays."""
    with double_precision():
        arrays = tuple(data.inputs), weight.astype(float), data.target
        return *jax.device_put(arrays), on_device(data.grid)


def _padded_data(data: FitData) -> tuple[Any, ...]:
    """Return the arrays of :func:`_on_device`, padded with cases of weight 0."""
    *inputs, target = _padded((*data.inputs, data.target))
    weight = (np.arange(len(target)) < len(data.target)).astype(float)
    return _on_device(data._replace(inputs=tuple(inputs), target=target), weight)


def _padded(arrays: tuple[Array, ...]) -> tuple[Array, ...]:
    """Repeat the last case up to the next compiled size."""
    count = len(arrays[0])
    power = 1 << max(count - 1, 0).bit_length()
    size = power * 3 // 4 if power >= 4 and count <= power * 3 // 4 else power
    return tuple(np.concatenate([a, np.repeat(a[-1:], size - count, 0)]) for a in arrays)
