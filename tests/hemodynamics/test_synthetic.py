"""The synthetic data set, its cache, and ``pcnde simulate``."""

from __future__ import annotations

import logging
import sys
import warnings

import numpy as np
import pytest

from pcnde_bridge import (
    Cases,
    InputError,
    SolveError,
    load_cases,
)
from pcnde_bridge.hemodynamics.outlet import Windkessel
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.synthetic import (
    OUTLET_RESISTANCE,
    base_waveform,
    synthetic,
)
from pcnde_bridge.hemodynamics.waveform import DATA_FACTORS, coronary

# The package exports the function under the name of its module.
module = sys.modules[synthetic.__module__]

TUBE = Tube1D(n_times=20, steps=100)
SMALL = {"n_points": 81, "tube": TUBE, "progress": False}


@pytest.fixture(scope="module")
def cases() -> Cases:
    return synthetic(2, 3, cache=False, **SMALL)


@pytest.fixture
def solved(monkeypatch, cases):
    """Count the computations, each of which gives the same cases."""
    calls = []

    def solve(*arguments):
        calls.append(arguments)
        return cases

    monkeypatch.setattr(module, "_solve", solve)
    return calls


def test_every_geometry_under_every_waveform(cases):
    labels = cases.labels
    assert labels["geometry"].tolist() == [1, 1, 1, 2, 2, 2]
    assert labels["waveform"].tolist() == [0, 1, 2, 0, 1, 2]
    np.testing.assert_allclose(labels["blockage"], [0.40] * 3 + [0.85] * 3)
    np.testing.assert_allclose(labels["factor"], [-0.5, 0.625, 1.75] * 2)
    assert (len(cases), cases.n_times, cases.n_points) == (6, 20, 81)
    throat = cases.area_undeformed.min(axis=1) / cases.area_undeformed[:, 0]
    np.testing.assert_allclose(throat, 1 - labels["blockage"], rtol=1e-12)
    base = coronary()
    for i, factor in enumerate(labels["factor"]):
        np.testing.assert_allclose(cases.inflow[i], base.scaled(factor).samples(20), atol=1e-12)


def test_physics_is_that_of_the_solver(cases):
    outlet = cases.pressure[:, :, -1] / cases.flow[:, :, -1]
    np.testing.assert_allclose(outlet, OUTLET_RESISTANCE, rtol=1e-9)
    assert cases.labels["periodicity"].max() < 1e-6
    assert cases.labels["volume_balance"].max() < 1e-10
    drop = (cases.pressure[:, :, 0] - cases.pressure[:, :, -1]).mean(axis=1)
    assert drop[3:].min() > 5 * drop[:3].max()  # 85 % against 40 %


def test_the_papers_numbers_and_split(solved):
    synthetic(cache=False, progress=False)
    tube, vessels, waveforms, outlet, factors, n_points, _ = solved[0]
    assert outlet == Windkessel(OUTLET_RESISTANCE)
    np.testing.assert_allclose([v.blockage for v in vessels], 0.4 + 0.05 * np.arange(10))
    assert factors == DATA_FACTORS
    assert waveforms == coronary().family()
    assert (tube.n_times, tube.cycles, n_points) == (100, 3, 101)
    assert tube.stenosis_loss == "paper"


def test_the_papers_split(cases):
    train, test = cases.split("paper")
    assert sorted(zip(test.labels["geometry"], test.labels["waveform"], strict=True)) == [
        (1, 2),
        (2, 0),
        (2, 1),
        (2, 2),
    ]
    assert len(train) == 2


def test_a_single_waveform_is_the_base_itself(solved):
    synthetic(1, 1, cache=False, progress=False)
    assert solved[0][2] == (coronary().scaled(1.0),)


def test_seed_gives_another_patient():
    first, again, other = base_waveform(1), base_waveform(1), base_waveform(2)
    assert base_waveform(0) == coronary()
    assert first == again
    assert first != other
    base = coronary().samples(100)
    for wave in (first, other):
        change = np.linalg.norm(wave.samples(100) - base) / np.linalg.norm(base)
        assert 0.01 < change < 0.3
        assert 0.8 < wave.mean / coronary().mean < 1.2


def test_same_seed_gives_the_same_bits(cases):
    again = synthetic(2, 3, cache=False, **SMALL)
    assert again == cases


def test_stenoses_moved_doubled_and_absent(solved):
    synthetic(2, 1, stenosis_positions=(1.5,), cache=False, progress=False)
    synthetic(2, 1, stenosis_positions=(1.0, 3.0), cache=False, progress=False)
    synthetic(1, 1, stenosis_positions=(), cache=False, progress=False)
    positions = [[s.position for s in call[1][0].stenoses] for call in solved]
    assert positions == [[1.5], [1.0, 3.0], []]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_geometries": 0}, "n_geometries must be a whole number ≥ 1"),
        ({"n_waveforms": 2.0}, "n_waveforms must be a whole number ≥ 1"),
        ({"seed": -1}, "seed must be a whole number ≥ 0"),
        ({"seed": True}, "seed must be a whole number ≥ 0"),
        ({"stenosis_positions": ()}, "all geometries are the same"),
        ({"stenosis_positions": (1.0, 1.2)}, "overlap"),
        ({"stenosis_positions": (0.1,)}, "outside the tube"),
        ({"n_points": 1}, "n_points"),
        ({"stenosis_positions": 2.0}, "stenosis_positions must have one axis"),
        ({"stenosis_positions": ("2",)}, "stenosis_positions must hold real numbers"),
    ],
)
def test_bad_arguments(arguments, message, tmp_path):
    with pytest.raises(InputError, match=message):
        synthetic(**arguments, cache=tmp_path, progress=False)
    assert list(tmp_path.rglob("*.npz")) == []


