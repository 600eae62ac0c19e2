"""Fit of each closure to the training cases: small nonlinear least-squares problems.

The engine gives values and Jacobians; the solver is SciPy's, a trust-region method for
parameters with bounds, else that of Levenberg and Marquardt.  Engines that agree find the
same parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.config.settings import OutletClosure
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.closure_parameters import CORRECTION_SCALARS, ClosureParameters, sizes
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.shared_terms import harmonic_frequencies, outlet_impedance, rate
from pcnde_bridge.engines.types import Fit, OnIteration, Problem
from pcnde_bridge.errors import SolveError

_WALL_TIMES = 25
"""Time points on which the wall is fitted: it follows the pressure at once, so few do."""

_FLOW_POINTS = 5
"""Points, beside the inlet, on which the flow is compared: it is smooth along the vessel."""

_LOSS_TOLERANCE = 1e-4
"""Relative decrease of the loss below which a fit ends."""

_TOLERANCES = "", "gradient", "loss", "step", "loss and step"
"""Tolerances by the status of :func:`scipy.optimize.least_squares`."""

_SMOOTH_OUTLET = 0.01  # largest error of a resistance, relative to the pressure's variation
_FIRST_LOGIT = -4.0  # of the correction: almost off
_SHARE_QUANTILE = 0.98
_SMALLEST_STORAGE = 0.01
_CEILINGS = (0.01, 0.95)


class _Parameter(NamedTuple):
    """Given value of a parameter, or None; else the start of its fit, and its bounds."""

    given: float | None
    start: float
    low: float = -np.inf
    high: float = np.inf


def fit_outlet(cases: Cases, config: ClosureConfig) -> Array:
    """Find R₁, R₂, C and p_d from flow and pressure at the outlet.

    A resistance is found by linear regression, and a Windkessel starting from it.
    """
    flow, pressure = cases.flow[:, :, -1], cases.pressure[:, :, -1]
    given = config.outlet
    resistance, distal = given.resistance, given.distal_pressure
    if resistance is None and distal is None:
        resistance, distal = map(float, np.polyfit(flow.ravel(), pressure.ravel(), 1))
        # A distal pressure within the error of the regression counts as zero.
        scatter = np.std(pressure - resistance * flow - distal)
        if abs(distal) < 2 * scatter:
            distal, resistance = 0.0, float((pressure * flow).sum() / (flow**2).sum())
    elif resistance is None:
        assert distal is not None
        resistance = float(((pressure - distal) * flow).sum() / (flow**2).sum())
    elif distal is None:
        distal = float((pressure - resistance * flow).mean())
    error = np.std(pressure - resistance * flow - distal) / np.std(pressure)
    if given.kind == "resistance" or (given.kind == "auto" and error <= _SMOOTH_OUTLET):
        return np.array([resistance, 0.0, 0.0, distal])
    return _fit_windkessel(flow, pressure, cases.period, resistance, given)


def _fit_windkessel(
    flow: Array, pressure: Array, period: float, total: float, given: OutletClosure
) -> Array:
    """Fit three elements around the resistance ``total``, which a regression has found."""
    from scipy.optimize import least_squares

    n_times = flow.shape[1]
    harmonics = np.fft.rfft(flow, axis=1)
    omega = harmonic_frequencies(n_times, period)
    scale = float(np.std(pressure)) or 1.0

    def numbers(x: Array) -> Array:
        share, time_constant, offset, factor = x
        r2 = (1 - share) * factor * total
        return np.array([share * factor * total, r2, time_constant / r2, offset * scale])

    def residual(x: Array) -> Array:
        r1, r2, compliance, offset = numbers(x)
        impedance = outlet_impedance(r1, r2, compliance, omega)
        predicted = np.fft.irfft(harmonics * impedance, n=n_times, axis=1) + offset
        error: Array = ((predicted - pressure) / scale).ravel()
        return error

    # A regression over all time points does not give R₁ + R₂; a given number stays (almost).
    tiny = 1e-9
    offset = None if given.distal_pressure is None else given.distal_pressure / scale
    offsets = (-np.inf, np.inf) if offset is None else (offset - tiny, offset + tiny)
    factors = (0.1, 10.0) if given.resistance is None else (1 - tiny, 1 + tiny)
    low, high = np.array([(1e-3, 1.0), (0.0, 100 * period), offsets, factors]).T
    start = [0.2, 0.2 * period, offset or 0.0, 1.0]
    return numbers(least_squares(residual, start, bounds=(low, high)).x)


def fit_losses(
    closures: Closures, cases: Cases, config: ClosureConfig, on_iteration: OnIteration | None = None
) -> Fit:
    """Fit friction, inertia, convection and jet spread to p − p(L), with the reference flow."""
    given = config.losses
    target = cases.pressure - cases.pressure[:, :, -1:]
    problem = closures.losses(cases.flow, cases.area_undeformed, cases.grid, config)
    factors = given.friction, given.inertia, given.convection
    parameters = [_Parameter(factor, 1.0, 0.01, 100.0) for factor in factors]
    parameters.append(_Parameter(given.jet_spread, 0.1, 1e-3, 10.0))
    residual = _relative(problem, target, float(np.linalg.norm(cases.pressure)))
    return _solve(residual, parameters, config.correction.evaluations, on_iteration)


def fit_wall(
    closures: Closures, cases: Cases, config: ClosureConfig, on_iteration: OnIteration | None = None
) -> Fit:
    """Fit the wall parameters to S, with the reference pressure."""
    given = config.wall
    times = np.unique(np.linspace(0, cases.n_times - 1, _WALL_TIMES).astype(int))
    pressure, target = cases.pressure[:, times], cases.area[:, times]
    problem = closures.area(pressure, cases.area_undeformed, cases.grid, config)
    # Stiffness and zero pressure start from a quarter of the length, where the vessel is wide.
    point = cases.n_points // 4
    radius = np.sqrt(cases.area_undeformed[:, None, point] / np.pi)
    strain = np.sqrt(target[:, :, point] / np.pi) / radius - 1
    slope, offset = np.polyfit(strain.ravel(), pressure[:, :, point].ravel(), 1)
    stiffness = max(float(slope), float(np.ptp(pressure)) * 1e-3)
    zero = float(offset) if abs(offset) > 0.2 * float(np.abs(pressure).max()) else 0.0
    if given.law == "membrane":
        stiffness *= float(radius.mean())
        others = [
            _Parameter(given.poisson, 0.45, 0.0, 0.5),
            _Parameter(given.shear, 0.2, 1e-4, 10.0),
            _Parameter(given.support, 1.0, 1e-6, 1e4),
        ]
    else:
        others = [_Parameter(given.exponent, 0.0, -10.0, 10.0)]
    first = _Parameter(given.stiffness, stiffness, stiffness * 1e-3, stiffness * 1e3)
    parameters = [first, *others, _Parameter(given.zero_pressure, zero)]
    residual = _relative(problem, target, float(np.linalg.norm(target)))
    return _solve(residual, parameters, config.correction.evaluations, on_iteration)


def first_correction(cases: Cases, config: ClosureConfig, rng: np.random.Generator) -> Array:
    """Return the correction before its fit: κ, ceiling and scales from the cases, random weights.

    The ceiling is the 98 % quantile of the share of the storage that the flow does not show,
    1 − (Q_in − Q(L))/(κ ∂V/∂t), where the storage is more than half its largest; κ is the
    median of (Q_in − Q(L))/(∂V/∂t) where the storage is more than a tenth of its largest.
    """
    volume = (cases.area[:, :, 1:] + cases.area[:, :, :-1]) / 2 @ np.diff(cases.z)
    stored = rate(volume, cases.period)
    lost = cases.inflow - cases.flow[:, :, -1]
    clear = np.abs(stored) > 0.1 * np.abs(stored).max()
    kappa = config.correction.storage or max(
        float(np.median(lost[clear] / stored[clear])), _SMALLEST_STORAGE
    )
    strong = stored > 0.5 * stored.max()
    ceiling = np.quantile(1 - lost[strong] / (kappa * stored[strong]), _SHARE_QUANTILE)
    slope = rate(cases.pressure[:, :, -1], cases.period)
    scalars = [
        kappa,
        float(np.clip(ceiling, *_CEILINGS)),
        float(np.std(slope)) or 1.0,
        float(np.abs(cases.flow[:, :, -1]).mean()) or 1.0,
    ]
    weights = rng.normal(size=sizes(config)["correction"] - CORRECTION_SCALARS) * 0.5
    # The last bias switches the correction off where the data do not need it.
    weights[-1] = _FIRST_LOGIT
    return np.concatenate([scalars, weights])


def fit_correction(
    closures: Closures,
    others: ClosureParameters,
    cases: Cases,
    config: ClosureConfig,
    first: Array,
    weight: Array,
    evaluations: int,
    on_iteration: OnIteration | None = None,
) -> Fit:
    """Fit κ and the network to the flow, with all closures coupled.

    Parameters
    ----------
    closures : Closures
        Engine of the closures.
    others : ClosureParameters
        Outlet, losses and wall.
    cases, config
        Training cases and settings.
    first : array of shape (n,)
        Correction to start from; its ceiling and scales stay.
    weight : array of shape (case,)
        0 for cases that are left out, else 1: every fit has the same shapes, which are
        compiled once.
    evaluations : int
        Largest number of evaluations.
    on_iteration : callable, optional
        Called with the number and loss of each evaluation that decreases the loss.
    """
    settings = config.correction
    points = np.unique(np.linspace(0, cases.n_points - 1, _FLOW_POINTS + 1).astype(int)[1:])
    target = cases.flow[:, :, points]
    factor = 100 * weight[:, None, None] / np.linalg.norm(weight[:, None, None] * target)
    kappa, fixed, weights = np.split(first, [1, CORRECTION_SCALARS])
    problem = closures.flow(others, cases.inflow, cases.area_undeformed, points, cases.grid, config)
    # The weights decay towards a correction that is off.
    decay = np.sqrt(settings.weight_decay)
    prior = np.zeros((weights.size, weights.size + 1))
    prior[:, 1:] = decay * np.eye(weights.size)
    center = np.zeros(weights.size)
    center[-1] = _FIRST_LOGIT

    def whole(x: Array) -> Array:
        return np.concatenate([x[:1], fixed, x[1:]])

    def residual(x: Array) -> tuple[Array, Array]:
        value, jacobian = problem(whole(x))
        error = (factor * (value - target)).ravel()
        slope = factor[..., None] * np.delete(jacobian, np.arange(1, CORRECTION_SCALARS), axis=-1)
        slope = slope.reshape(-1, x.size)
        return np.concatenate([error, decay * (x[1:] - center)]), np.concatenate([slope, prior])

    parameters = [_Parameter(settings.storage, float(kappa[0]))]
    parameters += [_Parameter(None, float(weight)) for weight in weights]
    found = _solve(residual, parameters, evaluations, on_iteration)
    return replace(found, parameters=whole(found.parameters))


def _relative(problem: Problem, target: Array, scale: float) -> Problem:
    """Return the problem of the error against the target, relative to a scale."""

    def residual(x: Array) -> tuple[Array, Array]:
        value, jacobian = problem(x)
        return (value - target) / scale, jacobian / scale

    return residual


def _solve(
    residual: Problem,
    parameters: Sequence[_Parameter],
    evaluations: int,
    on_iteration: OnIteration | None,
) -> Fit:
    """Minimize ½|residual|² over the parameters that are not given."""
    from scipy.optimize import least_squares

    x = np.array([p.start if p.given is None else p.given for p in parameters])
    free = np.array([p.given is None for p in parameters])
    if not free.any():
        return Fit(x, np.empty(0), True, "all parameters are given")
    problem = _FreeProblem(residual, x, free, on_iteration)
    if not np.isfinite(residual(x)[0]).all():
        raise SolveError(
            "The closures cannot be evaluated at their first values. Check the units of the "
            "training cases (mL/s, cm², dyn/cm²)."
        )
    low, high = np.array([(p.low, p.high) for p in parameters])[free].T
    found = least_squares(
        problem.value,
        x[free],
        problem.jacobian,
        bounds=(low, high),
        method="trf" if np.isfinite([low, high]).any() else "lm",
        x_scale="jac",
        max_nfev=evaluations,
        ftol=_LOSS_TOLERANCE,
    )
    met = _TOLERANCES[found.status]
    outcome = f"{met} tolerance" if met else "all evaluations done"
    return Fit(problem.whole(found.x), np.array(problem.losses), bool(met), outcome)


@dataclass
class _FreeProblem:
    """Least-squares problem in the free parameters, with the Jacobian of the last evaluation.

    ``losses`` has the loss of each evaluation that decreased it.
    """

    residual: Problem
    start: Array
    free: Array
    on_iteration: OnIteration | None
    losses: list[float] = field(default_factory=list)
    _last: tuple[Array, Array] | None = None

    def whole(self, part: Array) -> Array:
        """Return all parameters, the given ones included."""
        whole = self.start.copy()
        whole[self.free] = part
        return whole

    def value(self, part: Array) -> Array:
        """Return the residual; where it is not finite, a large one in its place."""
        r, jacobian = self.residual(self.whole(part))
        r, jacobian = r.ravel(), jacobian.reshape(-1, self.start.size)[:, self.free]
        if not np.isfinite(r).all():
            return np.full_like(r, 1e6)
        self._last = part.copy(), jacobian
        loss = float(r @ r)
        if not self.losses or loss < self.losses[-1]:
            self.losses.append(loss)
            if self.on_iteration is not None:
                self.on_iteration(len(self.losses), loss)
        return r

    def jacobian(self, part: Array) -> Array:
        """Return the Jacobian, which every evaluation gives with the residual."""
        if self._last is None or not np.array_equal(self._last[0], part):
            self.value(part)
        assert self._last is not None
        return self._last[1]
