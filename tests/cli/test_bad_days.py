"""Bad days of the command line: paths, environment, broken output, killed and second runs."""

from __future__ import annotations

import logging
import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from rich.table import Table

from pcnde_bridge import Cases
from pcnde_bridge._utils.files import locked
from pcnde_bridge.cli.console import Notes, note, say, show

pytestmark = pytest.mark.skipif(os.name == "nt", reason="POSIX paths, permissions and signals")

LONG = "a" * 256


@pytest.fixture(scope="module")
def folder(tmp_path_factory, small_cases, small_model):
    """Folder of a user, with every mistake that a path can have."""
    folder = tmp_path_factory.mktemp("user")
    small_cases.save(folder / "cases.npz")
    small_cases.save(folder / "cases.h5")
    small_model.save(folder / "model.npz")
    pd.DataFrame({"time": small_cases.time, "a": small_cases.inflow[0]}).to_csv(
        folder / "inflow.csv", index=False
    )
    pd.DataFrame({"z": small_cases.z, "a": small_cases.area_undeformed[0]}).to_csv(
        folder / "area.csv", index=False
    )
    (folder / "loop.npz").symlink_to("loop.npz")
    os.mkfifo(folder / "pipe.npz")
    return folder


@pytest.fixture
def run(folder, run_pcnde, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("pcnde_bridge._utils.files._PATIENCE", 0.1)
    return run_pcnde


def process(*arguments, folder, code=None, **options):
    """Run ``pcnde``, or other code, in a separate process."""
    start = ["-m", "pcnde_bridge"] if code is None else ["-c", code]
    return subprocess.run(
        [sys.executable, *start, *map(str, arguments)],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
        check=False,
        **{"stdout": subprocess.PIPE, **options},
    )


# ---- paths -------------------------------------------------------------------------

READ = {
    LONG: "File name too long",
    f"{LONG}/x.npz": "File name too long",
    "loop.npz": "Too many levels of symbolic links",
    "pipe.npz": "is a pipe",
    "/dev/zero": "is a device",
    "~nosuchuser/x.npz": "here is no (split )?file '?~nosuchuser/x.npz|neither a file",
    ".": "is a folder, not|holds no folders named",
    "absent/x.npz": "here is no (split )?file '?absent/x.npz|neither a file",
    "model.npz/x.npz": "here is no (split )?file '?model.npz/x.npz|neither a file",
}
WRITE = {
    f"{LONG}.npz": "File name too long",
    f"{LONG}/x.npz": "does not exist|File name too long",
    "loop.npz": "Too many levels of symbolic links",
    "pipe.npz": "it is a device or a pipe",
    "~nosuchuser/x.npz": "does not exist; create it first",
    "absent/x.npz": "does not exist; create it first",
    "model.npz/x.npz": "Not a directory|does not exist",
}
READERS = {
    "info": ("info", "{}"),
    "model": ("evaluate", "{}", "cases.npz"),
    "data": ("evaluate", "model.npz", "{}", "--engine", "jax"),
    "inflow": (
        *("predict", "model.npz", "--inflow", "{}", "--area", "area.csv"),
        *("--out", "out.csv", "--engine", "jax"),
    ),
    "config": ("fit", "cases.npz", "--out", "m", "--config", "{}"),
    "split": ("evaluate", "model.npz", "cases.npz", "--engine", "jax", "--split", "{}"),
    "labels": (*("convert", "cases.h5", "--from", "hdf5", "--out", "out.npz", "--labels", "{}"),),
    "csv": ("convert", "{}", "--from", "csv", "--out", "out.npz"),
    "hdf5": ("convert", "{}", "--from", "hdf5", "--out", "out.npz"),
    "simvascular": ("convert", "{}", "--from", "simvascular", "--out", "out.npz"),
    "sv1d": ("convert", "{}", "--from", "sv1d", "--period", "1", "--out", "out.npz"),
}
WRITERS = {
    "simulate": ("simulate", "--out", "{}", "--geometries", "1", "--waveforms", "1"),
    "predict": (
        *("predict", "model.npz", "--inflow", "inflow.csv", "--area", "area.csv"),
        *("--out", "{}", "--engine", "jax"),
    ),
    "json": ("evaluate", "model.npz", "cases.npz", "--engine", "jax", "--json", "{}"),
    "fit": ("fit", "cases.npz", "--out", "{}", "--engine", "jax"),
}


@pytest.mark.parametrize("reader", READERS)
def test_paths_that_cannot_be_read(folder, run, reader):
    before = sorted(path.name for path in folder.iterdir())
    for path, message in READ.items():
        code, printed, err = run(*(part.format(path) for part in READERS[reader]))
        assert (code, printed) == (2, ""), (path, err)
        assert re.search(message, err), (path, err)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize("writer", WRITERS)
def test_paths_that_cannot_be_written(folder, run, writer):
    before = sorted(path.name for path in folder.iterdir())
    for path, message in WRITE.items():
        code, printed, err = run(*(part.format(path) for part in WRITERS[writer]))
        assert (code, printed) == (2, ""), (path, err)
        assert re.search(f"{message}|in an existing folder", err), (path, err)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("info", "closed/model.npz"), "closed/model.npz cannot be read: Permission denied"),
        (("simulate", "--out", "closed/c.npz"), "no permission to write in '.*closed'"),
        (("simulate", "--out", "listed/c.npz"), "no permission to write in '.*listed'"),
    ],
)
def test_folders_that_may_not_be_entered_or_written(tmp_path, arguments, message):
    for name, mode in (("closed", 0), ("listed", 0o555)):
        (tmp_path / name).mkdir()
        (tmp_path / name).chmod(mode)
    code = """
import os, sys
import filelock, pcnde_bridge.model.describe, pcnde_bridge.hemodynamics.synthetic
from pcnde_bridge.cli import main
filelock.FileLock, filelock.Timeout
if os.getuid() == 0:  # who may enter everything
    given = sys.argv
    for command in (["info", "none"], ["simulate", "--out", "none/c.npz"]):
        sys.argv = ["pcnde", *command]
        try:  # loads the modules, which others may not be able to read
            main.run()
        except SystemExit as end:
            assert end.code == 2
    sys.argv = given
    os.chmod(".", 0o755)
    os.setuid(65534)
main.run()
"""
    found = process(*arguments, folder=tmp_path, code=code)
    assert found.returncode == 2, found.stderr
    assert re.search(message, found.stderr), found.stderr


