"""Cross-validation with fits that need no compiling, in Python and on the command line."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers import FailingEngine, ToyEngine, interrupt_at

from pcnde_bridge import PCNDE, InputError, SolveError, cross_validate, sweep
from pcnde_bridge._utils.parallel import processes
from pcnde_bridge.data.splits import each_waveform_and_geometry
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io.tables import read_frame

NUMBERS = ["flow", "area", "pressure", "train_flow", "train_area", "train_pressure"]


@pytest.fixture(scope="module")
def engine():
    return ToyEngine()


@pytest.fixture(scope="module")
def config(toy_config):
    return toy_config.replace(flow={"epochs": 2, "couple_every": 1})


def test_parts_are_whole_waveforms_and_geometries(small_cases):
    found = each_waveform_and_geometry(small_cases)
    assert list(found) == [("waveform", k) for k in range(4)] + [("geometry", k) for k in (1, 2, 3)]
    for (label, value), positions in found.items():
        chosen = small_cases.labels[label] == value
        assert positions.tolist() == np.flatnonzero(chosen).tolist()
    with pytest.raises(InputError, match="nothing can be held out"):
        each_waveform_and_geometry(small_cases.select([0]))


def test_cross_validation(small_cases, config, engine, tmp_path):
    table = cross_validate(small_cases, config, engine, 3, folder=tmp_path, progress=False)
    assert table.index.names == ["label", "value"]
    assert table["cases"].tolist() == [3] * 4 + [4] * 3
    assert table["failure"].isna().all()
    held = small_cases.select(waveform=[2])
    rest = small_cases.select(waveform=[0, 1, 3])
    model = PCNDE.fit(rest, config, engine, 3, progress=False)
    row = table.loc[("waveform", 2)]
    errors = [model.evaluate(cases).iloc[-1][list(VARIABLES)] for cases in (held, rest)]
    assert row[NUMBERS].tolist() == [*errors[0], *errors[1]]
    assert row["pressure_drop"] == model.evaluate(held).iloc[-1]["pressure_drop"]
    assert table["wall_shear_stress"].isna().all()
    parallel = cross_validate(small_cases, config, engine, 3, executor=processes(2), progress=False)
    assert parallel[NUMBERS].equals(table[NUMBERS])
    again = cross_validate(
        small_cases, config, engine, np.int64(3), folder=tmp_path, progress=False
    )
    pd.testing.assert_frame_equal(again, table)
    with pytest.raises(InputError, match="seed must be a whole number ≥ 0, got -1"):
        cross_validate(small_cases, config, engine, -1)


def test_a_fit_that_fails_has_a_row_with_its_reason(small_cases, config):
    engine = FailingEngine({0})
    table = cross_validate(small_cases, config, engine, retries=0, progress=False)
    assert table["failure"].iloc[0] == "OSError: lost"
    assert table[NUMBERS].iloc[0].isna().all()
    assert table["failure"].iloc[1:].isna().all()
    assert table[NUMBERS].iloc[1:].notna().all(axis=None)


def test_tables_have_all_columns_if_fits_fail(small_cases, config, engine):
    broken = FailingEngine(set(range(99)))
    lost = cross_validate(small_cases, config, broken, retries=0, progress=False)
    assert lost["failure"].notna().all()
    assert lost[NUMBERS].isna().all(axis=None)
    assert lost[["seconds", "cases"]].notna().any().tolist() == [False, True]
    found = cross_validate(small_cases, config, engine, progress=False)
    assert list(lost) == list(found)
    assert lost.dtypes[:-1].equals(found.dtypes[:-1])
    lost = sweep(small_cases, None, {"a": config}, (0, 1), broken, retries=0, progress=False)
    found = sweep(small_cases, None, {"a": config}, (0, 1), engine, progress=False)
    assert list(lost) == list(found)
    assert "train_flow" in found
    assert "flow" not in found


def test_cross_validation_on_the_command_line(commands, small_cases, config, engine):
    code, printed, _ = commands("cross-validate", "--csv", "table.csv", "--folder", "kept")
    assert code == 0
    table = cross_validate(small_cases, config, engine, progress=False)
    for name in ("pressure", "one_minus_ffr"):
        assert f"{table.loc[('geometry', 2), name]:.4f}" in printed
    assert "WSS" not in printed
    assert "mean, waveform" in printed
    written = read_frame("table.csv", index_col=["label", "value"])
    np.testing.assert_array_equal(written[NUMBERS], table[NUMBERS])


def test_a_cross_validation_that_is_interrupted_names_its_folder(commands, engine, monkeypatch):
    interrupt_at(engine, monkeypatch, 8)
    code, _, err = commands("cross-validate", "--folder", "kept")
    assert code == 130
    assert "The finished fits are in kept: run the same command again" in err
    code, printed, _ = commands("cross-validate", "--folder", "kept")
    assert code == 0
    assert "mean, geometry" in printed


def test_a_cross_validation_without_any_result_is_a_failure(commands, engine, monkeypatch):
    def lost(*args):
        raise SolveError("It diverges.")

    monkeypatch.setattr(engine.flow, "fit", lost)
    code, printed, err = commands("cross-validate")
    assert code == 1
    assert "geometry 2: It diverges." in printed
    assert "All fits failed" in err
