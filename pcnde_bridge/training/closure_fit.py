"""Fit of each closure to the training cases: small nonlinear least-squares problems.

The engine gives values and Jacobians; the solver is SciPy's, a trust-region method for
parameters with bounds, else that of Levenberg and Marquardt.  Engines that agree find the
same parameters.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.config.settings import OutletClosure
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions, some_of
from pcnde_bridge.engines.closure_parameters import (
    CORRECTION_SCALARS,
    WALL_SHEAR_STRESS,
    ClosureParameters,
    sizes,
)
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.shared_terms import rate
from pcnde_bridge.engines.types import Fit, OnIteration, Problem
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.outlet import windkessel_response
from pcnde_bridge.training.closure_parts import HeldCases, at_times, few_times, flow_rate

_SHEAR_PENALTY = 1e-3
"""Penalty of a change of the wall shear stress's parameters, relative to the term's square."""

_SHEAR_CASES = 256
"""Largest number of cases to which the wall shear stress is fitted: it is nine numbers."""

_SIGN_CHANGES = 30
"""Largest number of fits of the wall shear stress, each with the signs of the fit before."""

_LOSS_TOLERANCE = 1e-4
"""Relative decrease of the loss below which a fit ends."""

_TOLERANCES = "", "gradient", "loss", "step", "loss and step"
"""Tolerances by the status of :func:`scipy.optimize.least_squares`."""

_SMOOTH_OUTLET = 0.01  # largest error of a resistance, relative to the pressure's variation
_FIRST_LOGIT = -4.0  # of the correction: almost off
_SHARE_QUANTILE = 0.98
_SMALLEST_STORAGE = 0.01
_CEILINGS = (0.01, 0.95)


_Bounded = tuple[float, float, float]
"""Start of a parameter's fit, and its lower and upper bound."""

_UNBOUNDED = -np.inf, np.inf
_LOSSES: dict[str, _Bounded] = {
    "friction": (1.0, 0.01, 100.0),
    "inertia": (1.0, 0.01, 100.0),
    "core": (1.0, 0.1, 10.0),
    "layer_growth": (1.3, 0.05, 20.0),
    "jet_momentum": (4 / 3, 0.5, 3.0),
    "jet_recovery": (1.2, 0.1, 10.0),
    "jet_friction": (1.2, 0.01, 100.0),
    "jet_spread": (0.01, 1e-4, 10.0),
    "jet_viscous_spread": (3.5, 1e-3, 100.0),
    "jet_lag": (0.7, 1e-3, 5.0),
}
_MEMBRANE: dict[str, _Bounded] = {
    "poisson": (0.45, 0.0, 0.5),
    "shear": (0.2, 1e-4, 10.0),
    "support": (1.0, 1e-6, 1e4),
}
_TUBE_LAW: dict[str, _Bounded] = {"exponent": (0.0, -10.0, 10.0)}


def fit_outlet(cases: Cases, config: ClosureConfig) -> Array:
    """Find R₁, R₂, C and p_d from flow and pressure at the outlet.

    A resistance is found by linear regression.  A Windkessel is fitted starting from it.
    """
    flow, pressure = (cases.at_point(name, -1) for name in ("flow", "pressure"))
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
    scale = float(np.std(pressure)) or 1.0

    def numbers(x: Array) -> Array:
        share, time_constant, offset, factor = x
        r2 = (1 - share) * factor * total
        return np.array([share * factor * total, r2, time_constant / r2, offset * scale])

    def residual(x: Array) -> Array:
        impedance, distal = windkessel_response(numbers(x), n_times, period)
        predicted = np.fft.irfft(harmonics * impedance + distal, n=n_times, axis=1)
        return ((predicted - pressure) / scale).ravel()

    # A regression over all time points does not give R₁ + R₂; a given number stays (almost).
    tiny = 1e-9
    offset = None if given.distal_pressure is None else given.distal_pressure / scale
    offsets = (-np.inf, np.inf) if offset is None else (offset - tiny, offset + tiny)
    factors = (0.1, 10.0) if given.resistance is None else (1 - tiny, 1 + tiny)
    low, high = np.array([(1e-3, 1.0), (0.0, 100 * period), offsets, factors]).T
    start = [0.2, 0.2 * period, offset or 0.0, 1.0]
    return numbers(least_squares(residual, start, bounds=(low, high)).x)


