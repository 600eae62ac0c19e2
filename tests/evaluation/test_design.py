"""Designs of few simulations, and the files for them."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import Cases, InputError
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.evaluation import design
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.waveform import coronary
from pcnde_bridge.io import read_labels
from pcnde_bridge.io.input_tables import read_candidates, read_cycle

BLOCKAGES = (0.4, 0.5, 0.6, 0.7, 0.8)
FACTORS = (0.5, 0.75, 1.0, 1.25, 1.5)


@pytest.fixture(scope="module")
def arrays():
    grid = Grid(np.arange(50) / 50, np.linspace(0, 4, 81), 1.0)
    inflow = np.stack([coronary().scaled(factor).samples(50) for factor in FACTORS])
    area = np.stack([Vessel((Stenosis(b),)).area_undeformed(grid.z) for b in BLOCKAGES])
    return inflow, area, grid


@pytest.fixture(scope="module")
def candidates(arrays):
    return design.all_pairs(*arrays)


def test_all_pairs_have_every_vessel_with_every_inflow(arrays, candidates):
    inputs, labels = candidates
    assert len(inputs.inflow) == len(inputs.area_undeformed) == len(labels) == 25
    assert labels.loc[7].tolist() == [2, 3]
    assert np.array_equal(inputs.inflow[7], arrays[0][2])
    assert np.array_equal(inputs.area_undeformed[7], arrays[1][1])


def test_units_are_converted_and_implausible_candidates_are_refused(arrays):
    inflow, area, grid = arrays
    millimeters = 1e3 * inflow, 1e2 * area, Grid(grid.time, 10 * grid.z, grid.period)
    expected, _ = design.all_pairs(*arrays)
    found, _ = design.all_pairs(*millimeters, units="mm-g-s")
    assert found.inflow == pytest.approx(expected.inflow)
    assert found.area_undeformed == pytest.approx(expected.area_undeformed)
    assert found.grid.z == pytest.approx(grid.z)
    with pytest.raises(InputError, match="unit"):
        design.all_pairs(*millimeters)
    with pytest.raises(InputError, match=r"mean inflow of case 0, .* is negative"):
        design.all_pairs(-inflow, area, grid)


def test_corners_come_first_and_then_the_middle(candidates):
    inputs, labels = candidates
    chosen = design.choose(inputs, 6)
    pairs = [tuple(labels.loc[case]) for case in chosen["case"]]
    assert set(pairs[:4]) == {(1, 1), (1, 5), (5, 1), (5, 5)}
    assert 2 <= pairs[4][0] <= 4
    assert 2 <= pairs[4][1] <= 4
    assert (chosen["uncovered"].diff().dropna() <= 0).all()
    assert chosen["uncovered"].iloc[-1] < 0.6
    assert chosen["reason"][0] == "one end of the longest distance"
    assert "blockage" in " ".join(chosen["reason"])
    assert "amplitude" in " ".join(chosen["reason"])
    blocked = 1 - inputs.area_undeformed.min(axis=1) / np.median(inputs.area_undeformed, axis=1)
    np.testing.assert_allclose(chosen["blockage"], blocked[chosen["case"]])


def test_finished_simulations_are_not_chosen_again(candidates):
    inputs, _ = candidates
    first = design.choose(inputs, 6)
    rest = design.choose(inputs, 3, done=first["case"][:3].tolist())
    assert rest["case"].tolist() == first["case"][3:].tolist()
    everything = design.choose(inputs, 25)
    assert sorted(everything["case"]) == list(range(25))
    assert everything["uncovered"].iloc[-1] == 0


@pytest.mark.parametrize("share, points", [(1.0, 1001), (0.95, 41)])
def test_swapped_labels_are_found_on_any_grid(candidates, share, points):
    """The same vessels and inflows, with less flow than prescribed, are not another candidate."""
    inputs, labels = candidates
    grid = Grid(np.arange(60) / 60, np.linspace(0, 4, points), 1.0)
    inflow = np.stack([share * coronary().scaled(factor).samples(60) for factor in FACTORS])
    area = np.stack([Vessel((Stenosis(b),)).area_undeformed(grid.z) for b in BLOCKAGES])
    finished, _ = design.all_pairs(inflow, area, grid)
    assert design.confused(inputs, range(25), finished) == []
    for name in "geometry", "waveform":
        swapped = labels.assign(**{name: 6 - labels[name]})  # the third is in its place
        own = (5 * (swapped["geometry"] - 1) + swapped["waveform"] - 1).tolist()
        expected = [(case, case) for case in range(25) if own[case] != case]
        assert design.confused(inputs, own, finished) == expected


def test_quantities_without_meaning_are_not_compared(arrays):
    """Steady flows have no frequency, straight vessels no stenosis, and no mean is exactly 0."""
    inflow, _, grid = arrays
    steady = np.full((1, 50), 1.0)
    around_zero = inflow - inflow.mean(axis=1, keepdims=True)
    area = np.stack([Vessel(diameter=d).area_undeformed(grid.z) for d in (0.3, 0.4)])
    for waves in (steady, around_zero):
        inputs, labels = design.all_pairs(waves, area, grid, "cgs")
        noise = 1e-4 * np.random.default_rng(0).standard_normal(inputs.inflow.shape)
        finished = inputs._replace(inflow=inputs.inflow + noise)
        cases = range(len(labels))
        assert design.confused(inputs, cases, finished) == []
        assert len(design.confused(inputs, cases[::-1], finished)) == len(labels)


def test_equal_candidates_can_be_chosen(candidates):
    inputs, _ = candidates
    equal = inputs._replace(
        inflow=inputs.inflow[[0, 0, 0]], area_undeformed=inputs.area_undeformed[[0, 0, 0]]
    )
    chosen = design.choose(equal, 3)
    assert chosen["case"].tolist() == [0, 1, 2]
    assert chosen["reason"].tolist()[1:] == 2 * ["same quantities as a chosen case"]
    assert (chosen["uncovered"] == 0).all()


def test_thousands_of_candidates_need_little_memory(candidates):
    """No array has a number for each pair of candidates."""
    inputs, labels = candidates
    rows = np.arange(4000) % len(labels)
    inflow = inputs.inflow[rows] * np.linspace(1.0, 1.2, 4000)[:, None]
    many = inputs._replace(inflow=inflow, area_undeformed=inputs.area_undeformed[rows])
    tracemalloc.start()
    chosen = design.choose(many, 3)
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(chosen) == 3
    assert used < 8 * 4000**2 / 2


def test_the_design_covers_what_the_model_is_used_for(candidates):
    inputs, labels = candidates
    weak = np.flatnonzero(labels["waveform"] == 1)
    use = inputs._replace(inflow=inputs.inflow[weak], area_undeformed=inputs.area_undeformed[weak])
    chosen = design.choose(inputs, 3, use=use)
    assert (labels.loc[chosen["case"], "waveform"] == 1).all()


@pytest.mark.parametrize("count, done", [(0, []), (26, []), (24, [1, 2]), (1, [25]), (1, [3, 3])])
def test_impossible_designs_are_refused(candidates, count, done):
    with pytest.raises(InputError, match=r"cannot be chosen|count|different positions"):
        design.choose(candidates[0], count, done=done)


def test_the_input_of_the_simulations_can_be_read_again(arrays, candidates, tmp_path):
    inputs, labels = candidates
    chosen = design.choose(inputs, 4)
    design.write_inputs(tmp_path, inputs, labels, chosen)
    period, columns = read_cycle(tmp_path / "inflow_5.flow", 0.0, 1.0)
    assert period == 1.0
    assert np.allclose(columns.to_numpy()[:, 0], arrays[0][4], atol=1e-12)
    first = np.loadtxt(tmp_path / "inflow_5.flow")[0]
    assert first == pytest.approx([0, -arrays[0][4, 0]])  # negative into the vessel
    vessel = pd.read_csv(tmp_path / "vessel_1.csv")
    assert np.allclose(vessel["area"], arrays[1][0])
    table = pd.read_csv(tmp_path / "design.csv")
    files = [f"G{g}_W{w}.vtp" for g, w in zip(table["geometry"], table["waveform"], strict=True)]
    taken = read_labels(tmp_path / "labels.csv", files)
    assert taken[["geometry", "waveform"]].equals(table[["geometry", "waveform"]])


def test_expected_errors_are_those_of_the_samples(physics_model, physics_cases):
    use = design.ModelInputs(
        physics_cases.inflow, physics_cases.area_undeformed, physics_cases.grid
    )
    errors = design.expected_errors(physics_model, use, samples=16)
    assert errors.index.tolist() == ["flow", "area", "pressure", "pressure_drop"]
    assert (errors["expected"] <= errors["upper"]).all()
    assert (errors > 0).all(axis=None)
    assert (errors < 1).all(axis=None)
    with pytest.raises(InputError, match="no samples"):
        design.expected_errors(physics_model, use, samples=0)


def write_tables(folder, inflow, area, grid):
    waves = pd.DataFrame(inflow.T, index=pd.Index(grid.time, name="time"))
    vessels = pd.DataFrame(area.T, index=pd.Index(grid.z, name="z"))
    waves.to_csv(folder / "inflow.csv")
    vessels.to_csv(folder / "area.csv")
    return "--inflow", folder / "inflow.csv", "--area", folder / "area.csv"


def test_command(arrays, tmp_path, run_pcnde):
    given = write_tables(tmp_path, *arrays)
    inflow, area, grid = read_candidates(given[1], given[3])
    assert np.allclose(inflow, arrays[0])
    assert np.allclose(area, arrays[1])
    assert grid.period == pytest.approx(1.0)
    code, out, _ = run_pcnde("design", *given, "--out", tmp_path / "runs", "--count", 5)
    assert code == 0
    assert out.count("geometry ") == 5
    assert len(pd.read_csv(tmp_path / "runs" / "labels.csv")) == 5


def test_command_with_finished_simulations(physics_cases, tmp_path, run_pcnde):
    """Further simulations are chosen, and the errors of a model of the finished ones estimated."""
    geometry, waveform = (
        physics_cases.labels[name].rank(method="dense").astype(int).to_numpy()
        for name in ("geometry", "waveform")
    )
    arrays = physics_cases.inflow[geometry == 1], physics_cases.area_undeformed[waveform == 1]
    given = write_tables(tmp_path, *arrays, physics_cases.grid)
    names = (*VARIABLES, "area_undeformed", "time", "z")
    fields = {name: getattr(physics_cases, name) for name in (*names, "period")}
    cases = Cases(**fields, labels={"geometry": geometry, "waveform": waveform})
    other = Cases(**fields, labels={"geometry": geometry + 4, "waveform": waveform})
    other.save(tmp_path / "other.npz")
    other_done = "--done", tmp_path / "other.npz"
    code, _, err = run_pcnde("design", *given, "--out", tmp_path / "runs", *other_done)
    assert code == 2
    assert "other.npz has the cases (geometry, waveform) (5, 1), " in err
    assert "1 to 4: label the simulations so" in err
    swapped = Cases(**fields, labels={"geometry": geometry, "waveform": 5 - waveform})
    swapped.select(slice(0, 12)).save(tmp_path / "other.npz")
    code, _, err = run_pcnde("design", *given, "--out", tmp_path / "runs", *other_done)
    assert code == 2
    assert "case (geometry, waveform) (1, 4)" in err
    assert "those of (1, 1): correct the labels" in err
    cases.select(slice(0, 12)).save(tmp_path / "done.npz")
    done = "--done", tmp_path / "done.npz"
    code, out, _ = run_pcnde("design", *given, "--out", tmp_path / "runs", "--count", 2, *done)
    assert code == 0
    finished = {(g, w) for g, w in zip(geometry[:12], waveform[:12], strict=True)}
    table = pd.read_csv(tmp_path / "runs" / "design.csv")
    assert not finished & set(zip(table["geometry"], table["waveform"], strict=True))
    assert "estimated error" in out
    assert "pressure_drop" in out or "drop" in out
    code, _, err = run_pcnde("design", *given, "--out", tmp_path / "runs", "--count", 5, *done)
    assert code == 2
    assert "4 of 16 candidates are left" in err
    cases.select(slice(0, 3)).save(tmp_path / "done.npz")
    code, out, _ = run_pcnde("design", *given, "--out", tmp_path / "runs", "--count", 2, *done)
    assert code == 0
    assert "needs at least four finished simulations" in out
