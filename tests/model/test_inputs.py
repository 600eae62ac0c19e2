"""Plausibility of a prediction's inputs."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import InputError
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.units import stated_units
from pcnde_bridge.model.inputs import check_plausible, inputs_from_arrays
from pcnde_bridge.uncertainty.novelty import Novelty


@pytest.fixture
def check(small_cases):
    """Check the inputs of cases in some units, in place of CGS units without a statement."""
    inflow, area = 1.1 * small_cases.inflow, 1.1 * small_cases.area_undeformed
    novelty = Novelty.fit(small_cases.inflow, small_cases.area_undeformed, small_cases.grid)

    def check(flow=1.0, of_area=1.0, z=1.0, time=1.0, change=None, units=None):
        s_u = of_area * area if change is None else change(area)
        grid = small_cases.z * z, time * small_cases.period
        given = inputs_from_arrays(small_cases.grid, True, flow * inflow, s_u, *grid, units)
        chosen = np.ones(len(given), dtype=bool)
        check_plausible(given, chosen, stated_units(units), novelty)
        return given

    return check


def test_cgs_units_are_usual(check, small_cases):
    assert np.array_equal(check().inflow, 1.1 * small_cases.inflow)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"flow": 1e-6}, r"--units flow=m\^3/s"),
        ({"flow": 60}, "--units flow=mL/min"),
        ({"flow": -1}, "mean inflow must not be negative"),
        ({"of_area": 100}, r"--units area=mm\^2"),
        ({"of_area": 1e-4}, r"--units area=m\^2"),
        ({"z": 10}, "ambiguous: .*with z in mm"),
        ({"time": 1000}, "--units time=ms"),
        ({"of_area": 100, "z": 10, "flow": 1000}, r"flow in mm\^3/s, area in mm\^2, z in mm"),
        ({"change": lambda s: np.sqrt(s / np.pi)}, "looks like radii"),
        ({"change": lambda s: np.sqrt(4 * s / np.pi)}, "ambiguous: .*flow in L/min"),
    ],
)
def test_other_numbers_are_refused(check, change, message):
    with pytest.raises(InputError, match=message):
        check(**change)


def test_units_are_converted(check):
    expected = check()
    units = {"flow": "mL/min", "area": "mm^2", "z": "mm", "time": "ms"}
    found = check(60, 100, 10, 1000, units=units)
    for name in ("inflow", "area_undeformed"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12)
    assert isinstance(found.grid, Grid)
    np.testing.assert_allclose(found.grid.z, expected.grid.z, rtol=1e-12)
    assert found.grid.period == pytest.approx(1.0)
    check(z=10, units="cgs")
