"""Trained share g of the wall's storage that is missing from the cross-sectional mean flow.

A network of two local quantities of the passive tube, the rate u of its outlet pressure
and its outlet flow y, gives at every time point

    g = c·sigmoid(N_θ(u/u_scale, y/y_scale) + shift),

where the ceiling c is the largest share among the training cases: g never exceeds it,
and a steady flow is unchanged.  N_θ does not depend on t itself: a waveform
shifted in time gives the shifted result, on any time grid.
"""

import jax
import jax.numpy as jnp

from pcnde_bridge.engines.closure_parameters import CORRECTION_SCALARS
from pcnde_bridge.engines.parameters import unpack_network


def storage_factor(parameters: jax.Array) -> jax.Array:
    """Return κ, the flow per change of the wall's volume; 1 where volume is conserved."""
    return parameters[0]


def hidden_share(
    parameters: jax.Array,
    pressure_rate: jax.Array,
    flow: jax.Array,
    shift: jax.Array,
    hidden: tuple[int, ...],
) -> jax.Array:
    """Return g.

    Parameters
    ----------
    parameters : array of shape (4 + n,)
        κ, c, u_scale (dyn/cm²/s), y_scale (mL/s), then per layer weights and bias.
    pressure_rate, flow : array of shape (time,)
        u and y.
    shift : scalar
        Added before the sigmoid: 0, or a sample of the case-to-case variation.
    hidden : tuple of int
        Widths of the hidden layers.
    """
    x = jnp.stack([pressure_rate / parameters[2], flow / parameters[3]], axis=-1)
    *layers, last = unpack_network(parameters[CORRECTION_SCALARS:], (2, *hidden, 1))
    for weight, bias in layers:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = last
    return parameters[1] * jax.nn.sigmoid((x @ weight + bias)[..., 0] + shift)
