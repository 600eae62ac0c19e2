"""The layout of the learnable parameters."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from pcnde_bridge import PAPER, InputError
from pcnde_bridge.engines.parameters import (
    PRESSURE_STAGES,
    STAGES,
    Parameters,
    initial_parameters,
    layer_sizes,
    sizes,
)

SMALL = PAPER.replace(flow={"hidden": (3, 5)}, temporal_pressure={"hidden": (4,)})


@pytest.fixture(scope="module")
def first():
    return initial_parameters(SMALL, 7, 6, seed=5)


def layers(vector, widths):
    """Weights (out × in, by columns) and biases of a flat vector, as documented."""
    found, start = [], 0
    for n_in, n_out in pairwise(widths):
        weight = vector[start : start + n_in * n_out].reshape((n_out, n_in), order="F")
        start += n_in * n_out
        found.append((weight, vector[start : start + n_out]))
        start += n_out
    assert start == vector.size
    return found


def test_stages_are_in_the_order_of_training():
    assert STAGES == (
        "flow",
        "intermediate_area",
        "fourier_area",
        "temporal_pressure",
        "spatial_pressure",
    )
    assert STAGES[3:] == PRESSURE_STAGES


def test_sizes_by_hand(first):
    assert layer_sizes("flow", SMALL, 7, 6) == (14, 3, 5, 7)
    assert layer_sizes("temporal_pressure", SMALL, 7, 6) == (24, 4, 6)
    expected = {
        "flow": (14 * 3 + 3) + (3 * 5 + 5) + (5 * 7 + 7),
        "intermediate_area": 12,
        "fourier_area": 12,
        "temporal_pressure": (24 * 4 + 4) + (4 * 6 + 6),
        "spatial_pressure": 2 + 14,
    }
    assert sizes(SMALL, 7, 6) == expected
    assert {name: vector.size for name, vector in first} == expected


@pytest.mark.parametrize("stage", ["flow", "temporal_pressure"])
def test_networks_start_glorot_uniform_with_zero_bias(stage):
    config = PAPER.replace(flow={"hidden": (40, 50)}, temporal_pressure={"hidden": (40, 50)})
    widths = layer_sizes(stage, config, 30, 20)
    vector = getattr(initial_parameters(config, 30, 20, seed=0), stage)
    found = layers(vector, widths)
    if stage == "temporal_pressure":  # p̂ = p_ref at first
        last_weight, last_bias = found.pop()
        assert last_weight.size
        assert not last_weight.any()
        assert not last_bias.any()
    for weight, bias in found:
        limit = np.sqrt(6 / sum(weight.shape))
        assert np.abs(weight).max() <= limit
        assert np.abs(weight).max() > 0.95 * limit
        assert weight.var() == pytest.approx(limit**2 / 3, rel=0.15)
        assert abs(weight.mean()) < 0.1 * limit
        assert not bias.any()


def test_corrections_start_as_the_equations_themselves(first):
    for vector in (first.intermediate_area, first.fourier_area):
        assert np.array_equal(vector, [1.0] * 6 + [0.0] * 6)
    a1_a2_b1, b2 = first.spatial_pressure[:9], first.spatial_pressure[9:]
    assert not a1_a2_b1.any()
    assert np.array_equal(b2, np.ones(7))


def test_same_seed_same_numbers_other_seed_others(first):
    assert initial_parameters(SMALL, 7, 6, seed=5) == first
    other = initial_parameters(SMALL, 7, 6, seed=6)
    assert other != first
    for stage in ("flow", "temporal_pressure"):
        assert not np.array_equal(getattr(other, stage), getattr(first, stage))


def test_a_stages_weights_do_not_depend_on_another_stage(first):
    wider = SMALL.replace(flow={"hidden": (9, 9)})
    other = initial_parameters(wider, 7, 6, seed=5)
    assert other.flow.size != first.flow.size
    assert np.array_equal(other.temporal_pressure, first.temporal_pressure)


def test_stages_have_streams_of_their_own():
    """With the same widths, two networks of one seed still start differently."""
    config = PAPER.replace(flow={"hidden": (3,)}, temporal_pressure={"hidden": (3,)})
    found = initial_parameters(config, 8, 4, seed=1)  # inputs 16 and 16
    shared = 16 * 3
    scale = np.sqrt((16 + 3) / 6)
    assert not np.allclose(
        scale * found.flow[:shared], scale * found.temporal_pressure[:shared], atol=1e-3
    )


def test_parameters_are_copied_and_read_only(first):
    source = np.arange(3.0)
    vectors = Parameters(source, source, source, source, source)
    source[0] = 99
    assert vectors.flow[0] == 0
    for _, vector in first:
        assert vector.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            vector[0] = 1.0
    with pytest.raises(AttributeError):
        first.flow = source


def test_a_vector_must_be_flat():
    flat = np.zeros(4)
    with pytest.raises(InputError, match=r"fourier_area .* flat vector, got shape \(2, 2\)"):
        Parameters(flat, flat, np.zeros((2, 2)), flat, flat)


def test_equality_is_of_every_number(first):
    assert first == first.replace()
    assert first != 3
    assert first != "flow"
    for name, vector in first:
        changed = vector.copy()
        changed[-1] = np.nextafter(changed[-1], np.inf)
        assert first != first.replace(**{name: changed})
        assert first != first.replace(**{name: vector[:-1]})
    with pytest.raises(TypeError):
        hash(first)


def test_replace_keeps_the_rest(first):
    changed = first.replace(flow=np.zeros(3))
    assert [name for name, v in changed if v is getattr(first, name)] == []
    assert not changed.flow.any()
    assert all(np.array_equal(v, getattr(first, n)) for n, v in changed if n != "flow")


def test_iteration_is_in_the_order_of_the_stages(first):
    assert [name for name, _ in first] == list(STAGES)


@pytest.mark.parametrize("stage", STAGES)
def test_check_names_stage_and_lengths(first, stage):
    first.check(SMALL, 7, 6)
    size = getattr(first, stage).size
    wrong = first.replace(**{stage: np.zeros(size + 1)})
    with pytest.raises(
        InputError, match=rf"{stage} parameters have {size + 1} numbers, but {size} are needed"
    ):
        wrong.check(SMALL, 7, 6)
    empty = first.replace(**{stage: np.empty(0)})
    if stage in PRESSURE_STAGES:
        empty.check(SMALL, 7, 6)
    else:
        with pytest.raises(InputError, match=f"{stage} parameters have 0 numbers"):
            empty.check(SMALL, 7, 6)


def test_check_finds_another_grid(first):
    with pytest.raises(InputError, match="8 time points, 6 points"):
        first.check(SMALL, 8, 6)
