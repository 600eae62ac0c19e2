from __future__ import annotations

import os
import signal
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    ToyEngine,
    case_arguments,
    fit_physics,
    made_by_the_closures,
    skip_without_julia,
)
from hypothesis import settings

from pcnde_bridge.cli import main as cli
from pcnde_bridge.config import PAPER, PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import DataNotFoundError
from pcnde_bridge.io.datasets import find_published, load_cases
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction

# The same examples each time in the suite; HYPOTHESIS_PROFILE=long tries others, and many.
settings.register_profile("suite", max_examples=25, derandomize=True, deadline=None)
settings.register_profile("long", max_examples=2000, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "suite"))

# JAX compiles what the suite's processes share once. The workers inherit the first one's folder.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _compiled = tempfile.TemporaryDirectory(prefix="pcnde-compiled-")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _compiled.name
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.05")
# Functions with diffrax's checks of its arguments, which are callbacks, could not be stored.
os.environ.setdefault("EQX_ON_ERROR", "off")


def pytest_runtest_setup(item):
    if item.get_closest_marker("julia"):
        skip_without_julia()


# Background jobs of a shell ignore Ctrl-C, and so do their child processes.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def small_cases() -> Cases:
    """3 geometries × 4 waveforms, 20 time points, 21 points; smooth, by formula."""
    rng = np.random.default_rng(20241108)
    time = np.arange(20) / 20
    z = np.linspace(0.0, 4.0, 21)
    blockage = np.array([0.4, 0.5, 0.6])
    scale = np.array([0.0, 0.5, 1.0, 1.5])
    bump = np.exp(-(((z - 2.0) / 0.4) ** 2))
    amplitude = rng.uniform(0.05, 0.2, size=3)[:, None]
    phase = rng.uniform(0.0, 2 * np.pi, size=3)[:, None]
    harmonic = np.arange(1, 4)[:, None]
    wave = (amplitude * np.cos(2 * np.pi * harmonic * time + phase)).sum(axis=0)

    geometry, waveform = (grid.ravel() for grid in np.meshgrid([1, 2, 3], range(4), indexing="ij"))
    area_undeformed = 0.125 * (1.0 - blockage[geometry - 1, None] * bump)
    inflow = 1.2 + scale[waveform, None] * wave
    damping = 1.0 - 0.02 * scale[waveform, None, None] * z / z[-1]
    flow = inflow[:, :, None] * damping
    drop = 4e2 * blockage[geometry - 1, None, None] * (1 - np.tanh(3 * (z - 2))) * flow
    pressure = 1.09e5 * flow[:, :, -1:] + drop
    area = area_undeformed[:, None, :] * (1 + pressure / 4.9e6) ** 2
    return Cases(
        flow,
        area,
        pressure,
        area_undeformed,
        time,
        z,
        period=1.0,
        labels={
            "geometry": geometry,
            "waveform": waveform,
            "blockage": blockage[geometry - 1],
            "patient": [f"patient {g}" for g in geometry],
        },
    )


@pytest.fixture(scope="session")
def sheared_cases(small_cases) -> Cases:
    """The same with a wall shear stress, which is negative at the end of the strongest cases."""
    stress = 1.2 * small_cases.poiseuille_wall_shear_stress()
    stress[3::4, :3, -2:] *= -1
    return Cases(**case_arguments(small_cases, wall_shear_stress=stress))


@pytest.fixture(scope="session")
def other_period(small_cases) -> Cases:
    """The same numbers in a shorter cycle: only the grid differs."""
    arrays = {name: getattr(small_cases, name) for name in ("flow", "area", "pressure")}
    return Cases(
        **arrays,
        area_undeformed=small_cases.area_undeformed,
        time=0.8 * small_cases.time,
        z=small_cases.z,
        period=0.8,
        labels=small_cases.labels,
    )


