"""The equations of a model as a pure JAX function."""

import numpy as np
import pytest

from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.errors import InputError


def test_it_predicts_what_the_model_does(physics_model, physics_cases):
    import jax

    function, parameters = physics_model.jax_function()
    expected = physics_model.predict(physics_cases)
    given = physics_cases.inflow, physics_cases.area_undeformed
    with double_precision():
        found = jax.jit(jax.vmap(function, (None, 0, 0)))(parameters, *given)
        for name, values in found._asdict().items():
            theirs = getattr(expected, name)
            error = np.abs(np.asarray(values) - theirs).max() / np.abs(theirs).max()
            assert error < 1e-6, name


def test_gradients_are_those_of_finite_differences(physics_model, physics_cases):
    """By inflow, area, wall and outlet.

    The losses have a kink where the area neither narrows nor widens, so the vessel tapers.
    """
    import jax

    function, parameters = physics_model.jax_function()
    z = np.linspace(0.0, 1.0, physics_cases.z.size)
    tapered = physics_cases.area_undeformed[0] * (1.0 - 0.1 * z)
    given = {"inflow": physics_cases.inflow[0], "area_undeformed": tapered}
    given |= {name: parameters[name] for name in ("wall", "outlet")}
    rng = np.random.default_rng(0)
    shape = physics_cases.flow[0].shape
    weights = rng.standard_normal((2, *shape))

    @jax.jit
    def loss(values):
        vectors = {**parameters, "wall": values["wall"], "outlet": values["outlet"]}
        found = function(vectors, values["inflow"], values["area_undeformed"])
        return (weights[0] * found.flow).sum() + (weights[1] * found.pressure).sum() / 1e5

    with double_precision():
        slopes = jax.jit(jax.grad(loss))(given)
        for name, values in given.items():
            x = np.linspace(0.0, 1.0, values.size)
            way = values * (1.0 + 0.3 * np.sin(rng.uniform(2.0, 4.0) * x))
            ahead, back = (float(loss({**given, name: values + h * way})) for h in (1e-5, -1e-5))
            slope = float((slopes[name] * way).sum())
            assert slope == pytest.approx((ahead - back) / 2e-5, rel=1e-6), name


def test_only_the_preset_physics_has_one(small_model):
    with pytest.raises(InputError, match="preset 'physics'"):
        small_model.jax_function()