def test_a_removed_working_folder(tmp_path):
    code = "import os; os.rmdir(os.getcwd()); from pcnde_bridge.cli import main; main.run()"
    gone = tmp_path / "gone"
    for arguments in (("info", "model.npz"), ("simulate", "--out", "c.npz"), ("doctor",)):
        gone.mkdir()
        found = process(*arguments, folder=gone, code=code)
        assert found.returncode == 2
        assert found.stderr == ("Error: The working folder was removed: change to another one.\n")


@pytest.mark.parametrize("name", ["PCNDE_CACHE", "PCNDE_DATA"])
@pytest.mark.parametrize("value", ["~nosuchuser/x", LONG])
def test_settings_with_a_wrong_path(run, monkeypatch, name, value):
    monkeypatch.delenv("PCNDE_DATA", raising=False)
    monkeypatch.setenv(name, value)
    monkeypatch.setattr("pcnde_bridge.io.datasets.__file__", "/x/y/z/io/datasets.py")
    code, _, err = run("evaluate", "model.npz", "published", "--engine", "jax")
    assert code == 2
    assert re.search("home directory|File name too long|does not exist", err), err


# ---- output and environment ---------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_output(folder):
    with Path("/dev/full").open("w") as full:
        found = process("info", "model.npz", folder=folder, stdout=full)
    assert found.returncode == 1
    assert found.stderr.startswith("Error: the output cannot be written: ")
    assert found.stderr.count("\n") == 1


def environment(**changes):
    return os.environ | changes


def test_a_device_of_jax_that_is_not_there(folder):
    found = process(
        *("evaluate", "model.npz", "cases.npz", "--split", "none", "--engine", "jax"),
        folder=folder,
        env=environment(JAX_PLATFORMS="cuda"),
    )
    assert found.returncode == 1
    assert "Error: JAX has no device to compute on" in found.stderr
    assert "JAX_PLATFORMS, which is 'cuda'." in found.stderr
    assert "Traceback" not in found.stderr


def test_a_notebooks_backend_of_matplotlib(folder, tmp_path):
    found = process(
        *("figures", "model.npz", "cases.npz", "--engine", "jax", "--split", "none"),
        *("--out", tmp_path / "figures", "--only", "history"),
        folder=folder,
        env=environment(MPLBACKEND="module://nowhere.backend_inline"),
    )
    assert found.returncode == 0, found.stderr
    assert list((tmp_path / "figures").glob("*.png"))


