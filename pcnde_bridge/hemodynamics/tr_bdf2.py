"""Time steps of the 1D solver: TR-BDF2 and Newton's method for all cases at once.

Imports JAX; the solver imports this module when it computes.
"""

from __future__ import annotations

from functools import partial
from math import sqrt
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax.linalg import tridiagonal_solve

from pcnde_bridge._typing import Array
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.discretization import GAMMA, Problem, Tube, case_name
from pcnde_bridge.hemodynamics.tube_laws import Wall

# TR-BDF2 as a diagonally implicit Runge–Kutta method with an explicit first stage:
# every implicit stage weighs its own slope by GAMMA/2, and the last stage weighs
# the two before it by _WEIGHT each.
_OWN = GAMMA / 2
_WEIGHT = sqrt(2.0) / 4

_MAX_NEWTON = 20
_NEWTON_TOLERANCE = 1e-6  # of the last update; convergence is quadratic


class _Fields(NamedTuple):
    """Unknowns of all cases at one time point, or their time derivatives; n cells."""

    area: Any  # S in the cells (case, n)
    flow: Any  # Q at the faces (case, n + 1); the first is the inlet
    capacitor: Any  # p_c of the Windkessel (case,)


class _State(NamedTuple):
    """All that one time step passes to the next."""

    now: _Fields
    slope: _Fields
    inflow: Any  # volume that flowed in minus volume that flowed out in this cycle (case,)
    failed_at: Any  # step and point at which a case failed, or −1 (case, 2)


class _Stage(NamedTuple):
    """Equation y = known + own·f(y) of an implicit stage."""

    known: _Fields
    inflow: Any  # Q at the inlet (case,)


def run(wall: Wall, problem: Problem, cycles: int) -> tuple[list[Array], list[Array] | None, Array]:
    """Compute all cycles from rest.

    Returns
    -------
    last, previous : list of three arrays of shape (case, time, z), or None
        Flow, area and pressure of the last cycle and of the one before it, if any.
    volume_balance : array of shape (case,)
        Error of the volume balance of the last cycle, relative to the volume.

    Raises
    ------
    SolveError
        If a case diverges.
    """
    n_cases, n_faces = problem.area_undeformed.shape
    cells, dz = problem.tube.cells, problem.tube.dz
    rest = _Fields(
        area=np.asarray(wall.area(problem.initial_pressure, cells)),
        flow=np.zeros((n_cases, n_faces)),
        capacitor=np.full(n_cases, problem.initial_pressure),
    )
    slope = _Fields(*(np.zeros_like(values) for values in rest))
    state = _State(rest, slope, np.zeros(n_cases), np.full((n_cases, 2), -1))
    last: list[Array] = []
    for number in range(cycles):
        previous = last
        before = np.asarray(state.now.area).sum(axis=1) * dz
        state = state._replace(inflow=np.zeros(n_cases))
        state, records = _cycle(wall, problem.tube, state, problem.inflow)
        _raise_if_diverged(np.asarray(state.failed_at), number, problem)
        flow, pressure = (np.moveaxis(np.array(record), 0, 1) for record in records)
        area = np.asarray(wall.area(pressure, problem.area_undeformed[:, None, :]))
        last = [flow, area, pressure]
    after = np.asarray(state.now.area).sum(axis=1) * dz
    volume_balance = np.abs(after - before - np.asarray(state.inflow)) / after
    return last, previous or None, volume_balance


def _raise_if_diverged(failed_at: Array, cycle: int, problem: Problem) -> None:
    failed = np.flatnonzero(failed_at[:, 0] >= 0)
    if not len(failed):
        return
    case = int(failed[np.argmin(failed_at[failed, 0])])
    step, point = (int(v) for v in failed_at[case])
    time = cycle * problem.period + (step + 1) * problem.tube.dt
    others = f" ({len(failed)} of {len(failed_at)} cases diverged)" if len(failed) > 1 else ""
    raise SolveError(
        f"{case_name(case, problem.labels).capitalize()} diverged at t = {time:.4g} s, "
        f"near z = {problem.z[point]:.4g} cm{others}: the wall collapsed or Newton's method failed "
        "there. Check the inlet flow, wall stiffness and outlet, or use more steps per cycle."
    )


