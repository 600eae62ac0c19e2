"""``pcnde convert``."""

from __future__ import annotations

import numpy as np
import pytest
from io_helpers import at_times, centerline, results_of

from pcnde_bridge import Cases


def test_convert(small_cases, tmp_path, run_pcnde):
    chosen = {i: results_of(small_cases, i) for i in (0, 4, 5)}
    for i, each in chosen.items():
        centerline(
            tmp_path / f"{i}.vtp", at_times(each, np.arange(21) / 20),
            steps=range(21), suffix="{:05d}".format,
        )  # fmt: skip
    files = [tmp_path / f"{i}.vtp" for i in chosen]
    table = tmp_path / "labels.csv"
    table.write_text("file,waveform,geometry\n5.vtp,1,2\n0.vtp,0,1\n4.vtp,0,2\n")
    out = tmp_path / "mine.h5"
    code, printed, err = run_pcnde(
        "convert", *files, "--from", "simvascular", "--time-step", 0.05, "--period", 1,
        "--points", 41, "--time-points", 32, "--labels", table, "--out", out,
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "Saved Cases(3 cases: 2 geometries, 2 waveforms; 32 time points over 1 s" in printed
    found = Cases.load(out)
    assert (found.n_times, found.n_points) == (32, 41)
    np.testing.assert_allclose(found.flow[:, :, 0][:, ::8], small_cases.inflow[[0, 4, 5], ::5])
    found.select([0]).save(tmp_path / "one.h5")
    options = ["--out", tmp_path / "again.npz", "--flip", "flow", "--units", "pressure=dyn/cm^2"]
    code, _, err = run_pcnde("convert", tmp_path / "one.h5", "--from", "hdf5", *options)
    assert code == 2
    assert "runs against z" in err
    code, _, _ = run_pcnde(
        "convert", tmp_path / "one.h5", "--from", "hdf5", "--names", "flow=flow,z=z",
        "--out", tmp_path / "again.npz",
    )  # fmt: skip
    assert code == 0
    assert Cases.load(tmp_path / "again.npz") == found.select([0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--from", "csv", "--branch", "1"],
            "--branch is an option of --from simvascular, not of csv",
        ),
        (
            ["--from", "hdf5", "--segments", "a"],
            "--segments is an option of --from sv1d, not of hdf5",
        ),
        (["--from", "hdf5", "--names", "flow"], "--names must look like flow="),
        (["--from", "sv1d", "--units", "z="], "--units must look like flow="),
        (["--from", "openfoam"], "--from"),
        ([], "--from"),
    ],
)
def test_convert_refuses_wrong_options(tmp_path, run_pcnde, options, message):
    out = tmp_path / "mine.h5"
    code, printed, err = run_pcnde("convert", tmp_path / "a", *options, "--out", out)
    assert (code, printed) == (2, "")
    assert message in err
    assert list(tmp_path.iterdir()) == []
