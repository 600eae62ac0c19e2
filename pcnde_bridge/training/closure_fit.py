"""Fit of each closure to the training cases: small nonlinear least-squares problems.

The engine gives values and Jacobians; the solver is SciPy's, a trust region method where
numbers have bounds, else that of Levenberg and Marquardt.  Engines that agree find the same
numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.closure_parameters import (
    CORRECTION_SCALARS,
    ClosureParameters,
    sizes,
)
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.types import OnIteration
from pcnde_bridge.errors import SolveError

Residual = Callable[[Array], tuple[Array, Array]]

_INSTANTS = 25
"""Instants on which the wall is fitted: it follows the pressure at once, so few do."""

_POINTS = 5
"""Points, beside the inlet, on which the flow is compared: it is smooth along the vessel."""

_SETTLED = 1e-4
"""Relative gain of a step below which a fit ends."""

_SMOOTH_OUTLET = 0.01
_START_LOGIT = -4.0
_SEEN = 0.98
_LEAST_STORAGE = 0.01
_CEILINGS = (0.01, 0.95)


class _Range(NamedTuple):
    """Where a number starts, and between what it stays."""

    start: float
    low: float
    high: float


def fit_outlet(cases: Cases, config: ClosureConfig) -> Array:
    """Find R₁, R₂, C and p_d from flow and pressure at the outlet.

    A resistance is linear regression; a Windkessel is fitted from it.
    """
    flow, pressure = cases.flow[:, :, -1], cases.pressure[:, :, -1]
    given = config.outlet
    resistance = given.resistance
    distal = given.distal_pressure
    if resistance is None and distal is None:
        resistance, distal = map(float, np.polyfit(flow.ravel(), pressure.ravel(), 1))
        # A distal pressure that cannot be told from the regression's own error is none.
        scatter = np.std(pressure - resistance * flow - distal)
        if abs(distal) < 2 * scatter:
            distal, resistance = 0.0, float((pressure * flow).sum() / (flow**2).sum())
    elif resistance is None:
        assert distal is not None
        resistance = float(((pressure - distal) * flow).sum() / (flow**2).sum())
    elif distal is None:
        distal = float((pressure - resistance * flow).mean())
    assert distal is not None
    plain = np.array([resistance, 0.0, 0.0, distal])
    missed = np.std(pressure - resistance * flow - distal) / np.std(pressure)
    if given.kind == "resistance" or (given.kind == "auto" and missed <= _SMOOTH_OUTLET):
        return plain
    return _windkessel(
        flow, pressure, cases.period, resistance, given.resistance, given.distal_pressure
    )


def _windkessel(
    flow: Array,
    pressure: Array,
    period: float,
    total: float,
    resistance: float | None,
    distal: float | None,
) -> Array:
    """Fit around the resistance ``total``; of the last two, what is None is found."""
    from scipy.optimize import least_squares

    harmonics = np.fft.rfft(flow, axis=1)
    omega = 2 * np.pi * np.fft.rfftfreq(flow.shape[1], period / flow.shape[1])
    scale = float(np.std(pressure)) or 1.0

    def residual(x: Array) -> Array:
        share, time_constant, offset, factor = x
        impedance = factor * total * (share + (1 - share) / (1 + 1j * omega * time_constant))
        predicted = np.fft.irfft(harmonics * impedance, n=flow.shape[1], axis=1) + offset * scale
        missed: Array = ((predicted - pressure) / scale).ravel()
        return missed

    # A regression of all instants is no measure of R₁ + R₂; a given number stays (almost).
    tiny = 1e-9
    offsets = (
        (-np.inf, np.inf) if distal is None else (distal / scale - tiny, distal / scale + tiny)
    )
    factors = (0.1, 10.0) if resistance is None else (1 - tiny, 1 + tiny)
    low, high = np.array([(1e-3, 1.0), (0.0, 100 * period), offsets, factors]).T
    start = [0.2, 0.2 * period, 0.0 if distal is None else distal / scale, 1.0]
    share, time_constant, offset, factor = least_squares(residual, start, bounds=(low, high)).x
    r2 = (1 - share) * factor * total
    return np.array([share * factor * total, r2, time_constant / r2, offset * scale])


def fit_losses(
    closures: Closures,
    cases: Cases,
    config: ClosureConfig,
    on_iteration: OnIteration | None = None,
) -> Array:
    """Fit friction, inertia, convection and jet spread to p − p(L), with the true flow."""
    given = config.losses
    grid = cases.grid
    target = cases.pressure - cases.pressure[:, :, -1:]
    scale = np.linalg.norm(cases.pressure)

    problem = closures.losses(cases.flow, cases.area_undeformed, grid, config)

    def residual(x: Array) -> tuple[Array, Array]:
        value, jacobian = problem(x)
        return (value - target) / scale, jacobian / scale

    ranges = [
        _Range(1.0, 0.01, 100.0),
        _Range(1.0, 0.01, 100.0),
        _Range(1.0, 0.01, 100.0),
        _Range(0.1, 1e-3, 10.0),
    ]
    numbers = (given.friction, given.inertia, given.convection, given.jet_spread)
    return _solve(residual, ranges, numbers, config.correction.evaluations, on_iteration)


def fit_wall(
    closures: Closures,
    cases: Cases,
    config: ClosureConfig,
    on_iteration: OnIteration | None = None,
) -> Array:
    """Fit the wall's numbers to S, with the true pressure."""
    given = config.wall
    grid = cases.grid
    instants = np.unique(np.linspace(0, cases.n_times - 1, _INSTANTS).astype(int))
    pressure, target = cases.pressure[:, instants], cases.area[:, instants]
    scale = np.linalg.norm(target)

    problem = closures.area(pressure, cases.area_undeformed, grid, config)

    def residual(x: Array) -> tuple[Array, Array]:
        value, jacobian = problem(x)
        return (value - target) / scale, jacobian / scale

    # Stiffness and zero pressure from a quarter of the way, where the vessel is wide.
    point = cases.n_points // 4
    radius = np.sqrt(cases.area_undeformed[:, None, point] / np.pi)
    strain = np.sqrt(target[:, :, point] / np.pi) / radius - 1
    slope, offset = np.polyfit(strain.ravel(), pressure[:, :, point].ravel(), 1)
    stiffness = max(float(slope), float(np.ptp(pressure)) * 1e-3)
    zero = _Range(0.0, -np.inf, np.inf)
    if abs(offset) > 0.2 * float(np.abs(pressure).max()):
        zero = _Range(float(offset), -np.inf, np.inf)
    if given.law == "membrane":
        k = stiffness * float(radius.mean())
        ranges = [
            _Range(k, k * 1e-3, k * 1e3),
            _Range(0.45, 0.0, 0.5),
            _Range(0.2, 1e-4, 10.0),
            _Range(1.0, 1e-6, 1e4),
            zero,
        ]
        numbers: Sequence[float | None] = (
            given.stiffness,
            given.poisson,
            given.shear,
            given.support,
            given.zero_pressure,
        )
    else:
        ranges = [
            _Range(stiffness, stiffness * 1e-3, stiffness * 1e3),
            _Range(0.0, -10.0, 10.0),
            zero,
        ]
        numbers = (given.stiffness, given.exponent, given.zero_pressure)
    return _solve(residual, ranges, numbers, config.correction.evaluations, on_iteration)


