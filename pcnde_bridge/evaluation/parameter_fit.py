"""Calibration of the 1D solver or a trained model to measured pressures and flows."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import ndtri

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.jax_context import compiled, double_precision
from pcnde_bridge._utils.validation import finite_array, positive
from pcnde_bridge.errors import InputError, SolveError

Predict = Callable[[dict[str, Any]], Any]
"""JAX function from parameters, by name, to the values that were measured."""


@dataclass(frozen=True)
class Calibration:
    """Result of :func:`calibrate`.

    Attributes
    ----------
    values : dict of str to float
        Most probable parameters.
    covariance : DataFrame
        Covariance of their logarithms, linearized there.
    predicted : array
        Predicted values at these parameters, in the shape of the measured ones.
    misfit : float
        Root mean square of (predicted − measured)/noise; about 1 if model and noise are right.
    """

    values: dict[str, float]
    covariance: pd.DataFrame
    predicted: Array
    misfit: float

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """Return the bounds ``low`` and ``high`` of each parameter's interval.

        Parameters
        ----------
        level : float
            Probability of the interval.
        """
        if not 0.0 < level < 1.0:
            raise InputError(f"level must be between 0 and 1, got {level!r}.")
        half = ndtri((1.0 + level) / 2.0) * np.sqrt(np.diag(self.covariance))
        bounds = {"low": np.exp(-half), "high": np.exp(half)}
        found = pd.DataFrame(bounds, index=list(self.values))
        return found.mul(pd.Series(self.values), axis=0)


def calibrate(
    predict: Predict,
    start: Mapping[str, float],
    measured: npt.ArrayLike,
    noise: npt.ArrayLike,
    *,
    priors: Mapping[str, float] | None = None,
) -> Calibration:
    """Find parameters from measured values by least squares.

    The most probable parameters under normal noise are found by SciPy's trust-region method
    with the Jacobian of JAX; their covariance is that of Gauss and Newton.  Parameters are
    positive, and sought on a logarithmic scale.

    Parameters
    ----------
    predict : callable
        JAX function that returns the measured values, of any shape, for a dict of parameters;
        see ``Tube1D.jax_function`` and ``PCNDE.jax_function``.  It is compiled once.
    start : mapping of str to float
        Positive first values, and centers of the priors.
    measured : array_like
        Measured values.
    noise : array_like
        Standard deviation of each, in the same unit; broadcasts to ``measured``.
    priors : mapping of str to float, optional
        Standard deviation of the logarithm of some parameters about their first values: 0.2
        is about 20 %.  The others have a uniform prior.

    Returns
    -------
    Calibration
        Parameters with their covariance.

    Raises
    ------
    InputError
        If a value is not usable, or the measurements do not determine the parameters.
    SolveError
        If the prediction is not finite at the first values.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> from pcnde_bridge.evaluation import calibrate
    >>> t = jnp.linspace(0.0, 1.0, 20)
    >>> found = calibrate(lambda p: jnp.exp(-t / p["tau"]), {"tau": 0.3}, jnp.exp(-2 * t), 0.01)
    >>> round(found.values["tau"], 6)
    0.5
    """
    from scipy.optimize import least_squares

    names = tuple(start)
    first = np.array([positive(f"start[{name!r}]", start[name]) for name in names])
    prior = dict(priors or {})
    if not set(prior) <= set(names) or not names:
        raise InputError(f"priors has {list(prior)}, start {list(names)}: name them alike.")
    spread = np.array(
        [positive(f"priors[{n!r}]", prior[n]) if n in prior else np.inf for n in names]
    )
    data, scale = finite_array("measured", measured), finite_array("noise", noise)
    if not (scale > 0.0).all() or np.broadcast_shapes(data.shape, scale.shape) != data.shape:
        raise InputError(f"noise must be positive and broadcast to the shape {data.shape}.")
    weight = 1.0 / np.broadcast_to(scale, data.shape).ravel()
    with double_precision():
        with_slopes = _compiled(predict, names)

        @lru_cache(maxsize=1)  # SciPy asks for the Jacobian where it has asked for the residual
        def evaluate(x: bytes) -> list[Array]:
            return [np.asarray(found) for found in with_slopes(np.frombuffer(x), first)]

        def residual(x: Array) -> Array:
            misfit = weight * (evaluate(x.tobytes())[0].ravel() - data.ravel())
            return np.concatenate([misfit, x / spread])

        def jacobian(x: Array) -> Array:
            slope = evaluate(x.tobytes())[1].reshape(data.size, len(names))
            return np.concatenate([weight[:, None] * slope, np.diag(1.0 / spread)])

        predicted, _ = evaluate(np.zeros(len(names)).tobytes())
        if predicted.shape != data.shape:
            raise InputError(f"predict returns the shape {predicted.shape}, not {data.shape}.")
        if not np.isfinite(predicted).all():
            raise SolveError("The prediction is not finite at the first values; change start.")
        found = least_squares(residual, np.zeros(len(names)), jacobian, x_scale="jac", xtol=1e-10)
        predicted, _ = evaluate(found.x.tobytes())
    information = found.jac.T @ found.jac
    if np.linalg.cond(information) > 1e14:
        raise InputError("The measurements do not determine all parameters; give priors.")
    covariance = pd.DataFrame(np.linalg.inv(information), index=names, columns=names)
    misfit = float(np.sqrt(np.mean(found.fun[: data.size] ** 2)))
    values = dict(zip(names, (first * np.exp(found.x)).tolist(), strict=True))
    return Calibration(values, covariance, predicted, misfit)


@lru_cache(maxsize=8)
def _compiled(predict: Predict, names: tuple[str, ...]) -> Callable[[Array, Array], Any]:
    """Return the compiled prediction with its Jacobian by the logarithms of the parameters."""
    import jax
    import jax.numpy as jnp

    def values(x: Any, first: Any) -> Any:
        return jnp.asarray(predict(dict(zip(names, first * jnp.exp(x), strict=True))))

    @compiled()
    def with_slopes(x: Any, first: Any) -> Any:
        return values(x, first), jax.jacfwd(values)(x, first)

    return with_slopes