def test_an_hdf5_file_that_another_program_has_open(folder, run):
    code = "import h5py, sys; f = h5py.File('cases.h5', 'r+'); print('open', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment(HDF5_USE_FILE_LOCKING="TRUE"),
    ) as other:
        assert other.stdout.readline() == b"open\n"
        for arguments in (
            ("info", "cases.h5"),
            ("evaluate", "model.npz", "cases.h5", "--engine", "jax"),
            ("convert", "cases.h5", "--from", "hdf5", "--out", "out.npz"),
        ):
            code, _, err = run(*arguments)
            assert code == 2
            assert "cases.h5 is in use by another program: close it there." in err
        other.communicate(b"\n")


def test_an_unexpected_error_is_a_line_and_a_report(run, monkeypatch, tmp_path):
    def fail(*_):
        raise ZeroDivisionError("nobody thought of this\nat all")

    monkeypatch.setattr("pcnde_bridge.model.ensemble.load_model", fail)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code, printed, err = run("evaluate", "model.npz", "cases.npz", "--seed[/x]")
    assert code == 2  # of the command line itself
    code, printed, err = run("evaluate", "model.npz", "cases.npz")
    [report] = tmp_path.iterdir()
    assert (code, printed) == (1, "")
    assert err == (
        "Error: unexpected ZeroDivisionError: nobody thought of this. Please send the report "
        f"{report} to the developers.\n"
    )
    text = report.read_text()
    for part in ("pcnde evaluate model.npz cases.npz", "Traceback", "in fail", "numpy ", "Python "):
        assert part in text
    assert stat.S_IMODE(report.stat().st_mode) == 0o600
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
    code, _, err = run("evaluate", "model.npz", "cases.npz")
    assert code == 1
    assert "no report could be written" in err


def test_more_samples_than_memory_are_refused(physics_model, physics_cases, tmp_path, run):
    physics_model.save(tmp_path / "m.npz")
    for name, values in (
        ("time", physics_cases.inflow[0]),
        ("z", physics_cases.area_undeformed[0]),
    ):
        axis = getattr(physics_cases, name)
        pd.DataFrame({name: axis, "a": values}).to_csv(tmp_path / f"{name}.csv", index=False)
    code, _, err = run(
        *("predict", tmp_path / "m.npz", "--inflow", tmp_path / "time.csv"),
        *("--area", tmp_path / "z.csv", "--out", tmp_path / "o.csv", "--engine", "jax"),
        *("--samples", 10**9),
    )
    assert code == 2
    assert re.search(r"1 case with 1000000000 samples would need \d+\.\d GB of memory, and", err)
    code, _, err = run("simulate", "--geometries", 10**9, "--out", tmp_path / "c.npz")
    assert code == 2
    assert "10000000000 cases would need" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.npz", "time.csv", "z.csv"]


# ---- text from files -----------------------------------------------------------------


def test_control_characters_do_not_reach_the_terminal(capsys):
    for write in (say, note, lambda text: Notes().emit(logging.makeLogRecord({"msg": text}))):
        write("a\x1b]0;title\x07b\x1b[31m\u202ec\nd")
        assert "".join(capsys.readouterr()) == "a]0;titleb[31mc\nd\n"
    table = Table("name")
    table.add_row("x\x1b[2Jy\x9b")
    show(table)
    out = capsys.readouterr().out
    assert "x[2Jy" in out
    assert not {"\x1b", "\x9b"} & set(out)


def test_a_crafted_label_of_a_data_set_is_shown_without_them(small_cases, tmp_path, run):
    names = ["\x1b[2J", "b", "c", "d"] * 3
    labels = small_cases.labels.assign(name=names)
    arrays = (getattr(small_cases, n) for n in ("flow", "area", "pressure", "area_undeformed"))
    made = Cases(*arrays, small_cases.time, small_cases.z, period=1.0, labels=labels)
    made.save(tmp_path / "c.npz")
    code, out, _ = run("info", tmp_path / "c.npz")
    assert code == 0
    assert "[2J" in out
    assert "\x1b" not in out


# ---- two runs ---------------------------------------------------------------------------