def test_all_vessels_are_checked_before_computing(monkeypatch):
    monkeypatch.setattr(
        "pcnde_bridge.hemodynamics.tr_bdf2.start", lambda *_: pytest.fail("it computed")
    )
    message = r"area_undeformed of case 0 \(geometry 10, waveform 0\) changes 2\.95-fold"
    with pytest.raises(InputError, match=message):
        synthetic(10, 2, n_points=35, cache=False, progress=False)


# ---- cache -----------------------------------------------------------------------


def test_computed_once_for_each_set_of_parameters(solved, tmp_path, cases):
    for _ in range(2):
        assert synthetic(2, 3, cache=tmp_path, **SMALL) == cases
    assert len(solved) == 1
    changes = [
        {"n_waveforms": 2},
        {"seed": 1},
        {"stenosis_positions": (1.5,)},
        {"n_points": 61},
        {"tube": Tube1D(n_times=20, steps=200)},
    ]
    for change in changes:
        synthetic(**{"n_geometries": 2, "n_waveforms": 3, **SMALL, **change}, cache=tmp_path)
    assert len(solved) == 1 + len(changes)
    assert len(list(tmp_path.rglob("*.npz"))) == 1 + len(changes)


def test_numpy_numbers_are_part_of_the_key_too(solved, tmp_path):
    tube = Tube1D(n_times=20, steps=100, viscosity=np.float32(0.04))
    synthetic(2, 3, cache=tmp_path, **{**SMALL, "tube": tube})
    assert len(list(tmp_path.rglob("*.npz"))) == 1


def test_new_data_version_is_computed_again(solved, tmp_path, monkeypatch):
    synthetic(2, 3, cache=tmp_path, **SMALL)
    monkeypatch.setattr(module, "DATA_VERSION", module.DATA_VERSION + 1)
    synthetic(2, 3, cache=tmp_path, **SMALL)
    assert len(solved) == 2


def test_damaged_cache_is_computed_again(solved, tmp_path, cases, caplog):
    synthetic(2, 3, cache=tmp_path, **SMALL)
    (file,) = tmp_path.rglob("*.npz")
    file.write_bytes(file.read_bytes()[:1000])
    with caplog.at_level(logging.WARNING, "pcnde_bridge"):
        assert synthetic(2, 3, cache=tmp_path, **SMALL) == cases
    assert "computed again" in caplog.text
    assert str(file) in caplog.text
    assert len(solved) == 2
    assert Cases.load(file) == cases


def test_unwriteable_cache_is_only_a_warning(solved, tmp_path, cases, caplog):
    (tmp_path / "synthetic").write_text("a file where the folder should be")
    with caplog.at_level(logging.WARNING, "pcnde_bridge"):
        assert synthetic(2, 3, cache=tmp_path, **SMALL) == cases
    assert "could not be stored in the cache" in caplog.text


def test_no_cache_caches_nothing(solved, tmp_path, monkeypatch):
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path))
    synthetic(2, 3, cache=False, **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_diverging_case_caches_nothing(tmp_path, monkeypatch):
    def diverge(*_):
        raise SolveError("Case 0 diverged at t = 0.1 s")

    monkeypatch.setattr(module, "_solve", diverge)
    with pytest.raises(SolveError):
        synthetic(2, 3, cache=tmp_path, **SMALL)
    assert list(tmp_path.rglob("*.npz")) == []


def test_known_by_name(solved, tmp_path, monkeypatch, cases):
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path))
    assert load_cases("synthetic") == cases
    assert load_cases("synthetic") == cases
    assert len(solved) == 1


def test_logs_one_line(caplog, cases):
    with caplog.at_level(logging.INFO, "pcnde_bridge"), warnings.catch_warnings():
        warnings.simplefilter("error")
        synthetic(2, 3, cache=False, **SMALL)
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("Computed 6 synthetic cases; periodicity ")


# ---- pcnde simulate --------------------------------------------------------------


@pytest.fixture
def run(monkeypatch, tmp_path, run_pcnde):
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path / "cache"))

    return run_pcnde


def test_simulate(run, solved, tmp_path, cases):
    file = tmp_path / "cases.h5"
    options = ("--geometries", 2, "--waveforms", 3, "--seed", 1)
    code, out, _ = run("simulate", "--out", file, *options)
    assert code == 0
    assert out.startswith(
        "Vessels: healthy diameter 4 mm, blockage 40% to 85%.\nSaved Cases(6 cases"
    )
    assert Cases.load(file) == cases
    tube, vessels, waveforms, *_ = solved[0]
    assert (len(vessels), len(waveforms), tube) == (2, 3, Tube1D())
    assert waveforms[0] == base_waveform(1).scaled(-0.5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", "cases.txt"), "must end in .npz or .h5"),
        (("--out", "absent/cases.npz"), "create it first"),
        (("--out", "cases.npz", "--geometries", 0), "--geometries"),
        ((), "--out"),
    ],
)
def test_simulate_refuses(run, solved, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, _, err = run("simulate", *arguments)
    assert code == 2
    assert message in err
    assert "Traceback" not in err
    assert solved == []