@pytest.fixture(scope="session")
def published_folder() -> Path:
    """Folder of the authors' data set; skips where it is not on this machine."""
    try:
        folder = find_published()
    except DataNotFoundError as error:
        pytest.skip(str(error))
    if folder is None:
        pytest.skip("the published data set is not on this machine (set PCNDE_DATA)")
    return folder


@pytest.fixture(scope="session")
def published_cases(published_folder: Path) -> Cases:
    return load_cases(published_folder)


@pytest.fixture(scope="session")
def small_config() -> PCNDEConfig:
    """The paper's training, shortened: two couplings, two batches of one compiled shape."""
    return PAPER.replace(
        batch_size=6,
        coupling_passes=2,  # compiled one after the other
        flow={"epochs": 4, "couple_every": 2, "iterations": 3},
        intermediate_area={"iterations": 3},
        fourier_area={"iterations": 3},
        temporal_pressure={"iterations": 8},
        spatial_pressure={"iterations": 6},
    )


@pytest.fixture(scope="session")
def small_split() -> dict[str, list[list[int]]]:
    """Eleven cases for training, so that the last batch is smaller, and one for test."""
    train = [[g, w] for g in (1, 2, 3) for w in range(4) if (g, w) != (2, 1)]
    return {"train": train, "test": [[2, 1]]}


@pytest.fixture(scope="session")
def small_model(small_cases, small_config, small_split) -> PCNDE:
    """Model fitted by the JAX engine; tests of these shapes reuse its compiled functions."""
    train = small_cases.split(small_split).train
    return PCNDE.fit(train, small_config, engine="jax", seed=0, progress=False)


@pytest.fixture
def toy_engine() -> ToyEngine:
    return ToyEngine()


@pytest.fixture(scope="session")
def toy_config(small_config) -> PCNDEConfig:
    """As ``small_config``, with batches of 5, so that the last of 12 cases has 2."""
    return small_config.replace(batch_size=5)


@pytest.fixture(scope="session")
def physics_cases() -> Cases:
    """4 geometries × 4 waveforms, computed by the closures themselves."""
    return made_by_the_closures()


@pytest.fixture(scope="session")
def physics_records() -> list:
    """Iterations of the fit of ``physics_model``."""
    return []


@pytest.fixture(scope="session")
def physics_model(physics_cases, physics_records) -> PCNDE:
    """Small model of the preset ``physics``."""
    return fit_physics(physics_cases, progress=physics_records.append)


@pytest.fixture(scope="session")
def physics_prediction(physics_model, physics_cases) -> Prediction:
    """Prediction of the training cases with samples."""
    return physics_model.predict(physics_cases, samples=12, seed=3)


@pytest.fixture
def run_pcnde(monkeypatch, capsys):
    """Run ``pcnde`` in this process: exit code, standard output, standard error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["pcnde", *map(str, arguments)])
        capsys.readouterr()
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return code, out, err

    return run


@pytest.fixture
def commands(small_cases, config, engine, tmp_path, monkeypatch, run_pcnde):
    """Run ``pcnde`` in this process, with the fixtures ``config`` and ``engine`` of the file."""
    from pcnde_bridge._utils import parallel
    from pcnde_bridge.model import fit_task, pcnde, predictor

    for module in (fit_task, pcnde, predictor):
        monkeypatch.setattr(module, "select_engine", lambda *_, **__: engine)
    monkeypatch.setattr(parallel, "processes", lambda workers: None)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engine.flow, "fits", [])
    small_cases.save("cases.npz")
    (tmp_path / "config.json").write_text(config.to_json())
    options = ("--split", "none", "--config", "config.json")
    return lambda name, *more: run_pcnde(name, "cases.npz", *options, *more)


class _Dying:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)


@pytest.fixture
def drop_ctrl_c():
    """Press Ctrl-C in ``__del__``, where Python drops the exception."""

    def drop() -> None:
        dying = _Dying()
        del dying

    return drop
