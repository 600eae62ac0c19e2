"""Trained parameters of the paper's stages: one layout for all engines and model files.

Each stage's parameters are one flat float64 vector:

========================  =========================================================
``flow``                  network 2·n_t → hidden → n_t
``intermediate_area``     â(z), then b̂(z): 2·n_z numbers
``fourier_area``          a(z), then b(z): 2·n_z numbers
``temporal_pressure``     network 4·n_z → hidden → n_z
``spatial_pressure``      a₁, a₂, then b₁(t), then b₂(t): 2 + 2·n_t numbers
========================  =========================================================

A network is stored layer by layer: the weight matrix (out × in) column by
column, as Julia stores it, then the bias.  The flow network's input is Q at all
time points, then S at all time points; the pressure network's is S, S − S_u, Δp
and Q at all points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, Self, TypeVar

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.errors import InputError

ArrayT = TypeVar("ArrayT", bound=Any)  # array of numpy or JAX

PRESSURE_STAGES = ("temporal_pressure", "spatial_pressure")
"""Names of the stages that are trained after flow and area."""

STAGES = ("flow", "intermediate_area", "fourier_area", *PRESSURE_STAGES)
"""Names of the five stages, in the order in which they are trained."""


def layer_sizes(stage: str, config: PCNDEConfig, n_times: int, n_points: int) -> tuple[int, ...]:
    """Return the widths of a stage's network from input to output.

    Parameters
    ----------
    stage : {'flow', 'temporal_pressure', 'temporal_flow'}
        Name of a stage that has a network.
    config : PCNDEConfig
        Settings with the hidden widths.
    n_times, n_points : int
        Time points per cycle and points along the vessel.
    """
    if stage == "flow":
        return (2 * n_times, *config.flow.hidden, n_times)
    if stage == "temporal_flow":
        return (n_points + config.temporal_flow.time_input, *config.temporal_flow.hidden, n_points)
    return (4 * n_points, *config.temporal_pressure.hidden, n_points)


def sizes(config: PCNDEConfig, n_times: int, n_points: int) -> dict[str, int]:
    """Return the length of every stage's parameter vector."""
    shape = config, n_times, n_points
    return {
        "flow": network_size(layer_sizes("flow", *shape)),
        "intermediate_area": 2 * n_points,
        "fourier_area": 2 * n_points,
        "temporal_pressure": network_size(layer_sizes("temporal_pressure", *shape)),
        "spatial_pressure": 2 + 2 * n_times,
    }


def network_size(widths: Sequence[int]) -> int:
    """Count the weights and biases of a network with layers of the given widths."""
    return sum((n_in + 1) * n_out for n_in, n_out in pairwise(widths))


def unpack_network(parameters: ArrayT, widths: Sequence[int]) -> list[tuple[ArrayT, ArrayT]]:
    """Return the weights, transposed to (in, out), and the bias of every layer.

    Parameters
    ----------
    parameters : array of shape (size,)
        Parameters of a network, a numpy or a JAX array.
    widths : sequence of int
        Widths of the layers from input to output.
    """
    layers, start = [], 0
    for n_in, n_out in pairwise(widths):
        end = start + n_in * n_out
        weights = parameters[start:end].reshape(n_in, n_out)
        start = end + n_out
        layers.append((weights, parameters[end:start]))
    return layers


@dataclass(frozen=True, eq=False, repr=False)
class ParameterVectors(Displayed):
    """Base class of named flat parameter vectors, copied to float64 and read-only."""

    def __post_init__(self) -> None:
        for field in fields(self):
            vector = np.array(getattr(self, field.name), dtype=np.float64)
            vector.flags.writeable = False
            if vector.ndim != 1:
                raise InputError(
                    f"The {field.name} parameters must be one flat vector, got shape "
                    f"{vector.shape}."
                )
            object.__setattr__(self, field.name, vector)

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        return ((field.name, getattr(self, field.name)) for field in fields(self))

    def replace(self, **vectors: Array) -> Self:
        """Return a copy with some vectors changed."""
        return type(self)(**{**dict(self), **vectors})

    def check_sizes(
        self, sizes: Mapping[str, int], needed_for: str, optional: Sequence[str] = ()
    ) -> None:
        """Raise unless every vector is finite and has the given length, or is optional and empty.

        Raises
        ------
        InputError
            With the vector's name, and the actual and the necessary length.
        """
        for name, needed in sizes.items():
            vector = getattr(self, name)
            if not np.isfinite(vector).all():
                raise InputError(f"The {name} parameters are not all finite.")
            if vector.size != needed and (vector.size or name not in optional):
                raise InputError(
                    f"The {name} parameters have {vector.size} numbers, but {needed} are needed "
                    f"for {needed_for}."
                )


