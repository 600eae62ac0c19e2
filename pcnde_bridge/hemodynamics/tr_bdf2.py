"""Time steps of the 1D solver: TR-BDF2 and Newton's method for all cases at once.

The last axis of all arrays is the case, so that every operation runs over contiguous cases.
Imports JAX; the solver imports this module when it computes.
"""

from functools import partial
from math import sqrt
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pcnde_bridge._utils.jax_context import compiled
from pcnde_bridge.hemodynamics.discretization import GAMMA, Blood, Form, Inputs, Narrowings
from pcnde_bridge.hemodynamics.pressure_losses import effective_length, turbulent_drop, viscous_drop
from pcnde_bridge.hemodynamics.tube_laws import WallAt

# TR-BDF2 as a diagonally implicit Runge–Kutta method with an explicit first stage:
# every implicit stage weighs its own slope by GAMMA/2, and the last stage weighs
# the two before it by _WEIGHT each.
_OWN = GAMMA / 2
_WEIGHT = sqrt(2.0) / 4

_MAX_NEWTON = 20
_NEWTON_TOLERANCE = 1e-5  # of the last update; convergence is quadratic


class Fields(NamedTuple):
    """Unknowns of all cases at one time point, or their time derivatives; n cells."""

    area: Any  # S in the cells (n, case)
    flow: Any  # Q at the faces (n + 1, case)
    outlet: Any  # states of the outlet (m, case)


class State(NamedTuple):
    """All that one time step passes to the next.  A case that failed keeps its last state."""

    now: Fields
    slope: Fields
    inner: Any  # slope of the flow in the first stage of the latest step (n + 1, case)
    inlet: Any  # Q or p at the inlet (case,)
    inflow: Any  # volume that flowed in minus volume that flowed out in this cycle (case,)
    failed_at: Any  # step and point at which a case failed, or −1 (2, case)


class _Stage(NamedTuple):
    """Equation y = known + own·f(y) of an implicit stage."""

    known: Fields
    inlet: Any  # Q or p at the inlet (case,)
    outlet: Any  # states of the outlet without flow (m, case)


@partial(jax.jit, static_argnames="form")
def start(form: Form, inputs: Inputs, narrowings: Narrowings, blood: Blood) -> State:
    """Return the state at rest."""
    scheme, pressure = _Scheme(form, inputs, narrowings, blood), inputs.initial_pressure
    area = scheme.cells.area(pressure.T)
    flow = jnp.zeros((len(area) + 1, len(pressure)))
    outlet = form.outlet.initial_state(inputs.outlet, pressure)
    rest = Fields(area, flow, jnp.concatenate(outlet, axis=1).T)
    slope = jax.tree.map(jnp.zeros_like, rest)
    # Without its type, an integer would be another one after the first cycle: two compilations.
    failed_at = jnp.full((2, len(pressure)), -1, dtype=int)
    return State(rest, slope, flow, inputs.inlet[:, -1], flow[0], failed_at)