HOLD = """
import sys, time
from pcnde_bridge._utils.files import locked
with locked(sys.argv[1]) as target:
    target.with_name(f".{target.name}.0123abcd{target.suffix}").touch()
    print("locked", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize(
    ("target", "arguments"),
    [
        ("o.npz", ("simulate", "--out", "{}/o.npz", "--geometries", "1", "--waveforms", "1")),
        ("e.json", ("evaluate", "model.npz", "cases.npz", "--json", "{}/e.json")),
        ("m", ("fit", "cases.npz", "--out", "{}/m")),
        ("s", ("fit", "cases.npz", "--out", "{}/m", "--checkpoint", "{}/s")),
        ("m.checkpoint", ("fit", "cases.npz", "--split", "none", "--out", "{}/m")),
        ("", ("demo", "--out", "{}")),
        ("", ("figures", "model.npz", "cases.npz", "--out", "{}")),
        ("", ("cross-validate", "cases.npz", "--split", "none", "--folder", "{}")),
    ],
)
def test_a_second_run_is_refused_until_the_first_is_killed(tmp_path, run, target, arguments):
    shared = tmp_path / "shared"
    shared.mkdir()
    path = shared / target
    arguments = [part.format(shared) for part in arguments]
    with subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE) as first:
        assert first.stdout.readline() == b"locked\n"
        code, printed, err = run(*arguments)
        assert (code, printed) == (2, "")
        assert f"{str(path)!r} is in use by another run: wait until that ends, or give" in err
        first.kill()
    with locked(path):  # as the next run would
        assert [p.name for p in tmp_path.rglob("*") if "0123abcd" in p.name] == []
    assert list(shared.iterdir()) == []


FIT = """
import sys
from helpers import ToyEngine
from pcnde_bridge import PCNDE, Cases, FileError, PCNDEConfig
from pcnde_bridge.training.checkpoint import remove
cases, config = Cases.load(sys.argv[1]), PCNDEConfig.from_dict(eval(sys.argv[2]))
done = refused = 0
for _ in range(int(sys.argv[4])):
    try:
        PCNDE.fit(cases, config, ToyEngine(), checkpoint=sys.argv[3], progress=False)
        done += 1
    except FileError as error:
        assert "is in use by another run" in str(error), error
        refused += 1
print(done, refused)
"""


@pytest.mark.parametrize("count", [5, pytest.param(100, marks=pytest.mark.slow)])
def test_two_runs_on_one_checkpoint_fail_by_the_lock_only(folder, tmp_path, toy_config, count):
    path = tmp_path / "run.checkpoint"
    arguments = [folder / "cases.npz", toy_config.to_dict(), path, count]
    tests = str(Path(__file__).parents[1])
    python_path = os.pathsep.join(filter(None, [tests, os.environ.get("PYTHONPATH")]))
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", FIT, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(PYTHONPATH=python_path),
        )
        for _ in range(2)
    ]
    found = [run.communicate(timeout=600) for run in runs]
    assert [run.returncode for run in runs] == [0, 0], found
    counts = np.array([out.split() for out, _ in found], dtype=int)
    assert (counts.sum(axis=1) == count).all()
    assert counts[:, 0].sum() > 0
    assert {p.name for p in tmp_path.iterdir()} <= {path.name, f"{path.name}.previous"}


# ---- workers ------------------------------------------------------------------------------

# Without ``if __name__ == "__main__"``, and with a function of the program itself.
PROGRAM = """
import os, sys, time
from pcnde_bridge._utils.parallel import processes, run

def work(number):
    open(f"{sys.argv[1]}/{os.getpid()}", "w").close()
    time.sleep(float(sys.argv[2]))
    return number

print(run(work, {f"t{k}": k for k in range(3)}, executor=processes(2), progress=False).results)
"""


def program(folder, seconds):
    (folder / "program.py").write_text(PROGRAM.replace("sys.argv[1]", repr(str(folder / "pids"))))
    (folder / "pids").mkdir()
    text = (folder / "program.py").read_text().replace("sys.argv[2]", str(seconds))
    (folder / "program.py").write_text(text)
    return [sys.executable, str(folder / "program.py")]


def test_a_program_without_a_guard_runs_once(tmp_path):
    found = subprocess.run(
        program(tmp_path, 0), capture_output=True, text=True, timeout=120, check=False
    )
    assert (found.returncode, found.stdout) == (0, "{'t0': 0, 't1': 1, 't2': 2}\n"), found.stderr


def default_signals():
    """Undo what ``nohup`` sets, which processes inherit."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGKILL", "SIGHUP"])
def test_workers_end_with_their_parent(tmp_path, name):
    parent = subprocess.Popen(
        program(tmp_path, 600), stderr=subprocess.DEVNULL, preexec_fn=default_signals
    )
    until = time.monotonic() + 120
    while len(list((tmp_path / "pids").iterdir())) < 2:
        assert parent.poll() is None
        assert time.monotonic() < until
        time.sleep(0.05)
    others = psutil.Process(parent.pid).children(recursive=True)
    assert len(others) >= 2
    parent.send_signal(getattr(signal, name))
    parent.wait(timeout=20)
    _, alive = psutil.wait_procs(others, timeout=5)
    assert alive == []