def _rate(signal: Array, period: float) -> Array:
    """∂f/∂t of periodic signals (case, time), exact for their Fourier series."""
    n_times = signal.shape[1]
    omega = 2 * np.pi * np.fft.rfftfreq(n_times, period / n_times)
    if n_times % 2 == 0:
        omega[-1] = 0
    return np.fft.irfft(1j * omega * np.fft.rfft(signal, axis=1), n=n_times, axis=1)


def first_correction(cases: Cases, config: ClosureConfig, rng: np.random.Generator) -> Array:
    """Correction before its fit: κ and ceiling, scales from the cases, random weights.

    The ceiling is the 98 % quantile of the share of storage, 1 − (Q_in − Q(L))/(κ ∂V/∂t),
    that the flow does not show where the storage is more than half its largest; κ is
    the median of (Q_in − Q(L))/(∂V/∂t) where it is more than a tenth.
    """
    volume = (cases.area[:, :, 1:] + cases.area[:, :, :-1]) / 2 @ np.diff(cases.z)
    stored = _rate(volume, cases.period)
    lost = cases.inflow - cases.flow[:, :, -1]
    clear = np.abs(stored) > 0.1 * np.abs(stored).max()
    kappa = config.correction.storage or max(
        float(np.median(lost[clear] / stored[clear])), _LEAST_STORAGE
    )
    strong = stored > 0.5 * stored.max()
    ceiling = np.quantile(1 - lost[strong] / (kappa * stored[strong]), _SEEN)
    rate = _rate(cases.pressure[:, :, -1], cases.period)
    scalars = [
        kappa,
        float(np.clip(ceiling, *_CEILINGS)),
        float(np.std(rate)) or 1.0,
        float(np.abs(cases.flow[:, :, -1]).mean()) or 1.0,
    ]
    weights = rng.normal(size=sizes(config)["correction"] - CORRECTION_SCALARS) * 0.5
    # The last bias keeps the correction off where nothing asks for it.
    weights[-1] = _START_LOGIT
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
) -> Array:
    """Fit κ and the network to the flow, with all closures coupled, from ``first`` on.

    ``weight`` (case,) is 0 for cases that are left out, else 1: every fit has the
    same shapes, which are compiled once.
    """
    settings, grid = config.correction, cases.grid
    points = np.unique(np.linspace(0, cases.n_points - 1, _POINTS + 1).astype(int)[1:])
    target = cases.flow[:, :, points]
    factor = 100 * weight[:, None, None] / np.linalg.norm(weight[:, None, None] * target)
    kappa, fixed, weights = np.split(first, [1, CORRECTION_SCALARS])
    n_weights = len(weights)
    decay = np.sqrt(settings.weight_decay)

    problem = closures.flow(others, cases.inflow, cases.area_undeformed, points, grid, config)
    prior = np.zeros((n_weights, n_weights + 1))
    prior[:, 1:] = decay * np.eye(n_weights)
    # No correction is what the weights are drawn to.
    centre = np.zeros(n_weights)
    centre[-1] = _START_LOGIT

    def residual(x: Array) -> tuple[Array, Array]:
        value, jacobian = problem(np.concatenate([x[:1], fixed, x[1:]]))
        error = (factor * (value - target)).ravel()
        slope = factor[..., None] * np.delete(jacobian, np.arange(1, CORRECTION_SCALARS), axis=-1)
        slope = slope.reshape(-1, x.size)
        return np.concatenate([error, decay * (x[1:] - centre)]), np.concatenate([slope, prior])

    ranges = [
        _Range(float(kappa[0]), -np.inf, np.inf),
        *(_Range(w, -np.inf, np.inf) for w in weights),
    ]
    numbers = (settings.storage, *(None for _ in weights))
    found = _solve(residual, ranges, numbers, evaluations, on_iteration)
    return np.concatenate([found[:1], fixed, found[1:]])