def fit_losses(
    held: HeldCases,
    config: ClosureConfig,
    on_iteration: OnIteration | None = None,
    *,
    again: tuple[Array, Positions, int] | None = None,
) -> Fit:
    """Fit the losses to p − p(L) and to the drop across the stenosis, with the reference flow.

    Parameters
    ----------
    held, config, on_iteration
        See :func:`fit_correction`.
    again : tuple, optional
        For another fit: losses to start from, cases to leave out, largest number of evaluations.
        The shapes stay those of all cases, which are compiled once.
    """
    starts = np.array(list(_LOSSES.values()))
    left_out: Positions = np.empty(0, int)
    evaluations = config.correction.evaluations
    if again is not None:
        starts[:, 0], left_out, evaluations = again
    weight = np.ones(held.square.size)
    weight[left_out] = 0
    given = [getattr(config.losses, name) for name in _LOSSES]
    problem = held.problem(weight / np.sqrt(weight @ held.square))
    return _solve(problem, starts, given, evaluations, on_iteration)


def fit_wall(
    held: HeldCases, cases: Cases, config: ClosureConfig, on_iteration: OnIteration | None = None
) -> Fit:
    """Fit the wall parameters to S, with the reference pressure."""
    # Stiffness and zero pressure start from a quarter of the length, where the vessel is wide.
    point, times = cases.n_points // 4, few_times(len(cases), cases.n_times)
    pressure, area = (at_times(cases.at_point(a, point), times) for a in ("pressure", "area"))
    radius = np.sqrt(cases.area_undeformed[:, None, point] / np.pi)
    strain = np.sqrt(area / np.pi) / radius - 1
    slope, offset = np.polyfit(strain.ravel(), pressure.ravel(), 1)
    stiffness = max(float(slope), float(np.ptp(pressure)) * 1e-3)
    zero = float(offset) if abs(offset) > 0.2 * float(np.abs(pressure).max()) else 0.0
    membrane = config.wall.law == "membrane"
    if membrane:
        stiffness *= float(radius.mean())
    parameters = {
        "stiffness": (stiffness, stiffness * 1e-3, stiffness * 1e3),
        **(_MEMBRANE if membrane else _TUBE_LAW),
        "zero_pressure": (zero, *_UNBOUNDED),
    }
    given = [getattr(config.wall, name) for name in parameters]
    evaluations = config.correction.evaluations
    problem = held.problem(np.full(len(cases), held.square.sum() ** -0.5))
    return _solve(problem, list(parameters.values()), given, evaluations, on_iteration)


def fit_wall_shear_stress(
    closures: Closures,
    others: ClosureParameters,
    cases: Cases,
    config: ClosureConfig,
    left_out: Positions,
) -> Array:
    """Fit the wall shear stress, with the reference flow, or return the start if there is none.

    The data may hold the magnitude, so the sign of each value is that of the fit before.
    The cases ``left_out`` are ignored.
    """
    start, rows = WALL_SHEAR_STRESS, some_of(np.arange(len(cases)), _SHEAR_CASES)
    part = cases[rows]
    if part.wall_shear_stress is None:
        return start
    times, fields = few_times(len(part), part.n_times), (part.flow, flow_rate(part))
    flow, slope, stress = (at_times(a, times) for a in (*fields, part.wall_shear_stress))
    others = others.replace(wall_shear_stress=start)
    problem = closures.wall_shear_stress(
        others, flow, slope, part.area_undeformed, part.grid, config
    )
    parts = *problem(start), np.abs(stress)
    used = ~np.isin(rows, left_out)
    return start + _linear_fit(*(array[used] for array in parts))


def _linear_fit(value: Array, slope: Array, target: Array) -> Array:
    """Return the change of the parameters for which |value + slope·change| is the target."""
    value, slope, target = value.ravel(), slope.reshape(-1, slope.shape[-1]), target.ravel()
    gram = slope.T @ slope
    penalized = gram + _SHEAR_PENALTY * np.diag(gram.diagonal())
    change: Array = np.zeros(slope.shape[1])
    sign = np.zeros_like(value)
    for _ in range(_SIGN_CHANGES):
        previous, sign = sign, np.sign(value + slope @ change)
        if np.array_equal(sign, previous):
            break
        # The penalty draws towards the start; a term that is zero in all cases stays there.
        solved = np.linalg.lstsq(penalized, slope.T @ (sign * target - value), rcond=None)
        change = np.asarray(solved[0], dtype=float)
    return change