@dataclass(frozen=True, eq=False, repr=False)
class Parameters(ParameterVectors):
    """All parameters of a PCNDE, one flat read-only vector per stage.

    Attributes
    ----------
    flow, intermediate_area, fourier_area, temporal_pressure, spatial_pressure
        Arrays of shape (size,); this module's docstring describes their layout.
    """

    flow: Array
    intermediate_area: Array
    fourier_area: Array
    temporal_pressure: Array
    spatial_pressure: Array

    @property
    def has_pressure(self) -> bool:
        """Whether the pressure stages have parameters."""
        return self.temporal_pressure.size > 0

    def without_pressure(self) -> Parameters:
        """Return a copy for flow and area alone."""
        return self.replace(**{stage: np.empty(0) for stage in PRESSURE_STAGES})

    def __eq__(self, other: object) -> bool:
        """Return whether every number is the same, bit for bit."""
        return isinstance(other, Parameters) and all(
            np.array_equal(mine, getattr(other, name)) for name, mine in self
        )

    def check(self, config: PCNDEConfig, n_times: int, n_points: int) -> None:
        """Raise if a vector does not fit the configuration and grid, or is not finite.

        The pressure stages' vectors may be empty: such a model predicts no pressure.

        Raises
        ------
        InputError
            With the stage, and the actual and the necessary length.
        """
        where = f"{n_times} time points, {n_points} points in z and this configuration"
        self.check_sizes(sizes(config, n_times, n_points), where, optional=PRESSURE_STAGES)


def initial_parameters(config: PCNDEConfig, n_times: int, n_points: int, seed: int) -> Parameters:
    """Create the parameters before training.

    Networks start Glorot-uniform with zero bias, but the last layer of the pressure network
    starts at zero, so that p̂ = p_ref; â = a = 1 and b̂ = b = 0, which is the continuity
    equation itself; a₁ = a₂ = b₁ = 0 and b₂ = 1, which is the empirical pressure drop itself.

    Parameters
    ----------
    config : PCNDEConfig
        Settings with the networks' hidden widths.
    n_times, n_points : int
        Time points per cycle and points along the vessel.
    seed : int
        Random seed of the networks' weights; each stage has its own stream.
    """
    correction = np.repeat([1.0, 0.0], n_points)

    def network(stage: str) -> Array:
        rng = np.random.default_rng([seed, STAGES.index(stage), 0])
        return _glorot(layer_sizes(stage, config, n_times, n_points), rng)

    temporal_pressure = network("temporal_pressure")
    temporal_pressure[-(config.temporal_pressure.hidden[-1] + 1) * n_points :] = 0
    return Parameters(
        flow=network("flow"),
        intermediate_area=correction,
        fourier_area=correction,
        temporal_pressure=temporal_pressure,
        spatial_pressure=np.concatenate([np.zeros(2 + n_times), np.ones(n_times)]),
    )


def initial_temporal_flow(config: PCNDEConfig, n_points: int, seed: int) -> Array:
    """Create the Glorot-uniform network of the momentum equation in time.

    Its input is Q at all points and, with ``time_input``, t/T.  The arguments are those of
    :func:`initial_parameters`.
    """
    # This stream is not used by any stage of the model.
    rng = np.random.default_rng([seed, len(STAGES)])
    return _glorot(layer_sizes("temporal_flow", config, 0, n_points), rng)


def _glorot(widths: Sequence[int], rng: np.random.Generator) -> Array:
    vectors = []
    for n_in, n_out in pairwise(widths):
        limit = np.sqrt(6.0 / (n_in + n_out))
        vectors += [rng.uniform(-limit, limit, n_in * n_out), np.zeros(n_out)]
    return np.concatenate(vectors)
