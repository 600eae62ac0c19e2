"""The closures of the preset ``physics``: both engines, same parameters, same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import (
    AREA,
    CONFIG,
    CORRECTED,
    GRID,
    INFLOW,
    LOSSES,
    MEMBRANE,
    ON,
    SHEAR,
    VESSELS,
    vessel,
    waveforms,
)

from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.jax.engine import JaxEngine
from pcnde_bridge.engines.julia.engine import JuliaEngine
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import SolveError
from pcnde_bridge.hemodynamics import CoronaryOutlet, Waveform

pytestmark = [
    pytest.mark.julia,
]

LOCAL = CONFIG.replace(wall={"law": "local"})
WINDKESSEL = CORRECTED.replace(outlet=np.array([2e4, 8e4, 1e-6, 5e3]))
OWN = CoronaryOutlet(
    3e4, np.linspace(4e4, 8e4, 16), 2e4, 4e-7, 3e-6, Waveform(2e4, (-1e4,), (5e3,)), 5e3
)


def responses(outlet):
    return None if outlet is None else outlet.response(16, GRID.time, GRID.period, np.ones(16))


@pytest.fixture(scope="module")
def both():
    return JuliaEngine().closures, JaxEngine().closures


@pytest.fixture(scope="module")
def inflow():
    """One of them reverses."""
    waveforms = INFLOW.copy()
    waveforms[3] = 2.5 * (waveforms[3] - waveforms[3].mean()) + 0.5
    return waveforms


@pytest.fixture(scope="module")
def solution(both, inflow):
    return both[1].predict(CORRECTED, np.zeros(16), ModelInputs(inflow, AREA, GRID), CONFIG)


def assert_same(found, expected, rounding=0.0):
    assert found.shape == expected.shape
    tolerance = max(1e-12 * np.abs(expected).max(), rounding)
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


def assert_same_problems(problems, parameters):
    (value, jacobian), (expected, expected_jacobian) = (p(parameters) for p in problems)
    assert_same(value, expected)
    # Of a parameter without effect, the derivative is the round-off of the value.
    rounding = 1e-15 * np.abs(expected).max()
    for k in range(parameters.size):
        assert_same(jacobian[..., k], expected_jacobian[..., k], rounding)


@pytest.mark.parametrize("spread", [0.06, 1e-3, 10.0])
def test_losses(both, solution, spread):
    """The time points are some of the cycle, for which the rate of the flow is given."""
    flow_rate = np.gradient(solution.flow, GRID.time, axis=1)
    area = AREA.copy()
    area[5] = vessel(1.0, 2.7)  # two jets
    given = solution.flow[:, ::3], flow_rate[:, ::3], area
    problems = [c.losses(*given, GRID, CONFIG) for c in both]
    parameters = LOSSES.copy()
    parameters[7] = spread
    assert_same_problems(problems, parameters)


@pytest.mark.parametrize(
    ("config", "parameters"), [(CONFIG, MEMBRANE), (LOCAL, np.array([1.0e6, 0.5, 2.0e3]))]
)
def test_walls(both, solution, config, parameters):
    problems = [c.area(solution.pressure, AREA, GRID, config) for c in both]
    assert_same_problems(problems, parameters)


def test_wall_shear_stress(both, solution):
    """The stress behind two jets, in one batch with other vessels, and in reversed flow."""
    area = AREA.copy()
    area[5] = vessel(1.0, 2.7)
    flow_rate = np.gradient(solution.flow, GRID.time, axis=1)
    given = CORRECTED, solution.flow[:, ::3], flow_rate[:, ::3], area, GRID, CONFIG
    problems = [c.wall_shear_stress(*given) for c in both]
    assert_same_problems(problems, SHEAR)


@pytest.mark.parametrize(
    ("others", "outlet"), [(CORRECTED, None), (WINDKESSEL, None), (CORRECTED, OWN)]
)
def test_flow_of_all_coupled(both, inflow, others, outlet):
    given = others, ModelInputs(inflow, AREA, GRID), np.array([8, 20, 40]), CONFIG
    problems = [c.flow(*given, responses(outlet)) for c in both]
    assert_same_problems(problems, ON)


def test_predictions(both, inflow, solution):
    shift = np.linspace(-1.0, 1.0, 16)
    # All harmonics, Nyquist's too.
    inflow = inflow + 0.05 * np.random.default_rng(7).normal(size=inflow.shape)
    for parameters, outlet in ((CORRECTED, None), (WINDKESSEL, None), (CORRECTED, OWN)):
        given = parameters, shift, ModelInputs(inflow, AREA, GRID), CONFIG
        found, expected = (c.predict(*given, responses(outlet)) for c in both)
        for mine, theirs in zip(found, expected, strict=True):
            assert_same(mine, theirs)
    # A case does not depend on those beside it, to the bit.
    alone = both[0].predict(
        CORRECTED, shift[4:5], ModelInputs(inflow[4:5], AREA[4:5], GRID), CONFIG
    )
    together = both[0].predict(CORRECTED, shift, ModelInputs(inflow, AREA, GRID), CONFIG)
    for one, all_ in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one[0], all_[4])


def test_an_odd_number_of_time_points(both):
    time = 0.8 * np.arange(25) / 25
    grid = Grid(time, GRID.z, 0.8)
    found, expected = (
        c.predict(CORRECTED, np.zeros(4), ModelInputs(waveforms(time / 0.8), VESSELS, grid), CONFIG)
        for c in both
    )
    for mine, theirs in zip(found, expected, strict=True):
        assert_same(mine, theirs)


def test_what_does_not_settle_is_the_same_error(both):
    inflow = INFLOW.copy()
    inflow[[9, 12]] *= 1e2
    words = []
    for closures in both:
        with pytest.raises(SolveError, match="case 9 do not settle") as caught:
            closures.predict(CORRECTED, np.zeros(16), ModelInputs(inflow, AREA, GRID), CONFIG)
        words.append(str(caught.value))
    assert words[0] == words[1]