def first_correction(cases: Cases, config: ClosureConfig, rng: np.random.Generator) -> Array:
    """Return the correction before its fit: κ, ceiling and scales from the cases, random weights.

    The ceiling is the 98 % quantile of the share of the storage that the flow does not show,
    1 − (Q_in − Q(L))/(κ ∂V/∂t), where the storage is more than half its largest; κ is the
    median of (Q_in − Q(L))/(∂V/∂t) where the storage is more than a tenth of its largest.
    """
    volume = np.concatenate([np.trapezoid(part.area, part.z) for _, part in cases.batches()])
    stored = rate(volume, cases.period)
    outflow = cases.at_point("flow", -1)
    lost = cases.inflow - outflow
    clear = np.abs(stored) > 0.1 * np.abs(stored).max()
    seen = float(np.median(lost[clear] / stored[clear]))
    kappa = config.correction.storage or max(seen, _SMALLEST_STORAGE)
    strong = stored > 0.5 * stored.max()
    ceiling = np.quantile(1 - lost[strong] / (kappa * stored[strong]), _SHARE_QUANTILE)
    slope = rate(cases.at_point("pressure", -1), cases.period)
    scalars = [
        kappa,
        float(np.clip(ceiling, *_CEILINGS)),
        float(np.std(slope)) or 1.0,
        float(np.abs(outflow).mean()) or 1.0,
    ]
    weights = rng.normal(size=sizes(config)["correction"] - CORRECTION_SCALARS) * 0.5
    # The last bias switches the correction off where the data do not need it.
    weights[-1] = _FIRST_LOGIT
    return np.concatenate([scalars, weights])


def fit_correction(
    held: HeldCases,
    others: ClosureParameters,
    config: ClosureConfig,
    first: Array,
    weight: Array,
    evaluations: int,
    on_iteration: OnIteration | None = None,
) -> Fit:
    """Fit κ and the network to the flow, with all closures coupled.

    Parameters
    ----------
    held : HeldCases
        Result of :func:`~pcnde_bridge.training.closure_parts.hold_cases`.
    others : ClosureParameters
        Outlet, losses and wall.
    config : ClosureConfig
        Settings.
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
    # The weights decay towards a correction that is off.
    n_weights, decay = first.size - CORRECTION_SCALARS, np.sqrt(settings.weight_decay)
    prior = decay * np.eye(n_weights, first.size, CORRECTION_SCALARS)
    center = np.zeros(n_weights)
    center[-1] = _FIRST_LOGIT

    def penalty(x: Array) -> tuple[Array, Array]:
        return decay * (x[CORRECTION_SCALARS:] - center), prior

    starts = [(start, *_UNBOUNDED) for start in first]
    given = [settings.storage, *first[1:CORRECTION_SCALARS], *[None] * n_weights]
    scaled = 100 * weight / np.sqrt(weight @ held.square)
    problem = held.problem(scaled, others, penalty)
    return _solve(problem, starts, given, evaluations, on_iteration)


def _solve(
    residual: Problem,
    starts: Sequence[_Bounded] | Array,
    given: Sequence[float | None],
    evaluations: int,
    on_iteration: OnIteration | None,
) -> Fit:
    """Minimize ½|residual|² over the parameters that are not given."""
    from scipy.optimize import least_squares

    known = np.array(given, dtype=float)
    free = np.isnan(known)
    if not free.any():
        return Fit(known, np.empty(0), True, "all parameters are given")
    first, low, high = np.array(starts)[free].T
    losses: list[float] = []

    def whole(part: Array) -> Array:
        result = known.copy()
        result[free] = part
        return result

    @lru_cache(maxsize=1)  # SciPy asks for the residual, then for the Jacobian at the same point
    def evaluate(part: bytes) -> tuple[Array, Array]:
        value, jacobian = residual(whole(np.frombuffer(part)))
        return value, jacobian[:, free]

    def value(part: Array) -> Array:
        error, _ = evaluate(part.tobytes())
        if not np.isfinite(error).all():
            return np.full_like(error, 1e6)
        loss = float(error @ error)
        if not losses or loss < losses[-1]:
            losses.append(loss)
            if on_iteration is not None:
                on_iteration(len(losses), loss)
        return error

    if not np.isfinite(evaluate(first.tobytes())[0]).all():
        raise SolveError(
            "The closures cannot be evaluated at their first values. Check the units of the "
            "training cases (mL/s, cm², dyn/cm²)."
        )
    found = least_squares(
        value,
        first,
        lambda part: evaluate(part.tobytes())[1],
        bounds=(low, high),
        method="trf" if np.isfinite([low, high]).any() else "lm",
        x_scale="jac",
        max_nfev=evaluations,
        ftol=_LOSS_TOLERANCE,
    )
    met = _TOLERANCES[found.status]
    outcome = f"{met} tolerance" if met else "all evaluations done"
    return Fit(whole(found.x), np.array(losses), bool(met), outcome)