@partial(jax.jit, static_argnames="wall")
def _cycle(wall: Wall, tube: Tube, state: _State, inflow: Any) -> tuple[_State, tuple[Any, Any]]:
    """Advance all cases by one cycle; record flow and pressure at its time points.

    ``inflow`` has the shape (time, step, stage, case), the records (time, case, z).
    """
    scheme = _Scheme(wall, tube)
    numbers = jnp.arange(inflow.shape[0] * inflow.shape[1]).reshape(inflow.shape[:2])

    def time_point(state: _State, inputs: Any) -> Any:
        record = scheme.record(state.now)
        state, _ = jax.lax.scan(scheme.step, state, inputs)
        return state, record

    end, records = jax.lax.scan(time_point, state, (numbers, inflow))
    return end, records


def _harmonic_mean(a: Any, b: Any) -> Any:
    return 2.0 / (1.0 / a + 1.0 / b)


def _behind(cell: Any, outlet: Any) -> Any:
    """Values behind the faces: those of the next cell, or of the outlet."""
    return jnp.concatenate([cell[:, 1:], outlet], axis=1)


class _Scheme:
    """Discrete equations of all cases inside the compiled cycle."""

    def __init__(self, wall: Wall, tube: Tube) -> None:
        cells, dz, dt = tube.cells, tube.dz, tube.dt
        self.wall, self.tube = wall, tube
        self.end = tube.end[:, None]
        # S_u on the faces behind the inlet, the last at the outlet itself.
        self.faces = _harmonic_mean(cells, jnp.concatenate([cells[:, 1:], self.end], axis=1))
        # Distance over which a face's momentum is balanced.
        self.width = jnp.full(cells.shape[1], dz).at[-1].set(dz / 2)
        # Factors of a stage's own slope and, in the last stage, of the slopes before.
        self.own, self.weight = _OWN * dt, _WEIGHT * dt
        # Area that a cell loses with a unit of flow through its face.
        self.outflow_share = self.own / dz
        # Of both stages: factors of the first and the latest slope, time since the latest.
        self.stages = (
            jnp.array([self.own, self.weight]),
            jnp.array([0.0, self.weight]),
            jnp.array([2.0 * self.own, dt - 2.0 * self.own]),
        )

    def capacitor(self, known: Any, flow: Any) -> Any:
        """Return p_c of a stage from its known part and the outlet flow."""
        _, distal, delay, pressure = self.tube.outlet
        return (delay * known + self.own * (pressure + distal * flow)) / (delay + self.own)

    def outlet_pressure(self, flow: Any, known: Any) -> Any:
        q = flow[:, -1]
        return (self.capacitor(known, q) + self.tube.outlet.proximal * q)[:, None]

    def balance(self, flow: Any, area: Any, known_capacitor: Any) -> tuple[Any, ...]:
        """Return ∂Q/∂t on the faces behind the inlet, and its derivatives by the flows.

        A flow also changes the areas of its two cells: the derivatives are by the flow at
        the face before, at the face itself, and at the face behind.
        """
        wall, tube, k, width = self.wall, self.tube, self.outflow_share, self.width
        q, q_out = flow[:, 1:], flow[:, -1:]
        # Area, pressure and momentum Q²/S of a cell, each with its derivatives by
        # the flow that enters it and by the flow that leaves it.
        center = 0.5 * (flow[:, :-1] + q)
        p, m = wall.pressure(area, tube.cells), center**2 / area
        p_enter = k * wall.pressure_slope(area, tube.cells)
        m_enter, m_leave = (center - k * m) / area, (center + k * m) / area

        p_out, p_out_q, s_out, s_out_q = self._outlet(flow, known_capacitor)
        m_out = q_out**2 / s_out
        s_b, p_b, m_b = _behind(area, s_out), _behind(p, p_out), _behind(m, m_out)
        s_b_q = _behind(jnp.full_like(area, k), s_out_q)
        p_b_q = _behind(p_enter, p_out_q)
        m_b_q = _behind(m_enter, (2.0 * q_out - m_out * s_out_q) / s_out)
        zero = jnp.zeros_like(q_out)
        s_b_next = _behind(jnp.full_like(area, -k), zero)
        p_b_next, m_b_next = _behind(-p_enter, zero), _behind(m_leave, zero)

        s = _harmonic_mean(area, s_b)
        gradient = (p_b - p) / width
        widening = (self.faces / s) ** 2
        loss = (tube.viscous + tube.turbulent * jnp.abs(q)) * q * widening
        bend = jnp.diff(flow, 2, axis=1) / tube.dz**2
        bend = jnp.concatenate([bend, bend[:, -1:]], axis=1)
        rho, nu = tube.density, tube.kinematic_viscosity
        rate = -tube.convection * (m_b - m) / width - s / rho * (gradient + loss) + nu * bend

        rate_s = (loss - gradient) / rho
        s_before, s_behind = 0.5 * (s / area) ** 2, 0.5 * (s / s_b) ** 2
        resistance = (tube.viscous + 2.0 * tube.turbulent * jnp.abs(q)) * widening
        stiff, inert, diffusion = s / (rho * width), tube.convection / width, nu / tube.dz**2
        before = inert * m_enter + stiff * p_enter + rate_s * s_before * k + diffusion
        own = (
            inert * (m_leave - m_b_q)
            - stiff * (p_enter + p_b_q)
            + rate_s * (s_behind * s_b_q - s_before * k)
            - s / rho * resistance
            - 2.0 * diffusion
        )
        behind = -inert * m_b_next - stiff * p_b_next + rate_s * s_behind * s_b_next
        return rate, before, own, behind + diffusion

    def _outlet(self, flow: Any, known_capacitor: Any) -> tuple[Any, Any, Any, Any]:
        """Pressure and area at the outlet, each with its derivative by the outlet flow."""
        proximal, distal, delay, _ = self.tube.outlet
        pressure = self.outlet_pressure(flow, known_capacitor)
        pressure_q = (proximal + self.own * distal / (delay + self.own))[:, None]
        # Beyond the end of the wall law S < 0. Newton's method may pass there, not stay.
        area = jnp.abs(self.wall.area(pressure, self.end))
        return pressure, pressure_q, area, pressure_q / self.wall.pressure_slope(area, self.end)

    def unfold(self, stage: _Stage, q: Any) -> tuple[Any, Any]:
        """Return flow on all faces and area in the cells, from the flow behind the inlet."""
        flow = jnp.concatenate([stage.inflow[:, None], q], axis=1)
        return flow, stage.known.area - self.outflow_share * jnp.diff(flow, axis=1)

    def stretch(self, stage: _Stage, q: Any) -> Any:
        """S/S_u in the cells and at the outlet, not positive where the wall collapsed."""
        flow, area = self.unfold(stage, q)
        outlet = self.wall.area(self.outlet_pressure(flow, stage.known.capacitor), self.end)
        return jnp.concatenate([area / self.tube.cells, outlet / self.end], axis=1)

    def newton(self, stage: _Stage, carry: Any) -> Any:
        """Take a step of Newton's method; ``carry`` is flow, last update and iteration."""
        q, _, iteration = carry
        flow, area = self.unfold(stage, q)
        rate, before, own, behind = self.balance(flow, area, stage.known.capacitor)
        residual = q - stage.known.flow[:, 1:] - self.own * rate
        update = tridiagonal_solve(
            (-self.own * before).at[:, 0].set(0.0),
            1.0 - self.own * own,
            (-self.own * behind).at[:, -1].set(0.0),
            -residual[:, :, None],
        )[:, :, 0]
        # A case whose update is not finite stays where it was.
        q = jnp.where(jnp.isfinite(update).all(axis=1, keepdims=True), q + update, q)
        # Relative to the case's own flow.
        scale = jnp.abs(q).max(axis=1, keepdims=True) + 1e-3
        return q, jnp.abs(update) / scale, iteration + 1

    def solve(self, stage: _Stage, guesses: Any) -> tuple[_Fields, Any, Any]:
        """Solve a stage for the flows; the areas follow from them.

        Where Newton's method fails from one guess, it starts again from the next.
        Also returned: whether each case was solved, and the point where it was not.
        """

        def search(best: Any, guess: Any) -> Any:
            q, _, solved = best
            start = jnp.where(solved, q, guess)
            update = jnp.where(solved, 0.0, jnp.full_like(q, jnp.inf))
            newton = partial(self.newton, stage)
            found, update, _ = jax.lax.while_loop(_unfinished, newton, (start, update, 0))
            q = jnp.where(solved, q, found)
            # NaN compares false, so that it counts as not solved.
            small = (update <= _NEWTON_TOLERANCE).all(axis=1)
            good = small & (self.stretch(stage, q) > 0.0).all(axis=1)
            return (q, update, solved | good[:, None]), None

        start = guesses[0], guesses[0], jnp.zeros((len(guesses[0]), 1), bool)
        (q, update, good), _ = jax.lax.scan(search, start, guesses)
        flow, area = self.unfold(stage, q)
        # The point where the wall collapsed, or else where the flow changes most.
        ratio = self.stretch(stage, q)
        collapsed = ~((ratio > 0.0).all(axis=1) & jnp.isfinite(update).all(axis=1))
        place = jnp.where(collapsed, ratio.argmin(axis=1), update.argmax(axis=1))
        found = _Fields(area, flow, self.capacitor(stage.known.capacitor, q[:, -1]))
        return found, good[:, 0], place

    def stage(self, start: _State, latest: tuple[_Fields, _Fields], inputs: Any) -> Any:
        """Take an implicit stage from the start of the step and the latest stage."""
        at_start, at_before, elapsed, q_in = inputs
        before, slope = latest
        known = jax.tree.map(
            lambda y, k_start, k_before: y + at_start * k_start + at_before * k_before,
            start.now,
            start.slope,
            slope,
        )
        # As if the tube were rigid, its whole flow follows the inlet's: a guess
        # that holds for a sudden start, too.  In a soft tube the flow lags behind.
        guess = before.flow + elapsed * slope.flow
        guess = guess[:, 1:] + (q_in[:, None] - guess[:, :1])
        guesses = jnp.stack([guess, before.flow[:, 1:]])
        found, good, place = self.solve(_Stage(known, q_in), guesses)
        slope = jax.tree.map(lambda y, y_known: (y - y_known) / self.own, found, known)
        return (found, slope), (good, place, _net_inflow(found))

    def step(self, state: _State, inputs: Any) -> tuple[_State, None]:
        """Take a time step; ``inputs`` are its number and the inlet flow at its stages."""
        number, q_in = inputs
        (now, slope), (good, places, net) = jax.lax.scan(
            partial(self.stage, state), (state.now, state.slope), (*self.stages, q_in)
        )
        inflow = state.inflow + self.weight * (_net_inflow(state.now) + net[0]) + self.own * net[1]
        place = jnp.where(good[0], places[1], places[0])
        place = jnp.stack([jnp.full(len(place), number), place], axis=1)
        first = ~good.all(axis=0) & (state.failed_at[:, 0] < 0)
        failed_at = jnp.where(first[:, None], place, state.failed_at)
        return _State(now, slope, inflow, failed_at), None

    def record(self, now: _Fields) -> tuple[Any, Any]:
        """Return flow and pressure at the points (case, z)."""
        outlet = now.capacitor + self.tube.outlet.proximal * now.flow[:, -1]
        p = self.wall.pressure(now.area, self.tube.cells)
        inner = 0.5 * (p[:, :-1] + p[:, 1:])
        first = 1.5 * p[:, :1] - 0.5 * p[:, 1:2]
        return now.flow, jnp.concatenate([first, inner, outlet[:, None]], axis=1)


def _unfinished(carry: Any) -> Any:
    _, update, iteration = carry
    return (iteration < _MAX_NEWTON) & jnp.any(update.max(axis=1) > _NEWTON_TOLERANCE)


def _net_inflow(fields: _Fields) -> Any:
    return fields.flow[:, 0] - fields.flow[:, -1]
