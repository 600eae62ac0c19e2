"""Calibration of the 1D solver and of trained models."""

import numpy as np
import pytest

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.errors import InputError
from pcnde_bridge.evaluation import calibrate
from pcnde_bridge.hemodynamics import LinearWall, Tube1D, Windkessel, coronary
from pcnde_bridge.hemodynamics.discretization import discretize

TRUTH = {"young_modulus": 1.2e7, "resistance": 1.1e5}


@pytest.fixture(scope="module")
def pressure():
    """The solver's pressure at the inlet and the change of its area, for E and R."""
    z = np.linspace(0.0, 4.0, 6)
    tube = Tube1D(LinearWall(), n_times=20, steps=80, cycles=2)
    problem = discretize(tube, z, np.full((1, 6), 0.1257), [coronary()], Windkessel(1e5))
    function, inputs = tube.jax_function(problem)

    def predict(parameters):
        import jax.numpy as jnp

        wall = {**inputs.wall, "young_modulus": jnp.full((1, 6), parameters["young_modulus"])}
        outlet = {**inputs.outlet, "resistance": jnp.full((1, 1), parameters["resistance"])}
        _, area, found = function(inputs._replace(wall=wall, outlet=outlet))
        return jnp.stack([found[0, :, 0] / 1e5, area[0, :, 2] / 0.1257])

    return predict


def test_intervals_contain_the_truth(pressure):
    """Stiffness and resistance from noisy pressures and areas: 100 trials, 95 % intervals."""
    with double_precision():
        exact = np.asarray(pressure(TRUTH))
    noise, rng = np.array([[0.02], [0.002]]), np.random.default_rng(0)
    hits = dict.fromkeys(TRUTH, 0)
    for _ in range(100):
        measured = exact + noise * rng.standard_normal(exact.shape)
        found = calibrate(pressure, {"young_modulus": 1.5e7, "resistance": 9e4}, measured, noise)
        bounds = found.intervals(0.95)
        for name, value in TRUTH.items():
            hits[name] += bounds.low[name] <= value <= bounds.high[name]
            assert bounds.high[name] / bounds.low[name] < 1.1
    assert all(85 <= count <= 100 for count in hits.values()), hits
    assert found.misfit == pytest.approx(1.0, abs=0.4)


def test_prior_is_weighed_against_the_measurement():
    """A normal prior and one measurement of log x have the well-known mean and variance."""
    import jax.numpy as jnp

    found = calibrate(lambda p: jnp.log(p["x"]), {"x": 1.0}, 1.0, 0.5, priors={"x": 0.5})
    assert np.log(found.values["x"]) == pytest.approx(0.5, rel=1e-6)
    assert found.covariance.loc["x", "x"] == pytest.approx(0.125, rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"start": {"a": -1.0, "b": 1.0}}, r"start\['a'\] must be positive"),
        ({"priors": {"c": 1.0}}, r"priors has \['c'\]"),
        ({"noise": 0.0}, "noise must be positive"),
        ({"measured": [1.0, 2.0]}, r"predict returns the shape \(\)"),
        ({}, "do not determine all parameters"),
    ],
)
def test_bad_input(changes, words):
    given = {"start": {"a": 1.0, "b": 1.0}, "measured": 2.0, "noise": 0.1} | changes
    with pytest.raises(InputError, match=words):
        calibrate(lambda p: p["a"] * p["b"], **given)
