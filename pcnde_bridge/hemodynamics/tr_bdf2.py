"""The 1D solver's steps in time: TR-BDF2, Newton's method, all cases at once."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.tube_laws import LinearWall, OlufsenWall

if TYPE_CHECKING:
    import pandas as pd

    from pcnde_bridge.hemodynamics.discretisation import Problem
    from pcnde_bridge.hemodynamics.solver import Tube1D

# TR-BDF2 as a diagonally implicit Runge–Kutta method with an explicit first stage:
# every implicit stage weighs its own slope by GAMMA/2, and the last stage weighs
# the two before it by _WEIGHT each.
GAMMA = 2.0 - math.sqrt(2.0)
_OWN = GAMMA / 2
_WEIGHT = math.sqrt(2.0) / 4

_MAX_NEWTON = 20
_NEWTON_TOLERANCE = 1e-6  # of the last update; convergence is quadratic


class _Fields(NamedTuple):
    """Unknowns of all cases at one instant, or their slopes in time; n is the number of cells."""

    area: Any  # S in the cells (case, n)
    flow: Any  # Q at the faces (case, n + 1); the first is the inlet
    capacitor: Any  # p_c of the Windkessel (case,)


class _State(NamedTuple):
    """All that one time step hands to the next."""

    now: _Fields
    slope: _Fields
    inflow: Any  # volume that came in less what went out in this cycle (case,)
    broken: Any  # step and point at which a case failed, or −1 (case, 2)


def run(tube: Tube1D, problem: Problem) -> tuple[list[Array], list[Array] | None, Array]:
    """Last cycle, the one before it, and the volume balance of the last."""
    cycle = _compiled_cycle(tube.wall)
    n_cases, n_faces = problem.area_undeformed.shape
    n = n_faces - 1
    cells = 0.5 * (problem.area_undeformed[:, :-1] + problem.area_undeformed[:, 1:])
    dz = float(problem.z[-1] - problem.z[0]) / n
    dt = problem.period / tube.steps
    rest = _Fields(
        area=np.asarray(tube.wall.area(problem.initial_pressure, cells)),
        flow=np.zeros((n_cases, n_faces)),
        capacitor=np.full(n_cases, problem.initial_pressure),
    )
    state = _State(
        now=rest,
        slope=_Fields(*(np.zeros_like(values) for values in rest)),
        inflow=np.zeros(n_cases),
        broken=np.full((n_cases, 2), -1),
    )
    vessel = (
        cells,
        problem.area_undeformed[:, -1],
        problem.viscous,
        problem.turbulent,
        problem.outlet,
    )
    blood = (tube.density, tube.kinematic_viscosity, 1.0 + tube.delta)
    last: list[Array] = []
    for number in range(tube.cycles):
        previous = last
        before = np.asarray(state.now.area).sum(axis=1) * dz
        state = state._replace(inflow=np.zeros(n_cases))
        state, records = cycle(state, problem.inflow, vessel, blood, dz, dt)
        _refuse_broken(np.asarray(state.broken), number, tube, problem)
        flow, pressure = (np.moveaxis(np.array(record), 0, 1) for record in records)
        area = np.asarray(tube.wall.area(pressure, problem.area_undeformed[:, None, :]))
        last = [flow, area, pressure]
    after = np.asarray(state.now.area).sum(axis=1) * dz
    volume_balance = np.abs(after - before - np.asarray(state.inflow)) / after
    return last, previous or None, volume_balance


def named(case: int, labels: pd.DataFrame) -> str:
    """Name a case in a message."""
    known = ", ".join(f"{name} {labels[name][case]}" for name in ("geometry", "waveform"))
    return f"case {case} ({known})"


def _refuse_broken(broken: Array, cycle: int, tube: Tube1D, problem: Problem) -> None:
    failed = np.flatnonzero(broken[:, 0] >= 0)
    if not len(failed):
        return
    case = int(failed[np.argmin(broken[failed, 0])])
    step, point = (int(v) for v in broken[case])
    time = cycle * problem.period + (step + 1) * problem.period / tube.steps
    others = f" ({len(failed)} of {len(broken)} cases diverged)" if len(failed) > 1 else ""
    raise SolveError(
        f"{named(case, problem.labels).capitalize()} diverged at t = {time:.4g} s, "
        f"near z = {problem.z[point]:.4g} cm{others}: the wall collapsed or the flow found no "
        "balance there. Check its inlet flow, wall stiffness and outlet, or use more steps per "
        "cycle."
    )


@functools.lru_cache(maxsize=16)
def _compiled_cycle(
    wall: LinearWall | OlufsenWall,
) -> Callable[..., tuple[_State, tuple[Any, Any]]]:
    """Compile the function that advances all cases by one cycle, for this wall."""
    import jax
    import jax.numpy as jnp
    from jax.lax.linalg import tridiagonal_solve

    def harmonic_mean(a: Any, b: Any) -> Any:
        return 2.0 / (1.0 / a + 1.0 / b)

    def cycle(state: _State, inflow: Any, vessel: Any, blood: Any, dz: Any, dt: Any) -> Any:
        rho, nu, convection = blood
        cells, end, viscous, turbulent, (proximal, distal, delay, pressure_d) = vessel
        n = cells.shape[1]
        own = _OWN * dt
        # Area on the faces behind the inlet, the last at the outlet itself.
        faces = harmonic_mean(cells, jnp.concatenate([cells[:, 1:], end[:, None]], axis=1))
        # Distance over which a face's momentum is balanced.
        width = jnp.full(n, dz).at[-1].set(dz / 2)
        # Share of a cell's area that leaves with a unit of flow through its face.
        k = own / dz

        def capacitor(pressure: Any, flow: Any) -> Any:
            """Implicit p_c of a stage, from its explicit part and the outflow."""
            return (delay * pressure + own * (pressure_d + distal * flow)) / (delay + own)

        def outlet_pressure(flow: Any, capacitor_part: Any) -> Any:
            q = flow[:, -1]
            return (capacitor(capacitor_part, q) + proximal * q)[:, None]

        def balance(flow: Any, area: Any, capacitor_part: Any) -> tuple[Any, ...]:
            """∂Q/∂t on the faces behind the inlet, and its derivatives by the flows.

            Derivatives are by the flow at the face before, at the face itself, and at
            the face behind, where a flow also changes the areas of its two cells.
            """
            q = flow[:, 1:]
            # Area, pressure and momentum Q²/S of a cell, each with its derivatives by
            # the flow that enters it and by the flow that leaves it.
            centre = 0.5 * (flow[:, :-1] + q)
            p, m = wall.pressure(area, cells), centre**2 / area
            p_enter = k * wall.pressure_slope(area, cells)
            m_enter, m_leave = (centre - k * m) / area, (centre + k * m) / area

            # What lies behind a face: the next cell, or the outlet, which follows from q.
            q_out = q[:, -1:]
            p_out = outlet_pressure(flow, capacitor_part)
            p_out_q = (proximal + own * distal / (delay + own))[:, None]
            # Beyond the end of the wall law S < 0. Newton's method may pass there, not stay.
            s_out = jnp.abs(wall.area(p_out, end[:, None]))
            s_out_q = p_out_q / wall.pressure_slope(s_out, end[:, None])
            m_out = q_out**2 / s_out

            def behind(cell: Any, outlet: Any) -> Any:
                return jnp.concatenate([cell[:, 1:], outlet], axis=1)

            s_b, p_b, m_b = behind(area, s_out), behind(p, p_out), behind(m, m_out)
            s_b_q = behind(jnp.full_like(area, k), s_out_q)
            p_b_q = behind(p_enter, p_out_q)
            m_b_q = behind(m_enter, (2.0 * q_out - m_out * s_out_q) / s_out)
            nothing = jnp.zeros_like(q_out)
            s_b_next = behind(jnp.full_like(area, -k), nothing)
            p_b_next, m_b_next = behind(-p_enter, nothing), behind(m_leave, nothing)

            s = harmonic_mean(area, s_b)
            gradient = (p_b - p) / width
            widening = (faces / s) ** 2
            loss = (viscous + turbulent * jnp.abs(q)) * q * widening
            bend = jnp.diff(flow, 2, axis=1) / dz**2
            bend = jnp.concatenate([bend, bend[:, -1:]], axis=1)
            rate = -convection * (m_b - m) / width - s / rho * (gradient + loss) + nu * bend

            rate_s = (loss - gradient) / rho
            s_before, s_behind = 0.5 * (s / area) ** 2, 0.5 * (s / s_b) ** 2
            resistance = (viscous + 2.0 * turbulent * jnp.abs(q)) * widening
            stiff, inert, diffusion = s / (rho * width), convection / width, nu / dz**2
            before = inert * m_enter + stiff * p_enter + rate_s * s_before * k + diffusion
            own_face = (
                inert * (m_leave - m_b_q)
                - stiff * (p_enter + p_b_q)
                + rate_s * (s_behind * s_b_q - s_before * k)
                - s / rho * resistance
                - 2.0 * diffusion
            )
            next_face = -inert * m_b_next - stiff * p_b_next + rate_s * s_behind * s_b_next
            return rate, before, own_face, next_face + diffusion

        def solve(known: _Fields, q_in: Any, guesses: Any) -> Any:
            """Solve y = known + own·f(y) for the flows; the areas follow from them.

            Where one guess leads nowhere, Newton's method starts again from the next.
            Also returned: whether each case was solved, and the place where it was not.
            """

            def unfold(q: Any) -> Any:
                flow = jnp.concatenate([q_in[:, None], q], axis=1)
                return flow, known.area - k * jnp.diff(flow, axis=1)

            def stretch(q: Any) -> Any:
                """S/S_u of the cells and at the outlet, not positive where the wall gave way."""
                flow, area = unfold(q)
                outlet = wall.area(outlet_pressure(flow, known.capacitor), end[:, None])
                return jnp.concatenate([area / cells, outlet / end[:, None]], axis=1)

            def newton(carry: Any) -> Any:
                q, _, iteration = carry
                flow, area = unfold(q)
                rate, before, own_face, next_face = balance(flow, area, known.capacitor)
                residual = q - known.flow[:, 1:] - own * rate
                update = tridiagonal_solve(
                    (-own * before).at[:, 0].set(0.0),
                    1.0 - own * own_face,
                    (-own * next_face).at[:, -1].set(0.0),
                    -residual[:, :, None],
                )[:, :, 0]
                # A case that comes to nothing stays where it gave way.
                q = jnp.where(jnp.isfinite(update).all(axis=1, keepdims=True), q + update, q)
                # Relative to the case's own flow.
                scale = jnp.abs(q).max(axis=1, keepdims=True) + 1e-3
                return q, jnp.abs(update) / scale, iteration + 1

            def unfinished(carry: Any) -> Any:
                _, update, iteration = carry
                return (iteration < _MAX_NEWTON) & jnp.any(update.max(axis=1) > _NEWTON_TOLERANCE)

            def search(best: Any, guess: Any) -> Any:
                q, _, solved = best
                start = jnp.where(solved, q, guess)
                update = jnp.where(solved, 0.0, jnp.full_like(q, jnp.inf))
                found, update, _ = jax.lax.while_loop(unfinished, newton, (start, update, 0))
                q = jnp.where(solved, q, found)
                # NaN compares false, so that it counts as bad.
                good = (update <= _NEWTON_TOLERANCE).all(axis=1) & (stretch(q) > 0.0).all(axis=1)
                return (q, update, solved | good[:, None]), None

            start = guesses[0], guesses[0], jnp.zeros((len(cells), 1), bool)
            (q, update, good), _ = jax.lax.scan(search, start, guesses)
            flow, area = unfold(q)
            # Where the wall gave way, or else where the flow found no balance.
            ratio = stretch(q)
            gave_way = ~((ratio > 0.0).all(axis=1) & jnp.isfinite(update).all(axis=1))
            place = jnp.where(gave_way, ratio.argmin(axis=1), update.argmax(axis=1))
            found = _Fields(area, flow, capacitor(known.capacitor, q[:, -1]))
            return found, good[:, 0], place

        # Of both implicit stages: how the slopes at the start of the step and at the
        # stage before weigh in, and the time since the stage before.
        w = _WEIGHT * dt
        weigh_start, weigh_before = jnp.array([own, w]), jnp.array([0.0, w])
        elapsed = jnp.array([2.0 * own, dt - 2.0 * own])

        def step(state: _State, inputs: Any) -> Any:
            number, q_in = inputs

            def stage(latest: tuple[_Fields, _Fields], inputs: Any) -> Any:
                at_start, at_before, time, q_in = inputs
                before, slope = latest
                known = jax.tree.map(
                    lambda y, k_start, k_before: y + at_start * k_start + at_before * k_before,
                    state.now,
                    state.slope,
                    slope,
                )
                # As if the tube were rigid, its whole flow follows the inlet's: a guess
                # that holds for a sudden start, too.  In a soft tube the flow lags behind.
                guess = before.flow + time * slope.flow
                guess = guess[:, 1:] + (q_in[:, None] - guess[:, :1])
                guesses = jnp.stack([guess, before.flow[:, 1:]])
                found, good, place = solve(known, q_in, guesses)
                slope = jax.tree.map(lambda y, y_known: (y - y_known) / own, found, known)
                return (found, slope), (good, place, net_inflow(found))

            (now, slope), (good, places, net) = jax.lax.scan(
                stage, (state.now, state.slope), (weigh_start, weigh_before, elapsed, q_in)
            )
            inflow = state.inflow + w * (net_inflow(state.now) + net[0]) + own * net[1]
            place = jnp.where(good[0], places[1], places[0])
            place = jnp.stack([jnp.full(len(cells), number), place], axis=1)
            first = ~good.all(axis=0) & (state.broken[:, 0] < 0)
            broken = jnp.where(first[:, None], place, state.broken)
            return _State(now, slope, inflow, broken), None

        def net_inflow(fields: _Fields) -> Any:
            return fields.flow[:, 0] - fields.flow[:, -1]

        def instant(state: _State, inputs: Any) -> Any:
            flow = state.now.flow
            out = state.now.capacitor + proximal * flow[:, -1]
            p = wall.pressure(state.now.area, cells)
            inner = 0.5 * (p[:, :-1] + p[:, 1:])
            first = 1.5 * p[:, :1] - 0.5 * p[:, 1:2]
            record = (flow, jnp.concatenate([first, inner, out[:, None]], axis=1))
            state, _ = jax.lax.scan(step, state, inputs)
            return state, record

        numbers = jnp.arange(inflow.shape[0] * inflow.shape[1]).reshape(inflow.shape[:2])
        return jax.lax.scan(instant, state, (numbers, inflow))

    compiled: Callable[..., tuple[_State, tuple[Any, Any]]] = jax.jit(cycle)
    return compiled
