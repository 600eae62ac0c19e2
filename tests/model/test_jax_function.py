"""The equations of a model as a pure JAX function."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import compiled_quickly

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics import Reflection, Waveform, Windkessel


@pytest.fixture(scope="module")
def evaluate(physics_model):
    """Loss, fields and gradient of 16 cases by inflow, area, wall and outlet; compiled once."""
    import jax

    function, parameters = physics_model.jax_function()
    shape = physics_model.grid.time.size, physics_model.grid.z.size
    weights = np.random.default_rng(0).standard_normal((2, *shape)) / [[[1.0]], [[1e5]]]

    def loss(values):
        vectors = {**parameters, "wall": values["wall"], "outlet": values["outlet"]}
        found = function(vectors, values["inflow"], values["area_undeformed"])
        return (weights[0] * found.flow + weights[1] * found.pressure).sum(), found

    batch = compiled_quickly(jax.vmap(jax.value_and_grad(loss, has_aux=True)))

    def evaluate(values):
        with double_precision():
            return jax.tree.map(np.asarray, batch(values))

    return evaluate


def repeated(parameters):
    return {name: np.repeat(parameters[name][None], 16, 0) for name in ("wall", "outlet")}


def test_it_predicts_what_the_model_does(evaluate, physics_model, physics_cases):
    expected = physics_model.predict(physics_cases)
    names = "inflow", "area_undeformed"
    given = {name: getattr(physics_cases, name) for name in names}
    (_, found), _ = evaluate(given | repeated(dict(physics_model.parameters)))
    for name, values in found._asdict().items():
        theirs = getattr(expected, name)
        error = np.abs(values - theirs).max() / np.abs(theirs).max()
        assert error < 1e-6, name


def test_gradients_are_those_of_finite_differences(evaluate, physics_model, physics_cases):
    """By inflow, area, wall and outlet.

    The losses have a kink where the area neither narrows nor widens, so the vessel tapers.
    """
    z = np.linspace(0.0, 1.0, physics_cases.z.size)
    given = repeated(dict(physics_model.parameters))
    given["inflow"] = np.repeat(physics_cases.inflow[:1], 16, 0)
    tapered = physics_cases.area_undeformed[:1] * (1.0 - 0.1 * z)
    given["area_undeformed"] = np.repeat(tapered, 16, 0)
    rng, ways = np.random.default_rng(0), {}
    # Two rows step ahead and back along one input; the last rows are unchanged.
    for row, (name, values) in enumerate(given.items()):
        x = np.linspace(0.0, 1.0, values.shape[1])
        ways[name] = values[-1] * (1.0 + 0.3 * np.sin(rng.uniform(2.0, 4.0) * x))
        values[[2 * row, 2 * row + 1]] += np.outer([1e-5, -1e-5], ways[name])
    (losses, _), slopes = evaluate(given)
    for row, (name, way) in enumerate(ways.items()):
        slope = slopes[name][-1] @ way
        ahead, back = losses[2 * row : 2 * row + 2]
        assert slope == pytest.approx((ahead - back) / 2e-5, rel=1e-6), name


def test_a_given_outlet_is_that_of_the_parameters(physics_model, physics_cases):
    """The equations take its response, too; their values are those of predictions."""
    import jax

    outlet = Windkessel(5e4, distal_pressure=Waveform(2e4, (5e3,), (0.0,)))
    function, parameters = replace(physics_model, outlet=outlet).jax_function()
    grid = physics_model.grid
    expected = outlet.response(1, grid.time, grid.period, np.ones(1))[0]
    np.testing.assert_array_equal(parameters["outlet"], expected)
    with double_precision():
        inputs = physics_cases.inflow[0], physics_cases.area_undeformed[0]
        found = jax.eval_shape(function, parameters, *inputs)
    assert found.pressure.shape == (grid.time.size, grid.z.size)


def test_a_reflection_needs_a_vessel(physics_model):
    with pytest.raises(InputError, match="vessel's end"):
        replace(physics_model, outlet=Reflection()).jax_function()


def test_only_the_preset_physics_has_one(small_model):
    with pytest.raises(InputError, match="preset 'physics'"):
        small_model.jax_function()