def _solve(
    residual: Residual,
    ranges: Sequence[_Range],
    given: Sequence[float | None],
    evaluations: int,
    on_iteration: OnIteration | None,
) -> Array:
    """Minimise ½|residual|² over the numbers that are not given."""
    from scipy.optimize import least_squares

    x = np.array([r.start if g is None else g for r, g in zip(ranges, given, strict=True)])
    free = np.array([g is None for g in given])
    if not free.any():
        return x
    last: dict[str, Array] = {}
    best = np.inf

    def full(part: Array) -> Array:
        whole = x.copy()
        whole[free] = part
        return whole

    def value(part: Array) -> Array:
        nonlocal best
        r, jacobian = residual(full(part))
        r, jacobian = r.ravel(), jacobian.reshape(-1, x.size)[:, free]
        if not np.isfinite(r).all():
            # A step too far counts as bad, not as an error.
            return np.full_like(r, 1e6)
        last["x"], last["jacobian"] = part.copy(), jacobian
        loss = float(r @ r)
        if on_iteration is not None and loss < best:
            number = value.calls = getattr(value, "calls", 0) + 1  # type: ignore[attr-defined]
            on_iteration(number, loss)
        best = min(best, loss)
        return r

    def slope(part: Array) -> Array:
        if "x" not in last or not np.array_equal(last["x"], part):
            value(part)
        return last["jacobian"]

    start = x[free]
    if not np.isfinite(residual(full(start))[0]).all():
        raise SolveError(
            "The closures cannot be evaluated at their first values. Check the units of the "
            "training cases (mL/s, cm², dyn/cm²)."
        )
    bounds = (
        [r.low for r, f in zip(ranges, free, strict=True) if f],
        [r.high for r, f in zip(ranges, free, strict=True) if f],
    )
    bounded = bool(np.isfinite(bounds).any())
    found = least_squares(
        value,
        start,
        slope,
        bounds=bounds,
        method="trf" if bounded else "lm",
        x_scale="jac",
        max_nfev=evaluations,
        ftol=_SETTLED,
    )
    return full(found.x)
