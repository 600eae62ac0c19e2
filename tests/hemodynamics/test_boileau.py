"""Single vessels of Boileau et al. (2015); see benchmarks/boileau.py."""

import runpy
from pathlib import Path

import numpy as np
import pytest

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "boileau.py"))


def test_inflows_are_those_of_the_paper():
    """Values of openBF's inlet files for the same vessels."""
    inflow = {name: vessel[5] for name, vessel in SCRIPT["VESSELS"].items()}
    found = inflow["aorta"].flow(np.array([0.0, 0.0964646464646464, 0.3183333333333333]))
    np.testing.assert_allclose(found, [1.297902587706564, 482.7837517253132, -43.70178344576869])
    found = inflow["carotid"].flow([0.0, 0.2])
    np.testing.assert_allclose(found, [4.522272753764271, 13.30027611638510])


@pytest.mark.parametrize(("name", "limit"), [("carotid", 0.001), ("aorta", 0.01)])
def test_pressure_on_the_default_grid(name, limit):
    """RMS of P in percent."""
    reference = SCRIPT["load_reference"]()[name]
    found = SCRIPT["errors"](name, SCRIPT["periodic"](name), reference)
    assert found["P RMS"] <= limit
    assert found["Q RMS"] <= 0.03
    assert found["dP RMS"] <= 0.1


@pytest.mark.slow
def test_the_pulse():
    assert SCRIPT["pulse"](0.0)[0] == pytest.approx(1.0, rel=0.01)
    computed, decayed = SCRIPT["pulse"](0.04)
    assert decayed == pytest.approx(0.585, abs=1e-3)  # friction damps it
    assert computed == pytest.approx(decayed, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["carotid", "aorta"])
def test_convergence_is_of_second_order(name):
    assert SCRIPT["order"](name, True) == pytest.approx(2.0, abs=0.15)
    assert SCRIPT["order"](name, False) == pytest.approx(2.0, abs=0.15)
