"""Preset ``fast``: every stage fitted on all cases at once, exactly where it is linear.

The equations, the parameters and their layout are the paper's, so that the result is a
model like any other.  Only the way to the minimum differs:

- the flow network by L-BFGS without restarts, in whitened weights: first along the data's flow,
  its last layer by least squares (:mod:`pcnde_bridge.training.collocation`),
  from a few starts; from the
  best of these through the equation; weaker waves' squares weigh more (:func:`wave_weight`);
- (â, b̂) and (a, b) by least squares, point by point;
- the pressure network's last layer by least squares inside the L-BFGS fit of the
  layers before it (variable projection, Golub and Pereyra 1973);
- a₁, a₂ and b₁(t) by least squares inside that of b₂(t).

The engine computes the flow and runs L-BFGS; everything else is small enough for numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig, Physics
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.splits import Positions, training_and_validation
from pcnde_bridge.engines.parameters import initial_parameters, layer_sizes
from pcnde_bridge.engines.protocol import Engine, Stage
from pcnde_bridge.engines.staged import initial_area
from pcnde_bridge.engines.types import (
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    OnIteration,
    SpatialPressureInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.pressure_losses import pressure_drop
from pcnde_bridge.training.algorithm import StageFit, Unit
from pcnde_bridge.training.collocation import KnownFlow
from pcnde_bridge.training.lbfgs import Whitening, minimise
from pcnde_bridge.training.least_squares import solve_normal, solve_per_point
from pcnde_bridge.training.variable_projection import HiddenLayers

_SAMPLES = 4000  # about so many of the flow network's inputs give their spread
_AGREEMENT = 0.5  # of stored volume and flow, squared correlation, for one to tell of the other
_OF_MEDIAN, _OF_LARGEST = 0.3, 0.1  # waves that are weaker than these parts weigh no more
_RIDGE = 1e-9  # on the pressure network's last layer, p_ref²


def divide(cases: Cases, config: PCNDEConfig, seed: int) -> tuple[Positions, ...]:
    """Training part and, unless none is spared, validation part."""
    return training_and_validation(cases, config.full_batch.validation, seed)


def plan(config: PCNDEConfig, n_batches: int) -> list[Unit]:
    """All units of a run, in order: rounds of flow and area, then the pressure."""
    rounds = range(1, config.full_batch.rounds + 1)
    units = [Unit(work, r, 1) for r in rounds for work in ("flow", "coupling")]
    # As the flow: with the validation part kept apart, then on all cases.
    units += [Unit("temporal_pressure", r, 1) for r in range(1, n_batches + 1)]
    return [*units, Unit("spatial_pressure", 1, 1)]


def count_iterations(config: PCNDEConfig, n_batches: int) -> int:
    """Count the iterations of all stages, if no fit ends early."""
    fast = config.full_batch
    fits = fast.starts if config.flow.terms else 1  # of the equation in the first round
    flow_iterations = (fast.starts + fast.rounds - 1) * fast.collocation_iterations
    flow_iterations += fits * fast.iterations + (fast.rounds - 1) * fast.later_iterations
    return flow_iterations + 2 * fast.rounds + (n_batches + 1) * fast.pressure_iterations


def fit(wanted: StageFit) -> Array:
    """Fit a stage: with the validation part kept apart in the first round, then on all cases."""
    stage, unit, state, inputs, target, cases, engine, config, record = wanted
    vector, first, grid = getattr(state.parameters, stage), unit.epoch == 1, cases.grid
    selection = state.batches if first else (np.arange(len(cases)),)
    if stage == "flow":
        settings, starts = config.full_batch, [vector]
        if first:
            size = cases.n_times, cases.n_points
            others = range(1, settings.starts)
            starts += [initial_parameters(config, *size, state.seed, k).flow for k in others]
        return fit_flow(
            starts,
            cases,
            inputs.area,
            selection,
            engine,
            config,
            settings.iterations if first else settings.later_iterations,
            lambda number: record(stage, unit.epoch, number),
        )
    on_iteration = record(stage, unit.epoch, 1)
    if stage == "temporal_pressure":
        return fit_temporal_pressure(
            vector, inputs, target, selection, engine, config, on_iteration
        )
    if stage == "spatial_pressure":
        return fit_spatial_pressure(vector, inputs, target, engine, grid, config, on_iteration)
    vector, loss = fit_area_stage(getattr(engine, stage), inputs, target, grid, config)
    on_iteration(1, loss)
    return vector


def balanced_flow(cases: Cases, fitted: Positions, config: PCNDEConfig) -> Array:
    """Return the data's flow with a mean over the cycle that agrees with the data's area.

    The first area stage integrates −â·∂Q/∂z from S_u over n whole cycles of the period T, and
    where it ends anchors the periodic area.  Of Q only the mean over a cycle is left then:

        S(0) = S_u − n·T·(â·∂Q̄/∂z − b̂).

    In the data Q̄ is the same all along the vessel but for errors of averaging, 0.1 % of it
    in the published cases, which would decide the area's largest error.  So Q̄ is replaced by
    what this equation asks for, with b̂ from the mean over the cases and â from what their
    volumes V store, Q(L) − Q_in = −(1/â)·∂V/∂t.

    Parameters
    ----------
    cases : Cases
        All training cases.
    fitted : array of int
        Those that give â and b̂.
    config : PCNDEConfig
        Number of cycles and the anchor.  With the anchor ``undeformed``, or where flow and
        volume do not agree, the flow is the data's.

    Returns
    -------
    array of shape (case, time, z)
        Q, mL/s; at the inlet the data's.
    """
    from scipy.integrate import cumulative_trapezoid, trapezoid

    cycles = config.intermediate_area.cycles
    n = {"last_time_point": cycles, "last_cycle": cycles - 1, "undeformed": 0}[
        config.fourier_area.anchor
    ]
    flow, area, z = cases.flow, cases.area, cases.z
    volume = trapezoid(area[fitted], z, axis=2)
    stored = (np.roll(volume, -1, axis=1) - np.roll(volume, 1, axis=1)) * (
        cases.n_times / (2 * cases.period)
    )
    gained = flow[fitted, :, -1] - flow[fitted, :, 0]
    gained = gained - gained.mean(axis=1, keepdims=True)
    shared, square = -float(np.sum(stored * gained)), float(np.sum(gained**2))
    agrees = shared > 0 and shared**2 >= _AGREEMENT * square * float(np.sum(stored**2))
    if config.full_batch.mean_flow == "data" or n == 0 or not agrees:
        return flow
    a_hat = shared / square
    change = area[:, 0] - cases.area_undeformed
    slope = -(change - change[fitted].mean(axis=0)) / (n * cases.period * a_hat)
    mean = cumulative_trapezoid(slope, z, axis=1, initial=0)
    own = flow.mean(axis=1) - flow[:, :, 0].mean(axis=1)[:, None]
    balanced: Array = flow + (mean - own)[:, None]
    return balanced


def wave_weight(inflow: Array, fitted: Positions, power: float) -> Array:
    """Return the weight of each case's squares: weaker waves have smaller errors.

    What the model leaves grows with the wave, so that equal weights fit the remainders of the
    strongest waves at the cost of all others (weighted least squares).

    Parameters
    ----------
    inflow : array of shape (case, time)
        Q at the inlet, mL/s.
    fitted : array of int
        The cases whose weights have the mean 1.
    power : float
        The weight goes as the inflow's range over time to the power −``power``; a range
        below 0.3 of the fitted cases' median, 0.1 of their largest or their weakest counts
        as that.

    Returns
    -------
    array of shape (case,)
        Ones if no fitted inflow varies.
    """
    wave = np.ptp(inflow, axis=1)
    seen = wave[fitted]
    floor = max(_OF_MEDIAN * np.median(seen), _OF_LARGEST * seen.max(), seen.min())
    if floor == 0:
        return np.ones(len(inflow))
    weight = (np.maximum(wave, floor) / floor) ** -power  # the largest fitted one is 1
    result: Array = weight / weight[fitted].mean()
    return result


def fit_flow(
    starts: Sequence[Array],
    cases: Cases,
    area: Array,
    selection: tuple[Positions, ...],
    engine: Engine,
    config: PCNDEConfig,
    iterations: int,
    record: Callable[[int], OnIteration | None] = lambda _: None,
) -> Array:
    """Fit the flow network from some starts, and return the best.

    Each start is fitted along the data's flow
    (:mod:`pcnde_bridge.training.collocation`); from the best
    of these the equation itself is.  With physics terms, whose form only the engine knows, the
    equation is fitted from each start, with the iterations of both.

    Parameters
    ----------
    starts : sequence of arrays of shape (size,)
        Its parameters before, one or more.
    cases : Cases
        All training cases.
    area : array of shape (case, time, z)
        S that the network sees, cm².
    selection : tuple of arrays of int
        Cases to fit, and, if given, cases whose error ends the fit; the best has the
        least error on the last of these.
    engine, config
        Who computes the flow, and the settings.
    iterations : int
        At most so many of the equation's fit.
    record : callable
        Given the number of a fit, from 1 on, returns what is called with the number
        and loss of each of its iterations.

    Returns
    -------
    array of shape (size,)
        Its parameters.
    """
    settings, grid = config.full_batch, cases.grid
    fitted = selection[0]
    seen = np.concatenate(
        [np.broadcast_to(cases.inflow[:, :, None], area.shape)[fitted], area[fitted]], axis=1
    )
    samples = np.moveaxis(seen, 1, 2).reshape(-1, 2 * cases.n_times)
    whitening = Whitening(
        samples[:: max(1, len(samples) // _SAMPLES)], config.flow.hidden[0], settings.whitening
    )
    weight = wave_weight(cases.inflow, fitted, settings.amplitude_exponent)
    counted = np.zeros(len(cases))
    counted[fitted] = weight[fitted]
    inputs = FlowInputs(cases.inflow, area)
    target = balanced_flow(cases, fitted, config)
    evaluate = engine.flow.objective(inputs, target, counted, grid, config)

    def objective(coordinates: Array) -> tuple[float, Array]:
        loss, gradient = evaluate(whitening.parameters(coordinates))
        return loss, whitening.gradient(gradient)

    def validation_error(coordinates: Array) -> float:
        flow = engine.flow.solve(whitening.parameters(coordinates), inputs, grid, config)
        held = selection[1]
        square = np.mean((flow[held] - target[held]) ** 2, axis=(1, 2))
        return float(np.mean(weight[held] * square))

    unit = float(np.mean(target[fitted] ** 2))
    if config.flow.loss == "sum":
        unit *= target[fitted].size
    validate = validation_error if len(selection) > 1 else None

    def best(vectors: Sequence[Array]) -> Array:
        """Return the one of the least error of those with which the equation does not diverge."""
        if len(vectors) == 1:
            return vectors[0]

        def error(vector: Array) -> float:
            coordinates = whitening.coordinates(vector)
            try:
                found = objective(coordinates)[0] if validate is None else validate(coordinates)
            except SolveError:
                return np.inf
            return np.inf if np.isnan(found) else found

        return min(vectors, key=error)

    last = 0
    if config.flow.terms:
        iterations += settings.collocation_iterations
    else:
        known = KnownFlow(target, area, weight, grid.z, selection, whitening, config)
        last = len(starts)
        ends = [known.fit(vector, record(i), engine.lbfgs) for i, vector in enumerate(starts, 1)]
        # Should the equation diverge with all that they give, it does not with the first start.
        starts = [best([*ends, starts[0]])]
    ends = [
        whitening.parameters(
            minimise(
                objective,
                whitening.coordinates(vector),
                settings,
                iterations,
                unit,
                validate,
                record(last + number),
                lbfgs=engine.lbfgs,
            )
        )
        for number, vector in enumerate(starts, 1)
    ]
    return best(ends)


def fit_area_stage(
    stage: Stage[Any], inputs: Any, target: Array, grid: Grid, config: PCNDEConfig
) -> tuple[Array, float]:
    """Return a, b of S = known + a(z)·f + b(z)·g, and the least loss on the last cycle.

    Known, f and g come from the stage itself; the arguments are those of its ``fit``.
    """
    n_times, n_points = target.shape[1:]

    def solve(a: float, b: float) -> Array:
        vector = np.repeat([a, b], n_points)
        return stage.solve(vector, inputs, grid, config)[:, -n_times:]

    known = solve(0.0, 0.0)
    columns = [solve(1.0, 0.0) - known, solve(0.0, 1.0) - known]
    unknowns, loss = solve_per_point(columns, target - known)
    return unknowns.ravel(), loss


def fit_area(flow: Array, cases: Cases, engine: Engine, config: PCNDEConfig) -> tuple[Array, Array]:
    """Fit both area stages on a flow (case, time, z): return (â, b̂) and (a, b)."""
    grid = cases.grid
    first = IntermediateAreaInputs(flow, cases.area_undeformed)
    intermediate, _ = fit_area_stage(engine.intermediate_area, first, cases.area, grid, config)
    start = engine.intermediate_area.solve(intermediate, first, grid, config)
    second = FourierAreaInputs(flow, initial_area(start, cases.n_times, config))
    fourier, _ = fit_area_stage(engine.fourier_area, second, cases.area, grid, config)
    return intermediate, fourier


def fit_temporal_pressure(
    vector: Array,
    inputs: TemporalPressureInputs,
    target: Array,
    selection: tuple[Positions, ...],
    engine: Engine,
    config: PCNDEConfig,
    on_iteration: OnIteration | None = None,
) -> Array:
    """Fit the pressure network, its last layer by least squares.

    With the last hidden layer h and the scale s = E·h_w/(r₀·p_ref) of a case,
    p̂* − 1 = s·(W·h + c).  For given hidden layers W and c are the minimum of the loss,
    so its gradient by the hidden layers is the one with W and c held fixed.

    Parameters
    ----------
    vector : array of shape (size,)
        The network's parameters before.
    inputs : TemporalPressureInputs
        Of all training cases.
    target : array of shape (case, time, z)
        p/p_ref.
    selection : tuple of arrays of int
        Cases to fit, and, if given, cases whose error ends the fit.
    engine, config
        Who runs L-BFGS, and the settings.
    on_iteration : callable, optional
        Called with the number and loss of each iteration.

    Returns
    -------
    array of shape (size,)
        The network's parameters.
    """
    stage, settings = config.temporal_pressure, config.full_batch
    n_points = target.shape[2]
    widths = layer_sizes("temporal_pressure", config, 0, n_points)
    last = (widths[-2] + 1) * n_points  # numbers in the last layer
    scale = _stiffness(inputs.area_undeformed, config.physics)
    seen = _network_inputs(inputs, config)

    def part(positions: Positions) -> tuple[Array, Array, Array]:
        u = seen[positions].reshape(-1, seen.shape[2])
        s = np.repeat(scale[positions], target.shape[1])[:, None]
        return u, s, (target[positions] - 1).reshape(-1, n_points)

    u, s, y = part(selection[0])
    whitening = Whitening(u, widths[1], settings.whitening)
    xi = whitening.inputs(u)
    hidden = HiddenLayers((xi.shape[1], *widths[1:-1]), stage.activation)
    size, square = y.size, float(np.sum(y**2))
    y_scaled = s * y

    def last_layer(values: Array) -> tuple[Array, float]:
        """W and c as one matrix (hidden + 1, z), and the least loss."""
        design = np.column_stack([values, np.ones(len(values))])
        normal = (s**2 * design).T @ design
        normal += np.diag([_RIDGE * size] * values.shape[1] + [0.0])
        right = np.einsum("nk,nz->kz", design, y_scaled)  # too thin for threads to gain
        layer = solve_normal(normal, right.T).T
        return layer, (square + float(np.sum(layer * (normal @ layer - 2 * right)))) / size

    def objective(coordinates: Array) -> tuple[float, Array]:
        passed = hidden(coordinates, xi)
        layer, loss = last_layer(passed.last)
        weights, bias = layer[:-1], layer[-1]
        # s·(s·(W·h + c) − y)·Wᵀ without the residual at every point.
        fit = passed.last @ (weights @ weights.T) + bias @ weights.T
        back = (2 / size) * (s**2 * fit - np.einsum("nz,kz->nk", y_scaled, weights))
        return loss, hidden.gradient(passed, back)

    if len(selection) > 1:
        held_u, held_s, held_y = part(selection[1])
        held_xi = whitening.inputs(held_u)

    def validation_error(coordinates: Array) -> float:
        layer, _ = last_layer(hidden(coordinates, xi).last)
        values = hidden(coordinates, held_xi).last
        return float(np.mean((held_s * (values @ layer[:-1] + layer[-1]) - held_y) ** 2))

    fitted = minimise(
        objective,
        whitening.coordinates(vector[:-last]),
        settings.replace(weight_decay=settings.pressure_weight_decay),
        settings.pressure_iterations,
        float(np.mean(target**2)),
        validation_error if len(selection) > 1 else None,
        on_iteration,
        lbfgs=engine.lbfgs,
    )
    layer, _ = last_layer(hidden(fitted, xi).last)
    return np.concatenate([whitening.parameters(fitted), layer.ravel()])


def _stiffness(area_undeformed: Array, physics: Physics) -> Array:
    """E·h/(r₀·p_ref) of every case."""
    radius = np.sqrt(area_undeformed[:, 0] / np.pi)
    result: Array = physics.young_modulus * physics.wall_thickness / radius
    return result / physics.reference_pressure


def _drop(flow: Array, area_undeformed: Array, coefficient: float, physics: Physics) -> Array:
    """Δp of Seeley and Young, dyn/cm², from flow (case, time, …)."""
    shape = (-1,) + (1,) * (flow.ndim - 1)
    drop: Array = pressure_drop(
        flow,
        area_undeformed[:, 0].reshape(shape),
        area_undeformed.min(axis=1).reshape(shape),
        physics.stenosis_length,
        density=physics.density,
        viscosity=physics.viscosity,
        turbulent_coefficient=coefficient,
    )
    return drop


def _network_inputs(inputs: TemporalPressureInputs, config: PCNDEConfig) -> Array:
    """S, S − S_u, Δp and Q at all points, (case, time, 4·z)."""
    physics = config.physics
    drop = _drop(inputs.flow, inputs.area_undeformed, physics.turbulent_coefficient, physics)
    if config.temporal_pressure.pressure_drop_input == "normalized":
        drop = drop / physics.reference_pressure
    change = inputs.area - inputs.area_undeformed[:, None]
    return np.concatenate([inputs.area, change, drop, inputs.flow], axis=2)


def fit_spatial_pressure(
    vector: Array,
    inputs: SpatialPressureInputs,
    target: Array,
    engine: Engine,
    grid: Grid,
    config: PCNDEConfig,
    on_iteration: OnIteration | None = None,
) -> Array:
    """Fit a₁, a₂, b₁(t) and b₂(t), all but the last by least squares.

    With σ(t, z) the step that b₂ shapes, p* = p̂* + a₁ − (Δp₀ + a₂·Δp₁ + b₁)·σ.

    Parameters
    ----------
    vector : array of shape (2 + 2·time,)
        a₁, a₂, b₁, b₂ before.
    inputs : SpatialPressureInputs
        Of the cases to fit.
    target : array of shape (case, time, z)
        p/p_ref.
    engine, grid, config
        Who runs L-BFGS, points, and settings.
    on_iteration : callable, optional
        Called with the number and loss of each iteration.

    Returns
    -------
    array of shape (2 + 2·time,)
        a₁, a₂, b₁, b₂.
    """
    physics, settings, z = config.physics, config.full_batch, grid.z
    n_cases, n_times, _ = target.shape
    position = physics.stenosis_position
    at_stenosis = np.array(
        [[np.interp(position, z, instant) for instant in case] for case in inputs.flow]
    )
    coefficient = physics.turbulent_coefficient
    drop = _drop(at_stenosis, inputs.area_undeformed, coefficient, physics)
    more = _drop(at_stenosis, inputs.area_undeformed, coefficient + 1, physics) - drop
    drop, more = drop / physics.reference_pressure, more / physics.reference_pressure
    wanted = target - inputs.temporal.mean(axis=2, keepdims=True)
    start, third = z[0], (z[-1] - z[0]) / 3
    inside = 10 * (np.clip(z, start + third, start + 2 * third) - position)
    if config.spatial_pressure.form == "printed":
        height = np.where(z <= start + third, 0.0, 1.0)
    else:
        height = np.full(z.size, 0.5)

    # Sums over the cases are enough: the step does not know them.
    sums = {
        "wanted": wanted.sum(axis=0),
        "more·wanted": np.einsum("nt,ntz->tz", more, wanted),
        "drop·wanted": np.einsum("nt,ntz->tz", drop, wanted),
        "wanted²": float(np.sum(wanted**2)),
    }
    one, by_more, by_drop = float(n_cases), more.sum(axis=0), drop.sum(axis=0)
    more_more, more_drop = (more * more).sum(axis=0), (more * drop).sum(axis=0)
    drop_drop = (drop * drop).sum(axis=0)

    def linear(step: Array) -> tuple[Array, float]:
        """Return the best (a₁, a₂, b₁) for a step (time, z), and their sum of squares."""
        total, square = step.sum(axis=1), (step**2).sum(axis=1)
        size = 2 + n_times
        normal, right = np.zeros((size, size)), np.zeros(size)
        normal[0, 0] = one * n_times * z.size
        normal[0, 1] = normal[1, 0] = -np.sum(by_more * total)
        normal[1, 1] = np.sum(more_more * square)
        normal[0, 2:] = normal[2:, 0] = -one * total
        normal[1, 2:] = normal[2:, 1] = by_more * square
        normal[range(2, size), range(2, size)] = one * square
        right[0] = sums["wanted"].sum() + np.sum(by_drop * total)
        right[1] = -np.sum(sums["more·wanted"] * step) - np.sum(more_drop * square)
        right[2:] = -np.sum(sums["wanted"] * step, axis=1) - by_drop * square
        known = (
            sums["wanted²"] + 2 * np.sum(sums["drop·wanted"] * step) + np.sum(drop_drop * square)
        )
        unknowns = solve_normal(normal, right)
        return unknowns, float(known - 2 * right @ unknowns + unknowns @ normal @ unknowns)

    def objective(b2: Array) -> tuple[float, Array]:
        tanh = np.tanh(b2[:, None] * inside)
        step, slope = height * tanh, height * inside * (1 - tanh**2)
        unknowns, squares = linear(step)
        a1, a2, b1 = unknowns[0], unknowns[1], unknowns[2:]
        # e = wanted − a₁ + (Δp₀ + a₂Δp₁ + b₁)σ, and Σ_n e·(Δp₀ + a₂Δp₁ + b₁):
        amount = by_drop + a2 * by_more + one * b1
        amount_squared = (
            drop_drop
            + a2**2 * more_more
            + one * b1**2
            + 2 * (a2 * more_drop + b1 * by_drop + a2 * b1 * by_more)
        )
        product = sums["drop·wanted"] + a2 * sums["more·wanted"] + b1[:, None] * sums["wanted"]
        product = product - a1 * amount[:, None] + amount_squared[:, None] * step
        return squares / target.size, 2 * np.sum(product * slope, axis=1) / target.size

    b2 = minimise(
        objective,
        vector[2 + n_times :],
        settings.replace(weight_decay=0.0),
        settings.pressure_iterations,
        float(np.mean(target**2)),
        on_iteration=on_iteration,
        lbfgs=engine.lbfgs,
    )
    unknowns, _ = linear(height * np.tanh(b2[:, None] * inside))
    return np.concatenate([unknowns, b2])
