"""The command line: results, messages and exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import PHYSICS_CONFIG

from pcnde_bridge import (
    PCNDE,
    Cases,
    OutsideTrainingWarning,
    PCNDEWarning,
    SolveError,
    __version__,
)
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge.cli import main
from pcnde_bridge.cli.console import (
    note,
    note_warning,
    say,
)
from pcnde_bridge.evaluation.benchmark import checkpoint_name
from pcnde_bridge.io.tables import read_frame


@pytest.fixture
def run(run_pcnde, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    return run_pcnde


def process(*arguments, **options):
    """Run ``python -m pcnde_bridge`` in a separate process."""
    return subprocess.run(
        [sys.executable, "-m", "pcnde_bridge", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        **options,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory, small_cases, small_config, small_split, small_model):
    """Folder of a user: cases, settings, a split, and a model fitted with them."""
    folder = tmp_path_factory.mktemp("cli")
    small_cases.save(folder / "cases.npz")
    changes = small_config.to_dict()
    (folder / "config.json").write_text(json.dumps(changes))
    (folder / "split.json").write_text(json.dumps(small_split))
    small_model.save(folder / "model.pcnde")
    for name, axis, values in (
        ("inflow.csv", ("time", small_cases.time), small_cases.inflow[:1]),
        ("area.csv", ("z", small_cases.z), small_cases.area_undeformed[:1]),
        ("inflows.csv", ("time", small_cases.time), small_cases.inflow),
    ):
        table = pd.DataFrame({axis[0]: axis[1]})
        for i, row in enumerate(values):
            table[f"case {i}"] = row
        table.to_csv(folder / name, index=False)
    return folder


@pytest.fixture(scope="module")
def fit_options(folder):
    return (
        *("--config", folder / "config.json"),
        *("--split", folder / "split.json"),
        *("--engine", "jax"),
    )


@pytest.mark.parametrize(
    ("command", "resistance", "words"),
    [
        (("fit", "--out", "new.npz"), [1e4, 2e4], "one outlet for all cases"),
        (("fit", "--out", "new.npz"), 1e4, "only the preset 'physics' takes one"),
        (("fit", "--out", "new.npz", "--members", "2"), 1e4, "only the preset 'physics' takes one"),
        (("cross-validate",), 1e4, "only the preset 'physics' takes one"),
        (("cross-validate",), "wide", "outlet.resistance must hold real numbers"),
    ],
)
def test_outlets_that_are_not_usable(folder, run, tmp_path, command, resistance, words):
    name, *options = command
    (tmp_path / "outlet.json").write_text(
        json.dumps({"kind": "Windkessel", "resistance": resistance})
    )
    preset = "fast" if resistance == 1e4 else "physics"
    given = "--engine", "jax", "--preset", preset, "--outlet", tmp_path / "outlet.json"
    code, _, err = run(name, folder / "cases.npz", *options, *given)
    assert code == 2
    assert words in err


# ---- in a separate process --------------------------------------------------


def test_its_own_process_stores_all_compiled_functions(monkeypatch):
    found = []
    monkeypatch.delenv("EQX_ON_ERROR")
    monkeypatch.setattr(main, "main", lambda: found.append(os.environ["EQX_ON_ERROR"]))
    main.run()
    assert found == ["off"]


def test_version_and_use():
    result = process("--version")
    assert (result.returncode, result.stdout.strip(), result.stderr) == (0, __version__, "")


def test_errors_have_no_traceback(folder, tmp_path):
    cut = tmp_path / "cut.pcnde"
    whole = (folder / "model.pcnde").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    result = process("evaluate", cut, folder / "cases.npz")
    assert result.returncode == 2
    assert result.stderr.startswith("Error: ")
    assert str(cut) in result.stderr
    assert "truncated" in result.stderr or "damaged" in result.stderr
    assert "Traceback" not in result.stdout + result.stderr
    assert result.stdout == ""


# A doctor in another process would load Julia, which may have to be compiled first.
WITHOUT_JULIA = dict.fromkeys(("PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"), "absent")


def test_a_closed_pipe_is_not_an_error(folder):
    """``pcnde … | head -0``: no traceback, and nothing at the interpreter's exit."""
    code = "import sys, pcnde_bridge.cli.main as c; sys.argv = ['pcnde', 'doctor']; c.main()"
    child = subprocess.Popen(
        [sys.executable, "-c", code],
        env=os.environ | WITHOUT_JULIA,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    child.stdout.close()
    err = child.stderr.read()
    child.wait()
    child.stderr.close()
    assert child.returncode == 1
    assert "Traceback" not in err
    assert "Exception ignored" not in err


def test_interrupted_by_ctrl_c_then_continued(folder, fit_options, tmp_path, run, small_model):
    """Send SIGINT after the first epoch to another process; resume here to the same bits."""
    out = tmp_path / "model.pcnde"
    checkpoint = tmp_path / "model.pcnde.checkpoint"
    arguments = ["fit", folder / "cases.npz", *fit_options, "--out", out]
    child = subprocess.Popen(
        [sys.executable, "-m", "pcnde_bridge", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 240
    while not _finished(checkpoint):
        assert child.poll() is None, child.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    printed, err = child.communicate(timeout=120)
    assert child.returncode == 130, err
    assert "Interrupted" in err
    assert str(checkpoint) in err
    assert "Traceback" not in printed + err
    assert not out.exists()
    assert _finished(checkpoint) < 12

    code, printed, err = run(*arguments)
    assert code == 0
    assert f"Continuing from {checkpoint}" in err
    assert f"Saved {out}" in printed
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert PCNDE.load(out, engine="jax").parameters == small_model.parameters


def _finished(checkpoint):
    if not checkpoint.exists():
        return 0
    return read_archive(checkpoint, "pcnde-checkpoint", 1, "checkpoint")[0]["finished"]


# ---- fit ------------------------------------------------------------------------


def test_fit(folder, fit_options, tmp_path, run, small_model, small_cases, small_split):
    out = tmp_path / "model.pcnde"
    code, printed, err = run("fit", folder / "cases.npz", *fit_options, "--out", out)
    assert code == 0
    assert "split.json has 11 training cases and 1 test case." in err
    loaded = PCNDE.load(out, engine="jax")
    assert loaded.parameters == small_model.parameters
    assert loaded.provenance["cases"] == 11
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    errors = small_model.evaluate(small_cases.split(small_split).test).iloc[-1]
    for value in errors:
        assert f"{value:.4f}" in printed
    assert f"Saved {out}" in printed


def test_fit_with_another_seed_and_a_named_checkpoint(
    folder, fit_options, tmp_path, run, small_model
):
    out, kept = tmp_path / "model.pcnde", tmp_path / "kept"
    arguments = ("fit", folder / "cases.npz", *fit_options, "--checkpoint", kept, "--out", out)
    assert run(*arguments, "--seed", 5)[0] == 0
    assert kept.exists()
    assert PCNDE.load(out, engine="jax").provenance["seed"] == 5
    assert PCNDE.load(out, engine="jax").parameters != small_model.parameters
    code, _, err = run(*arguments, "--seed", 6)
    assert code == 2
    assert "belongs to a run with seed 5, not 6" in err


def test_fit_refuses_bad_use_before_it_trains(folder, fit_options, tmp_path, run, monkeypatch):
    def train(*_, **__):
        raise AssertionError("training began")

    monkeypatch.setattr(PCNDE, "fit", train)
    cases, out = folder / "cases.npz", tmp_path / "m"

    def refused(*arguments):
        code, printed, err = run("fit", *arguments)
        assert (code, printed) == (2, "")
        return err

    assert "no_such_data" in refused("no_such_data", "--out", out)
    assert "Unknown preset 'papers'" in refused(cases, "--preset", "papers", "--out", out)
    assert "nowhere.json" in refused(cases, "--split", "nowhere.json", "--out", out)
    assert "nowhere.json" in refused(cases, "--config", "nowhere.json", "--out", out)
    assert "--seed" in refused(cases, "--seed", "-1", "--out", out)
    assert "--engine" in refused(cases, "--engine", "torch", "--out", out)
    assert "--out" in refused(cases)
    assert "DATA" in refused("--out", out)
    for bad in (tmp_path, tmp_path / "nowhere" / "m"):
        assert "cannot write" in refused(cases, *fit_options, "--out", bad)


def test_fit_refuses_settings_that_do_not_fit_and_a_checkpoint_it_cannot_write(
    folder, fit_options, tmp_path, run
):
    cases, out = folder / "cases.npz", tmp_path / "m"
    code, _, err = run(
        "fit",
        cases,
        "--engine",
        "jax",
        "--split",
        "none",
        "--config",
        _json(tmp_path, {"fourier_area": {"terms": 15}}),
        "--out",
        out,
    )
    assert code == 2
    assert "fourier_area.terms=15" in err
    code, _, err = run(
        "fit", cases, *fit_options, "--out", out, "--checkpoint", tmp_path / "nowhere" / "c"
    )
    assert code == 2
    assert "cannot write" in err
    (tmp_path / "m.checkpoint").write_text("hello")
    code, _, err = run("fit", cases, *fit_options, "--out", out)
    assert code == 2
    assert "not a pcnde_bridge checkpoint" in err
    assert not out.exists()


def test_fit_in_processes(tmp_path, run, physics_cases, physics_model, monkeypatch):
    monkeypatch.chdir(tmp_path)
    physics_cases.save("cases.h5")
    config = "--preset", "physics", "--config", _json(tmp_path, PHYSICS_CONFIG.to_dict())
    fit = "fit", "cases.h5", "--engine", "jax", "--split", "none", "--workers", 2, "--out", "m.npz"
    code, _, err = run(*fit, *config)
    assert code == 0, err
    for name, vector in PCNDE.load("m.npz", "jax").parameters:
        expected = getattr(physics_model.parameters, name)
        np.testing.assert_allclose(vector, expected, rtol=1e-10, atol=1e-12, err_msg=name)
    code, _, err = run(*fit, "--preset", "fast")
    assert code == 2
    assert "(executor=, --workers) fit one model only with the preset 'physics'" in err


def _json(folder, value):
    path = folder / "some.json"
    path.write_text(json.dumps(value))
    return path


# ---- evaluate --------------------------------------------------------------------


def test_evaluate(folder, tmp_path, run, small_model, small_cases, small_split):
    as_json, as_csv = tmp_path / "e.json", tmp_path / "e.csv"
    code, printed, err = run(
        "evaluate", folder / "model.pcnde", folder / "cases.npz", "--split",
        folder / "split.json", "--json", as_json, "--csv", as_csv, "--engine", "jax",
    )  # fmt: skip
    assert code == 0
    assert "new to the model" not in err
    found = json.loads(as_json.read_text())
    split = small_cases.split(small_split)
    assert list(found) == ["train", "test"]
    table = read_frame(as_csv)
    errors = ["flow", "area", "pressure", "pressure_drop", "one_minus_ffr"]
    assert list(table.columns) == ["set", "geometry", "waveform", *errors]
    assert len(table) == 11 + 1 + 1 + 1
    for name, cases in split._asdict().items():
        expected = small_model.evaluate(cases)
        assert found[name] == expected.iloc[-1].to_dict()
        rows = table[table["set"] == name]
        assert np.array_equal(rows[errors], expected)
        assert list(rows["geometry"]) == [str(g) for g, _ in expected.index]
        for value in found[name].values():
            assert f"{value:.4f}" in printed


def test_evaluate_without_a_split(folder, tmp_path, run, small_model, small_cases):
    as_json = tmp_path / "e.json"
    expected = small_model.evaluate(small_cases).iloc[-1].to_dict()
    options = ("--json", as_json, "--engine", "jax")
    for split in ((), ("--split", "none")):
        code, _, err = run(
            "evaluate", folder / "model.pcnde", folder / "cases.npz", *split, *options
        )
        assert code == 0
        assert "All 12 cases are evaluated" in err
        assert json.loads(as_json.read_text()) == {"all": expected}


def test_evaluate_tells_test_cases_that_trained_the_model(folder, run):
    model, cases = folder / "model.pcnde", folder / "cases.npz"
    code, _, err = run("evaluate", model, cases, "--split", "geometry=1", "--engine", "jax")
    assert code == 0
    assert "4 test cases may not be new to the model" in err


def test_bench_with_a_wall_shear_stress(folder, tmp_path, run, small_model, sheared_cases):
    sheared_cases.save(data := tmp_path / "cases.npz")
    code, printed, _ = run(
        "bench", data, "--model", folder / "model.pcnde", "--split", "none", "--engine", "jax",
        "--json", tmp_path / "rows.json",
    )  # fmt: skip
    assert code == 0
    lines = {line.split("│")[1].strip(): line for line in printed.splitlines() if "│" in line}
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert rows[0]["errors"]["train"] == small_model.evaluate(sheared_cases).iloc[-1].to_dict()
    assert lines["PCNDE (jax), train"].count("–") == 2  # the paper's model does not predict it
    errors = rows[1]["errors"]["train"]
    for name in ("wall_shear_stress", "time_averaged_wall_shear_stress"):
        assert f"{errors[name]:.4f}" in lines["no change, train"]
    assert "WSS" in printed
    assert "TAWSS" in printed
    assert f"{rows[1]['predict_ms_per_case']:.2f}" in lines["no change"]
    assert max(map(len, lines.values())) <= 80


def test_evaluate_refuses(folder, tmp_path, run, small_cases):
    model, cases = folder / "model.pcnde", folder / "cases.npz"

    def refused(*arguments):
        code, printed, err = run("evaluate", *arguments, "--engine", "jax")
        assert (code, printed) == (2, "")
        return err

    assert "There is no file" in refused(tmp_path / "nowhere", cases)
    assert "is a folder, not a pcnde_bridge model" in refused(tmp_path, cases)
    assert "not a pcnde_bridge model" in refused(cases, cases)
    assert "nowhere" in refused(model, tmp_path / "nowhere")
    assert "model.pcnde" in refused(model, model)
    assert str(tmp_path) in refused(model, tmp_path)
    assert "cannot write" in refused(model, cases, "--split", "none", "--json", tmp_path)
    assert "cannot write" in refused(
        model, cases, "--split", "none", "--csv", tmp_path / "nowhere" / "e.csv"
    )
    facts, arrays = read_archive(model, "pcnde-model", 1, "model")
    facts = {"config": facts["config"], "provenance": facts["provenance"]}
    write_archive(tmp_path / "newer", "pcnde-model", 99, facts, arrays)
    assert "written by a newer pcnde_bridge" in refused(tmp_path / "newer", cases)
    other = Cases(
        *(np.asarray(getattr(small_cases, v))[:, :, ::2] for v in ("flow", "area", "pressure")),
        small_cases.area_undeformed[:, ::2],
        small_cases.time,
        small_cases.z[::2],
    )
    other.save(tmp_path / "other.h5")
    assert "11 values of z" in refused(model, tmp_path / "other.h5", "--split", "none")


# ---- predict ---------------------------------------------------------------------


def predicted(run, folder, inflow, out):
    """Run ``pcnde predict`` with one vessel, and return what it prints."""
    code, printed, _ = run(
        "predict", folder / "model.pcnde", "--inflow", folder / inflow,
        "--area", folder / "area.csv", "--out", out, "--engine", "jax",
    )  # fmt: skip
    assert code == 0
    return printed


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".h5"])
def test_predict_one_case(folder, tmp_path, run, small_model, small_cases, suffix):
    out = tmp_path / f"result{suffix}"
    printed = predicted(run, folder, "inflow.csv", out)
    assert f"Saved 1 case in {out}" in printed
    expected = small_model.predict(small_cases.inflow[0], small_cases.area_undeformed[0])
    if suffix == ".csv":
        found = read_frame(out)
        frame = expected.to_frame()
        assert set(found.pop("name")) == set(pd.read_csv(folder / "inflow.csv").columns[1:])
        assert list(found.columns) == list(frame.columns)
        np.testing.assert_allclose(found, frame, rtol=1e-13)
    else:
        cases = Cases.load(out)
        for name in ("flow", "area", "pressure"):
            assert np.array_equal(getattr(cases, name), getattr(expected, name))


def test_predict_many_waveforms_in_one_vessel(folder, tmp_path, run, small_model, small_cases):
    out = tmp_path / "result.npz"
    printed = predicted(run, folder, "inflows.csv", out)
    assert "Saved 12 cases" in printed
    expected = small_model.predict(small_cases.inflow, small_cases.area_undeformed[0])
    assert np.array_equal(Cases.load(out).flow, expected.flow)


def test_a_table_of_many_cases_is_written_batch_by_batch(
    folder, tmp_path, run, small_model, small_cases, monkeypatch
):
    batches, whole = [], PCNDE.predict_batches

    def in_fives(model, *inputs, **where):
        for part in whole(model, *inputs, **{**where, "batch": 5}):
            batches.append(len(part))
            yield part

    monkeypatch.setattr(PCNDE, "predict_batches", in_fives)
    out = tmp_path / "result.csv.gz"
    printed = predicted(run, folder, "inflows.csv", out)
    assert "Saved 12 cases" in printed
    assert batches == [5, 5, 2]
    expected = small_model.predict(small_cases.inflow, small_cases.area_undeformed[0])
    found = read_frame(out)
    names = pd.read_csv(folder / "inflows.csv").columns[1:]
    assert list(found.pop("name").unique()) == list(names)
    pd.testing.assert_frame_equal(found, expected.to_frame(), rtol=1e-13)


def test_predict_names_the_files_that_it_wrote(folder, tmp_path, run):
    pytest.importorskip("vtkmodules")
    printed = predicted(run, folder, "inflows.csv", tmp_path / "p.vtp")
    assert f"Saved 12 cases in {tmp_path / 'p_000.vtp'} to p_011.vtp." in printed
    assert len(list(tmp_path.iterdir())) == 12


def test_predict_refuses(folder, tmp_path, run, small_model, monkeypatch):
    def refused(
        *options, model="model.pcnde", inflow="inflow.csv", area="area.csv", out="result.csv"
    ):
        code, printed, err = run(
            "predict", folder / model, "--inflow", folder / inflow, "--area", folder / area,
            "--out", tmp_path / out, "--engine", "jax", *options,
        )  # fmt: skip
        assert (code, printed) == (2, "")
        return err

    assert "must end in .csv" in refused(out="result.txt")
    assert "must end in .csv" in refused(out="result")
    assert "There is no file" in refused(model="nowhere")
    assert "nowhere.csv (a table of" in refused(inflow="nowhere.csv")
    assert "must have the columns time" in refused(inflow="area.csv")
    assert "fit an ensemble" in refused("--samples", 8, inflow="area.csv")
    assert "must have the columns z" in refused(area="inflow.csv")
    assert "Cannot write" in refused(out="nowhere/result.csv")
    assert "is named twice: it would be overwritten" in refused(out=folder / "inflow.csv")
    assert list(tmp_path.iterdir()) == []

    bad = tmp_path / "bad.csv"
    text = (folder / "area.csv").read_text()
    lines = text.splitlines()
    lines[6] = lines[6].split(",")[0] + ",-0.1"
    bad.write_text("\n".join(lines))
    assert "area_undeformed[0, 5] is -0.1" in refused(area=bad)
    table = pd.read_csv(folder / "inflows.csv").iloc[:, :6]
    table.to_csv(tmp_path / "five.csv", index=False)
    pd.read_csv(folder / "area.csv").assign(b=0.1).to_csv(bad, index=False)
    assert "have some names of cases in common, but b, case" in refused(
        inflow=tmp_path / "five.csv", area=bad
    )
    pd.read_csv(bad).set_axis(["z", "a", "b"], axis=1).to_csv(bad, index=False)
    assert "inflow has 5 cases and area_undeformed 2" in refused(
        inflow=tmp_path / "five.csv", area=bad
    )

    flow_and_area = PCNDE(
        small_model.config,
        small_model.parameters.without_pressure(),
        small_model.grid,
        small_model.engine,
    )
    flow_and_area.save(tmp_path / "flow_and_area")
    assert "no pressure" in refused(
        model=tmp_path / "flow_and_area", inflow="inflows.csv", out="result.npz"
    )


# ---- failures, doctor, the rest ---------------------------------------------------


def test_a_failure_of_the_engine_is_exit_code_1(folder, run, monkeypatch):
    def diverge(*_):
        raise SolveError("[bold]The equation[/bold] diverged.")

    monkeypatch.setattr(PCNDE, "evaluate", diverge)
    code, printed, err = run(
        "evaluate", folder / "model.pcnde", folder / "cases.npz", "--engine", "jax"
    )
    assert (code, printed) == (1, "")
    assert "Error: [bold]The equation[/bold] diverged." in err


@pytest.fixture(autouse=True)
def julia_is_not_loaded(monkeypatch):
    """Julia may have to be compiled first, which takes minutes."""
    monkeypatch.setattr("pcnde_bridge.cli.doctor.load_error", lambda timeout: "")


def test_doctor(run, monkeypatch):
    code, printed, _ = run("doctor")
    assert code == 0
    for found in (__version__, "Python", "engine jax", "engine julia", "published data"):
        assert found in printed


def test_doctor_without_data_says_what_to_do(run, monkeypatch, tmp_path):
    monkeypatch.setenv("PCNDE_DATA", str(tmp_path / "nowhere"))
    code, printed, _ = run("doctor")
    assert code == 0
    assert "PCNDE_DATA" in printed
    monkeypatch.setattr("pcnde_bridge.cli.doctor.find_published", lambda: None)
    code, printed, _ = run("doctor")
    assert code == 0
    assert "pcnde download" in printed


def test_commands_are_listed_in_order(run):
    _, printed, _ = run("--help")
    lines = printed[printed.index("Commands:") :].splitlines()[1:]
    assert [line.split()[0] for line in lines if line.strip()] == [
        *("fit", "cross-validate", "info", "evaluate", "predict", "demo", "simulate"),
        *("design", "convert", "bench", "app", "figures", "download", "doctor"),
    ]
    assert "..." not in "".join(lines)  # every summary is whole


def test_a_checkpoint_that_cannot_be_written_is_said_before_anything_is_loaded(folder, run):
    code, _, err = run(
        "fit", folder / "missing.npz", "--out", folder / "m.npz",
        "--checkpoint", folder / "nowhere" / "state",
    )  # fmt: skip
    assert code == 2
    assert "nowhere' does not exist; create it first" in err


def test_bad_use(run):
    for arguments in (("nonsense",), ("fit", "--nonsense"), ("evaluate",), ("predict", "m")):
        code, _, err = run(*arguments)
        assert code == 2
        assert "Usage" in err
    for arguments in (("--help",), ("fit", "--help")):
        code, printed, _ = run(*arguments)
        assert code == 0
        assert "Usage" in printed
    assert run("--version")[:2] == (0, f"{__version__}\n")


def test_the_packages_warnings_have_no_line_of_code(capsys):
    for category, has_line in (
        (PCNDEWarning, False),
        (OutsideTrainingWarning, False),
        (UserWarning, True),
    ):
        note_warning("It is so.", category, "somewhere.py", 7)
        err = capsys.readouterr().err
        assert "It is so." in err
        assert ("somewhere.py:7" in err) == has_line


@pytest.mark.parametrize("text", ["model[fast].npz", "a[/x].npz", "a :fire: b", 50 * "long/"])
def test_text_is_printed_unchanged(capsys, monkeypatch, text):
    monkeypatch.setenv("COLUMNS", "40")
    say(text)
    note(f"Error: {text}", style="bold red")
    assert capsys.readouterr() == (f"{text}\n", f"Error: {text}\n")


@pytest.mark.parametrize("name", ["model[fast]", "a[/x]"])
def test_files_may_have_any_name(folder, tmp_path, run, small_cases, toy_engine, monkeypatch, name):
    """Names that look like markup of rich: ``[fast]`` vanished, and ``[/x]`` was an error."""
    for part in ("pcnde", "predictor"):
        name = f"pcnde_bridge.model.{part}.select_engine"
        monkeypatch.setattr(name, lambda *_, **__: toy_engine)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    model, table, cases = (tmp_path / f"{name}{end}" for end in (".npz", ".csv", ".h5"))
    config = ("--config", folder / "config.json", "--split", "none")
    code, printed, _ = run("fit", folder / "cases.npz", *config, "--out", model)
    assert code == 0
    assert f"Saved {model}.\n" in printed
    code, printed, _ = run(
        "predict", model, "--inflow", folder / "inflow.csv", "--area", folder / "area.csv",
        "--out", table,
    )  # fmt: skip
    assert code == 0
    assert printed.endswith(f".\nSaved 1 case in {table}.\n")
    small_cases.select([0]).save(tmp_path / "one.h5")
    code, printed, _ = run("convert", tmp_path / "one.h5", "--from", "hdf5", "--out", cases)
    assert code == 0
    assert printed.endswith(f" in {cases}.\n")
    for file in (model, table, cases):
        assert file.exists()
    code, printed, err = run("info", table)
    assert (code, printed) == (2, "")
    assert str(table) in err


def test_the_checkpoint_of_bench_is_named_after_the_fit(small_cases, small_config):
    name = checkpoint_name(small_cases, small_config, "auto", 0)
    assert name == checkpoint_name(small_cases, small_config, "auto", 0)
    others = (
        (small_cases.select([0, 1]), small_config, "auto", 0),
        (small_cases, small_config.replace(batch_size=3), "auto", 0),
        (small_cases, small_config, "jax", 0),
        (small_cases, small_config, "auto", 1),
    )
    assert len({name, *(checkpoint_name(*other) for other in others)}) == 5


def test_the_script_is_installed():
    script = Path(sys.executable).with_name("pcnde" + (".exe" if os.name == "nt" else ""))
    if not script.exists():
        pytest.skip("the package is not installed with its script")
    assert "pcnde_bridge" in script.read_text()


def test_characters_that_the_console_cannot_write_are_replaced():
    result = process("doctor", env=os.environ | WITHOUT_JULIA | {"PYTHONIOENCODING": "ascii"})
    assert "Traceback" not in result.stderr
    assert "Python" in result.stdout


def test_results_do_not_overwrite_each_other(folder, run, tmp_path):
    code, _, err = run(
        "evaluate", folder / "model.pcnde", folder / "cases.npz", "--engine", "jax",
        "--json", tmp_path / "a.csv", "--csv", tmp_path / "a.csv",
    )  # fmt: skip
    assert code == 2
    assert "is named twice" in err
