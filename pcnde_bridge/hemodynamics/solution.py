"""Result of the 1D solver: its cases, how accurate they are, and why some failed."""

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics.discretization import Problem, case_name

_log = logging.getLogger("pcnde_bridge.hemodynamics.solver")

_NOT_PERIODIC = 1e-3
_NEARLY_CRITICAL = 0.9  # of the critical speed, in the last state before a case fails


@dataclass(frozen=True)
class Solution:
    """Result of :meth:`~pcnde_bridge.hemodynamics.solver.Tube1D.run`.

    Attributes
    ----------
    cases : Cases
        The last cycle of the cases that did not diverge; see
        :meth:`~pcnde_bridge.hemodynamics.solver.Tube1D.solve`.
    state : object
        State at its end, from which :meth:`~pcnde_bridge.hemodynamics.solver.Tube1D.run` goes on.
    failures : dict
        What went wrong, by the index of the case, for cases that diverged.
    """

    cases: Cases
    state: Any
    failures: dict[int, str]

    def check(self) -> Cases:
        """Return the cases, or raise a ``SolveError`` with the failures if there are any."""
        if self.failures:
            raise SolveError(summary(self.failures))
        return self.cases


def summary(failures: dict[int, str]) -> str:
    """Return the first failure, and the other cases."""
    first, *others = failures
    also = f" Cases {', '.join(map(str, others))} diverged, too." if others else ""
    return failures[first] + also


def failures(problem: Problem, group: Any, state: Any, cycle: int) -> dict[int, str]:
    """Return what went wrong with the cases that diverged, by their index."""
    found = {}
    steps, points = np.asarray(state.failed_at)
    for k in np.flatnonzero(steps[: len(group)] >= 0).tolist():
        time = cycle * problem.period + (steps[k] + 1) * problem.blood.dt
        place = f"t = {time:.4g} s, near z = {problem.z[points[k]]:.4g} cm"
        name = case_name(group[k], problem.labels).capitalize()
        reason = _reason(problem, group[k], state, k)
        found[int(group[k])] = f"{name} diverged at {place}: {reason}"
    return found


def _reason(problem: Problem, case: int, state: Any, column: int) -> str:
    """Return the reason for which a case failed, judged by its last state, and what to do."""
    flow, area = (np.asarray(values)[:, column] for values in (state.now.flow, state.now.area))
    s_u = problem.inputs.area_undeformed[case]
    cells = 0.5 * (s_u[1:] + s_u[:-1])
    wall = _wall_of(problem, (case, slice(1, None)))
    wave_speed = wall.wave_speed(area, cells, problem.blood.density)
    # At the critical speed a wave of the momentum equation with the factor α stands still.
    speed = np.abs(0.5 * (flow[1:] + flow[:-1]) / area)
    critical = wave_speed / problem.blood.convection**0.5
    cell = int(np.argmax(speed / critical))
    if speed[cell] > _NEARLY_CRITICAL * critical[cell]:
        z = 0.5 * (problem.z[cell] + problem.z[cell + 1])
        return (
            f"the vessel is choked at z = {z:.4g} cm: the flow of {speed[cell]:.0f} cm/s "
            f"reaches the critical speed of {critical[cell]:.0f} cm/s in the throat's current "
            "area. More steps do not help; lower the flow or the blockage, raise the outlet's "
            "pressure, or stiffen the wall."
        )
    return (
        "the wall collapsed or Newton's method failed there. Check the inlet flow, wall "
        "stiffness and outlet, or use more steps per cycle."
    )


def periodicity(problem: Problem, group: Any, last: list[Array], previous: list[Array]) -> Array:
    """Distance of several cases to the periodic cycle, (case,).

    It is the largest relative change of flow, area and pressure from cycle to cycle, over
    the fraction of the distance that a cycle covers.
    """

    def norm(y: Array) -> Array:
        return np.asarray(np.sqrt((y**2).sum(axis=(1, 2))))

    pairs = zip(last, previous, strict=True)
    change = np.max([norm(a - b) / np.maximum(norm(a), 1e-300) for a, b in pairs], axis=0)
    return np.asarray(change / _settling(problem, group, last[1]))


def _settling(problem: Problem, group: Any, area: Array) -> Array:
    """Fraction of its distance to the periodic state that a cycle covers, (case,)."""
    outlet = {name: values[group] for name, values in problem.inputs.outlet.items()}
    resistance, delay = problem.form.outlet.settling(outlet)
    wall, s_u = _wall_of(problem, group), problem.inputs.area_undeformed[group]
    compliance = (1.0 / wall.pressure_slope(area.mean(axis=1), s_u)).mean(axis=1)
    compliance *= problem.z[-1] - problem.z[0]
    # The sum of both times is an upper bound of the slower of two that are coupled.
    slowest = delay + resistance * compliance
    with np.errstate(divide="ignore"):
        return np.asarray(-np.expm1(-problem.period / slowest))


def _wall_of(problem: Problem, places: Any) -> Any:
    """Return the wall of several cases and points."""
    parameters = problem.inputs.wall.items()
    return problem.form.wall.of({k: None if v is None else v[places] for k, v in parameters})


def report(periodicity: Array, volume_balance: Array) -> None:
    """Log the accuracy of all cases, and warn about those that are not periodic yet."""
    _log.debug("Periodicity %s, volume balance %s.", periodicity, volume_balance)
    if len(late := np.flatnonzero(periodicity > _NOT_PERIODIC)):
        _log.warning(
            "%d of %d cases are not periodic yet, case %d is %.1e away; use more "
            "cycles, Tube1D(cycles=…), or an initial_pressure nearer the mean.",
            *(len(late), len(periodicity), late[0], periodicity[late[0]]),
        )