@partial(jax.jit, static_argnames="form")
def cycle(
    form: Form, inputs: Inputs, narrowings: Narrowings, blood: Blood, state: State
) -> tuple[State, tuple[Any, Any, Any], Any]:
    """Advance all cases by one cycle.

    Returns
    -------
    state : State
        The state at the end.
    records : tuple of three arrays of shape (case, time, z)
        Flow, area and pressure at the time points of the cycle.
    volume_balance : array of shape (case,)
        Change of the volume minus net inflow, relative to the volume.
    """
    numbers = inputs, narrowings, blood
    scheme, shape = _Scheme(form, *numbers), (form.n_times, -1, 2)
    scheme.fixed = _Scheme(form, *jax.lax.stop_gradient(numbers))
    driven = jnp.moveaxis(inputs.inlet, 0, -1), scheme.sources
    driven = jax.tree.map(lambda values: values.reshape(*shape, *values.shape[1:]), driven)
    steps = jnp.arange(inputs.inlet.shape[1] // 2).reshape(form.n_times, -1)

    def time_point(state: State, given: Any) -> Any:
        record = scheme.record(state)
        state, _ = jax.lax.scan(scheme.step, state, given)
        return state, record

    before = state.now.area.sum(axis=0)
    state = state._replace(inflow=jnp.zeros_like(state.inflow))
    state, records = jax.lax.scan(time_point, state, (steps, driven))
    after = state.now.area.sum(axis=0)
    balance = jnp.abs(after - before - state.inflow / blood.dz) / after
    flow, area, pressure = (jnp.moveaxis(record, 2, 0) for record in records)
    return state, (flow, area, pressure), balance


compiled_start, compiled_cycle = (compiled("form")(function) for function in (start, cycle))
"""The same functions for callers that are not compiled themselves."""


class _Scheme:
    """Discrete equations of all cases inside the compiled cycle.

    Momentum is balanced on the faces, each between two places: the inlet's end, the cells, and
    the outlet's end.  Where the inlet's flow is given, that equation replaces the first balance.
    """

    def __init__(self, form: Form, inputs: Inputs, narrowings: Narrowings, blood: Blood) -> None:
        self.form, self.blood = form, blood
        vessel = jax.tree.map(jnp.transpose, (inputs.area_undeformed, inputs.wall))

        def wall(select: Any) -> WallAt:
            undeformed, parameters = jax.tree.map(select, vessel)
            return form.wall.of(parameters).at(undeformed)

        self.points, self.boundary = wall(lambda values: values), wall(_ends)
        self.cells = wall(lambda values: 0.5 * (values[:-1] + values[1:]))
        self.undeformed = _join(self.boundary.undeformed, self.cells.undeformed)
        self.faces = _harmonic_mean(self.undeformed[:-1], self.undeformed[1:])
        # Inverse of the distance over which the momentum of a face is balanced.  The compiled step
        # multiplies by inverses: a division of arrays takes several times as long.
        inverse, ends = jnp.full((len(self.faces), 1), 1.0 / blood.dz), jnp.array([0, -1])
        self.per_width = inverse.at[ends].multiply(2.0)
        # Diffusion along the vessel is neglected on the faces at the ends.
        self.diffusion = (blood.viscosity / blood.density * inverse**2).at[ends].set(0.0)
        self.viscous, self.turbulent = self._losses(inputs.area_undeformed, narrowings)
        # Factors of a stage's own slope and, in the last stage, of the slopes before.
        self.own, self.weight = _OWN * blood.dt, _WEIGHT * blood.dt
        # Of both stages: factors of the first and the latest slope, time since the latest,
        # and half the square of that time over the time between the latest two.
        first, second = 2.0 * self.own, blood.dt - 2.0 * self.own
        self.stages = (
            jnp.array([self.own, self.weight]),
            jnp.array([0.0, self.weight]),
            jnp.array([first, second]),
            0.5 * jnp.array([first**2 / second, second**2 / first]),
        )
        self._prepare_outlet(inputs)
        self.fixed = self  # the same numbers, without derivatives

    def _losses(self, area: Any, narrowings: Narrowings) -> tuple[Any, Any]:
        """Loss of pressure per length around each face at S = S_u, per Q and per Q·|Q|.

        Wall friction N·Q/S is written as the pressure gradient −ρ·N·Q/S², so that it
        scales with the area as the loss of a stenosis does, which replaces it there.
        """
        blood, inverse = self.blood, area.T**-2.0
        # Mean of 1/S_u² around each face, if linear between the points.
        mean = 0.75 * inverse[1:-1] + (inverse[:-2] + inverse[2:]) / 8
        first, last = (0.75 * v[:1] + v[1:2] / 4 for v in (inverse, inverse[::-1]))
        mean = jnp.concatenate([first, mean, last])
        friction = 2.0 * jnp.pi * blood.viscosity * (blood.profile_exponent + 2.0)
        healthy = jnp.take_along_axis(area, narrowings.upstream, axis=1)
        throat, length = healthy * (1.0 - narrowings.blockage), narrowings.length
        if self.form.effective_length:
            length = effective_length(length, throat)
        viscous = viscous_drop(1.0, healthy, throat, length, blood.viscosity)
        viscous *= (blood.profile_exponent + 2.0) / 4.0  # of the profile, as the wall friction
        turbulent = turbulent_drop(1.0, healthy, throat, blood.density, blood.turbulent_coefficient)
        spread_viscous, spread_turbulent = (
            jnp.einsum("cs,csz->zc", drop, narrowings.spread) for drop in (viscous, turbulent)
        )
        spread_viscous += friction * mean * narrowings.friction.T
        return spread_viscous, spread_turbulent

    def _prepare_outlet(self, inputs: Inputs) -> None:
        """Solve (E − own·A)·x = E·known + own·(B·Q + f) of a stage for the outlet's states x."""
        circuit = self.form.outlet.circuit(inputs.outlet)
        storage, exchange, drive = (
            jnp.squeeze(jnp.array(values), -1)
            for values in (circuit.storage, circuit.exchange, circuit.drive)
        )
        matrix = jax.vmap(jnp.diag, -1)(storage) - jnp.moveaxis(self.own * exchange, -1, 0)
        inverse = jnp.moveaxis(jnp.linalg.inv(matrix), 0, -1)
        self.resistance = circuit.resistance[:, 0]
        self.retained = inverse * storage
        self.gain = self.own * (inverse * drive).sum(axis=1)
        steps = inputs.inlet.shape[1]
        source = jnp.array([jnp.broadcast_to(f, (len(f), steps)) for f in circuit.source])
        self.sources = self.own * jnp.einsum("ijc,jct->tic", inverse, source)

    def end_pressure(self, stage: _Stage, flow: Any) -> tuple[Any, Any]:
        """Pressure at the ends, and its derivative by the flow there."""
        resistance = self.resistance + self.gain[0]
        outlet = stage.outlet[0] + resistance * flow[-1]
        inlet = stage.inlet if self.form.pressure_inlet else self.boundary.rest[0]
        return jnp.stack([inlet, outlet]), jnp.stack([0.0 * resistance, resistance])

    def area(self, stage: _Stage, flow: Any) -> Any:
        """Area at all places, not positive where the wall collapsed."""
        rate = -jnp.diff(flow, axis=0) * (1.0 / self.blood.dz)
        area = stage.known.area + self.own * rate
        # The viscous stress at an end is that of its cell.
        viscous = _ends(rate * self.cells.damping(area))
        return _join(self.boundary.area(self.end_pressure(stage, flow)[0] - viscous), area)

    def balance(self, stage: _Stage, flow: Any) -> tuple[Any, tuple[Any, Any, Any]]:
        """Residual of the momentum balance on the faces, or of the inlet, and its derivatives.

        A flow also changes the areas of its two cells: the derivatives are by the flow on
        the face before, on the face itself, and on the face behind.
        """
        blood, per_dz = self.blood, 1.0 / self.blood.dz
        # Area, pressure p and momentum m = Q²/S of all places.  In the cells the derivatives
        # are by the flows that enter and leave; at the ends there is one flow.
        # Beyond the end of the wall law S < 0. Newton's method may pass there, not stay.
        s = jnp.abs(self.area(stage, flow))
        inverse = 1.0 / s
        center, s_c, s_e = 0.5 * (flow[:-1] + flow[1:]), s[1:-1], _ends(s)
        rate, k = -jnp.diff(flow, axis=0) * per_dz, self.own * per_dz
        damping = self.cells.damping(s_c)
        m_c, p_c = center**2 * inverse[1:-1], k * self.cells.slope(s_c) + damping * per_dz
        p_e, p_q = self.end_pressure(stage, flow)
        q_e, s_q = _ends(flow), p_q / self.boundary.slope(s_e)
        m_e = q_e**2 / s_e
        p, m = _join(p_e, self.cells.pressure(s_c) + damping * rate), _join(m_e, m_c)
        m_q = (2.0 * q_e - m_e * s_q) / s_e
        m_enter, m_leave = (_join(m_q, (center + d) * inverse[1:-1]) for d in (-k * m_c, k * m_c))
        p_enter, p_leave = (_join(p_q, d) for d in (p_c, -p_c))
        s_enter, s_leave = (_join(s_q, jnp.full_like(s_c, d)) for d in (k, -k))

        # The area on a face is the harmonic mean.
        narrowness = 0.5 * (inverse[:-1] + inverse[1:])
        on_face, widening = 1.0 / narrowness, (self.faces * narrowness) ** 2
        gradient = jnp.diff(p, axis=0) * self.per_width
        loss = (self.viscous + self.turbulent * jnp.abs(flow)) * flow * widening
        inert, diffusion = blood.convection * self.per_width, self.diffusion
        light = on_face * (1.0 / blood.density)
        change = diffusion * jnp.pad(jnp.diff(flow, 2, axis=0), ((1, 1), (0, 0)))
        change -= inert * jnp.diff(m, axis=0)
        change -= light * (gradient + loss)

        by_area = 0.5 * on_face * light * (loss - gradient)
        by_before, by_behind = by_area * inverse[:-1] ** 2, by_area * inverse[1:] ** 2
        resistance = (self.viscous + 2.0 * self.turbulent * jnp.abs(flow)) * widening
        stiff = light * self.per_width
        before = inert * m_enter[:-1] + stiff * p_enter[:-1] + by_before * s_enter[:-1]
        own = inert * (m_leave[:-1] - m_enter[1:]) + stiff * (p_leave[:-1] - p_enter[1:])
        own += by_before * s_leave[:-1] + by_behind * s_enter[1:]
        own -= light * resistance
        behind = by_behind * s_leave[1:] - inert * m_leave[1:] - stiff * p_leave[1:]
        bands = before + diffusion, own - 2.0 * diffusion, behind + diffusion
        residual = flow - stage.known.flow - self.own * change
        lower, main, upper = (-self.own * band for band in bands)
        if not self.form.pressure_inlet:
            residual = residual.at[0].set(flow[0] - stage.inlet)
            main, upper = main.at[0].set(0.0), upper.at[0].set(0.0)
        return residual, (lower, 1.0 + main, upper)

    def newton(self, stage: _Stage, carry: Any) -> Any:
        """Take a step of Newton's method; ``carry`` is flow, last update and iteration."""
        flow, _, iteration = carry
        residual, bands = self.balance(stage, flow)
        update = _tridiagonal_solve(bands, -residual)
        # A case whose update is not finite stays where it was.
        flow = jnp.where(jnp.isfinite(update).all(axis=0), flow + update, flow)
        # Relative to the case's own flow.
        scale = jnp.abs(flow).max(axis=0) + 1e-3
        return flow, jnp.abs(update) / scale, iteration + 1

    def solve(self, stage: _Stage, guesses: tuple[Any, Any]) -> tuple[Any, Any, Any]:
        """Solve a stage for the flow on all faces.

        Where Newton's method fails from one guess, it starts again from the next.  The
        derivatives are those of the root.
        Also returned: whether each case was solved, and the point where it was not.
        """
        scheme, fixed = self.fixed, jax.lax.stop_gradient(stage)

        def attempt(carry: Any) -> Any:
            flow, _, solved, number = carry
            flow = jnp.where(solved, flow, jnp.where(number == 0, *guesses))
            update = jnp.where(solved, 0.0, jnp.full_like(flow, jnp.inf))
            newton = partial(scheme.newton, fixed)
            flow, update, _ = jax.lax.while_loop(_unfinished, newton, (flow, update, 0))
            positive = (scheme.area(fixed, flow) > 0.0).all(axis=0)
            return flow, update, positive & ~_large(update), number + 1

        def unsolved(carry: Any) -> Any:
            return (carry[3] < len(guesses)) & ~carry[2].all()

        guesses = jax.lax.stop_gradient(guesses)
        start = guesses[0], guesses[0], jnp.zeros(guesses[0].shape[1], bool), 0
        root, update, good, _ = jax.lax.while_loop(unsolved, attempt, start)
        flow = jax.lax.custom_root(
            lambda flow: self.balance(stage, flow)[0],
            root,
            lambda _, found: found,
            lambda _, right: _tridiagonal_solve(scheme.balance(fixed, root)[1], right),
        )

        def place() -> Any:
            """Return the point where the wall collapsed, or where the flow changes most."""
            ratio = scheme.area(fixed, root) / scheme.undeformed
            collapsed = ~(ratio > 0.0).all(axis=0) | ~jnp.isfinite(update).all(axis=0)
            smallest = jnp.where(ratio[-1] > 0.0, ratio.argmin(axis=0), len(ratio))
            smallest = jnp.minimum(smallest, len(root) - 1)
            return jnp.where(collapsed, smallest, update.argmax(axis=0))

        nowhere = partial(jnp.full, good.shape, -1)
        return flow, good, jax.lax.cond(good.all(), nowhere, place)

    def stage(self, start: State, latest: tuple[Fields, Fields, Any], given: Any) -> Any:
        """Take an implicit stage from the start of the step and the latest stage."""
        at_start, at_before, elapsed, curved, inlet, source = given
        before, slope, earlier = latest
        known = jax.tree.map(
            lambda y, k_start, k_before: y + at_start * k_start + at_before * k_before,
            start.now,
            start.slope,
            slope,
        )
        stage = _Stage(known, inlet, (self.retained * known.outlet).sum(axis=1) + source)
        # Extrapolation from the latest two slopes.  As if the tube were rigid, its whole flow
        # follows the inlet's: a guess that holds for a sudden start, too.
        guess = before.flow + elapsed * slope.flow + curved * (slope.flow - earlier)
        if not self.form.pressure_inlet:
            guess += inlet - guess[0]
        flow, good, place = self.solve(stage, (guess, before.flow))
        area = known.area - self.own / self.blood.dz * jnp.diff(flow, axis=0)
        found, per_own = Fields(area, flow, stage.outlet + self.gain * flow[-1]), 1.0 / self.own
        latest_slope = jax.tree.map(lambda y, y_known: (y - y_known) * per_own, found, known)
        return (found, latest_slope, slope.flow), (good, place, flow[0] - flow[-1])

    def step(self, state: State, given: Any) -> tuple[State, None]:
        """Take a time step; ``given`` are its number, and inlet and outlet at its stages."""
        number, (inlet, source) = given
        latest = state.now, state.slope, state.inner
        (now, slope, inner), (good, places, net) = jax.lax.scan(
            partial(self.stage, state), latest, (*self.stages, inlet, source)
        )
        before = state.now.flow[0] - state.now.flow[-1]
        inflow = state.inflow + self.weight * (before + net[0]) + self.own * net[1]
        place = jnp.where(good[0], places[1], places[0])
        failed = state.failed_at[0] >= 0
        here = jnp.where(good.all(axis=0), -1, jnp.stack([jnp.full_like(place, number), place]))
        failed_at = jnp.where(failed, state.failed_at, here)
        reached = State(now, slope, inner, inlet[1], inflow, failed_at)
        retain = partial(jnp.where, failed_at[0] >= 0)
        kept = state._replace(failed_at=failed_at)
        return jax.lax.cond(
            (failed_at[0] >= 0).any(),
            lambda: jax.tree.map(retain, kept, reached),
            lambda: reached,
        ), None

    def record(self, state: State) -> tuple[Any, Any, Any]:
        """Return flow, area and pressure at the points (z, case)."""
        now = state.now
        outlet = now.outlet[0] + self.resistance * now.flow[-1]
        viscous = _at_points(self.cells.damping(now.area) * state.slope.area)
        elastic = _at_points(self.cells.pressure(now.area)).at[-1].set(outlet - viscous[-1])
        if self.form.pressure_inlet:
            elastic = elastic.at[0].set(state.inlet - viscous[0])
        return now.flow, self.points.area(elastic), elastic + viscous


def _large(update: Any) -> Any:
    """Return whether the flow of each case is not nearly a root; NaN counts as large."""
    return ~(update <= _NEWTON_TOLERANCE).all(axis=0)


def _unfinished(carry: Any) -> Any:
    _, update, iteration = carry
    return (iteration < _MAX_NEWTON) & jnp.any(update > _NEWTON_TOLERANCE)


def _ends(values: Any) -> Any:
    """Values at both ends, from those along the vessel."""
    return values[:: len(values) - 1]


def _join(ends: Any, cells: Any) -> Any:
    """Values at all places, from those at the ends and in the cells."""
    return jnp.concatenate([ends[:1], cells, ends[1:]])


def _harmonic_mean(a: Any, b: Any) -> Any:
    return 2.0 / (1.0 / a + 1.0 / b)


def _at_points(p: Any) -> Any:
    """Values at the points, from those in the cells."""
    first, last = (1.5 * v[:1] - 0.5 * v[1:2] for v in (p, p[::-1]))
    return jnp.concatenate([first, 0.5 * (p[:-1] + p[1:]), last])


def _tridiagonal_solve(bands: tuple[Any, Any, Any], right: Any) -> Any:
    """Solve tridiagonal systems along the first axis by Thomas's algorithm."""

    def eliminate(above: Any, row: Any) -> Any:
        lower, main, upper, value = row
        factor = 1.0 / (main - lower * above[0])
        above = upper * factor, (value - lower * above[1]) * factor
        return above, above

    def substitute(below: Any, row: Any) -> Any:
        found = row[1] - row[0] * below
        return found, found

    zero = jnp.zeros_like(right[0])
    _, rows = jax.lax.scan(eliminate, (zero, zero), (*bands, right))
    return jax.lax.scan(substitute, zero, rows, reverse=True)[1]
