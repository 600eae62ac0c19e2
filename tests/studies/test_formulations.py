"""Formulations of the momentum equation in space and in time."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import plots
from pcnde_bridge.errors import InputError
from pcnde_bridge.studies import compare_formulations
from pcnde_bridge.studies.formulations import variation


@pytest.fixture(scope="module")
def formulations(small_cases, short_config):
    seen = []
    found = compare_formulations(
        small_cases,
        small_cases.select([0, 7]),
        config=short_config,
        engine="jax",
        progress=seen.append,
    )
    # Two batches, two epochs, two iterations each.
    assert len(seen) == 3 * 8 == len(found.history)
    return found


def test_formulations_side_by_side(formulations, small_cases):
    frame = formulations.to_frame().set_index(["formulation", "set"])
    assert len(frame) == 4 * 2
    truth = frame.loc[("truth", "train")]
    assert truth["flow_error"] == truth["slope_error"] == 0
    assert truth["slope_variation"] == 1
    spatial = formulations.results["spatial", "train"]
    np.testing.assert_array_equal(spatial.flow[:, :, 0], small_cases.inflow)
    for name in ("temporal", "temporal_with_time"):
        found = formulations.results[name, "test"]
        np.testing.assert_array_equal(found.flow[:, :, 0], small_cases.inflow[[0, 7]])
        np.testing.assert_array_equal(found.flow[:, 0], small_cases.flow[[0, 7], 0])
        assert formulations.outcomes[name] == "trained"
    sizes = [
        formulations.history.query("formulation == @name")["loss"].to_numpy()[[0, -1]]
        for name in ("spatial", "temporal", "temporal_with_time")
    ]
    assert all(last < first for first, last in sizes)


def test_continuity_is_solved_after_the_flow(formulations, small_cases):
    found = formulations.results["temporal", "train"]
    slope = np.gradient(found.flow, small_cases.z, axis=2, edge_order=2)
    cycle = np.concatenate([slope] * 3, axis=1)
    rise = (cycle[:, 1:] + cycle[:, :-1]) / 2 / small_cases.n_times
    area = small_cases.area_undeformed[:, None] - np.cumsum(rise, axis=1)
    np.testing.assert_allclose(found.continuity_area, area[:, -20:], rtol=1e-9)


def test_variation_is_total_variation_along_z():
    z = np.linspace(0, 1, 11)
    assert variation(np.broadcast_to(z, (2, 3, 11))) == pytest.approx(1)
    assert variation(np.broadcast_to(np.abs(z - 0.5), (2, 3, 11))) == pytest.approx(1)
    assert variation(np.ones((2, 3, 11))) == 0


def test_formulations_need_one_grid(small_cases, other_period):
    with pytest.raises(InputError, match=r"is 0\.76 in the cases but 0\.95 in"):
        compare_formulations(small_cases, other_period)


def test_formulations_need_known_names(small_cases):
    with pytest.raises(InputError, match="tempral"):
        compare_formulations(small_cases, formulations=("tempral",), engine="jax")
    with pytest.raises(InputError, match="at least one formulation"):
        compare_formulations(small_cases, formulations=())
    with pytest.raises(InputError, match="seed must be a whole number"):
        compare_formulations(small_cases, seed=-1)


def test_smoothness_shows_the_study(formulations):
    figure = plots.smoothness(formulations, "test", case=1, truth_label="1D solver")
    assert [text.get_text() for text in figure.legends[0].texts][:2] == [
        "1D solver",
        "in space, $f(Q, S)$",
    ]
    assert len(figure.axes) == 6
    lines = figure.axes[1].get_lines()
    assert len(lines) == 4
    peak = formulations.cases["test"].inflow[1].argmax()
    np.testing.assert_array_equal(
        lines[1].get_ydata(), formulations.results["spatial", "test"].slope[1, peak]
    )
    with pytest.raises(InputError, match="case 2 must be one of the 2 cases"):
        plots.smoothness(formulations, "test", case=2)
    with pytest.raises(InputError, match="from 0 to 1"):
        plots.smoothness(formulations, "test", position=1.5)
