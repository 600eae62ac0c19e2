from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcnde_bridge.cases import Cases
from pcnde_bridge.datasets import find_published, load_cases
from pcnde_bridge.errors import DataNotFoundError


@pytest.fixture(scope="session")
def small_cases() -> Cases:
    """3 geometries × 4 waveforms, 20 instants, 21 points; smooth, by formula."""
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
    drop = 4e3 * blockage[geometry - 1, None, None] * (1 - np.tanh(3 * (z - 2))) * flow
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
