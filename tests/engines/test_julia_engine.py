"""The Julia engine around its numbers: status, start, errors, interruption, processes."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
import tomllib
import types
import warnings
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import requires
from pathlib import Path

import numpy as np
import pytest
from helpers import loss_and_gradient_of

from pcnde_bridge.cli.doctor import examine
from pcnde_bridge.config import PAPER
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.julia import runtime
from pcnde_bridge.engines.julia.engine import JuliaEngine
from pcnde_bridge.engines.julia.environment import (
    EXECUTABLE,
    PROJECT,
    JuliaStatus,
    core_version,
    julia_settings_file,
    julia_sources,
    julia_status,
    write_project,
)
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import FitData, ModelInputs
from pcnde_bridge.errors import (
    EngineError,
    EngineUnavailableError,
    InputError,
    PCNDEWarning,
    SolveError,
)

OUR_SERIES = core_version(julia_sources()).rpartition(".")[0]

# ---------------------------------------------------------------- without Julia


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """No variables, no user's file, and no Julia running."""
    for name in list(os.environ):
        if name.startswith(("PYTHON_JULIA", "JULIA_")):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delitem(sys.modules, "juliacall", raising=False)
    return tmp_path


def fake_julia(folder: Path, answer: str = "julia version 1.10.8") -> Path:
    program = folder / "julia"
    program.write_text(f"#!/bin/sh\necho {answer}\n")
    program.chmod(0o755)
    return program


def fake_project(folder: Path, *packages: str) -> Path:
    project = folder / "project"
    project.mkdir()
    entries = [
        f'[[deps.{name}]]\nuuid = "x"\nversion = "{OUR_SERIES}.{i}"\n'
        for i, name in enumerate(packages)
    ]
    (project / "Manifest.toml").write_text("\n".join(entries))
    return project


def settings_file(**settings) -> Path:
    file = julia_settings_file()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(settings))
    return file


def test_the_users_file_names_julia(bare):
    program, project = fake_julia(bare), fake_project(bare, "PCNDECore", "PythonCall")
    settings_file(
        executable=str(program), project=str(project), environment={"JULIA_DEPOT_PATH": str(bare)}
    )
    status = julia_status()
    assert status.usable and status.source == "file"
    assert (status.executable, status.project, status.version) == (program, project, "1.10.8")
    assert status.packages == {
        "PCNDECore": f"{OUR_SERIES}.0",
        "PythonCall": f"{OUR_SERIES}.1",
    }
    assert not status.precompiled and "not precompiled" in status.message
    assert (status.threads, status.handle_signals) == ("1", "no")
    cache = bare / "compiled" / "v1.10" / "PCNDECore"
    cache.mkdir(parents=True)
    (cache / "x.ji").touch()
    assert julia_status().precompiled


def core_by_path(bare: Path, sources: Path, lacks: str = "") -> JuliaStatus:
    """Status with a project that has PCNDECore by path, listed with an outdated version."""
    packages = tomllib.loads((julia_sources() / "Project.toml").read_text())["deps"]
    project = fake_project(bare, "PythonCall", *(name for name in packages if name != lacks))
    with (project / "Manifest.toml").open("a") as file:
        file.write(f'\n[[deps.PCNDECore]]\npath = {json.dumps(str(sources))}\nversion = "0.0.1"\n')
    settings_file(executable=str(fake_julia(bare)), project=str(project))
    return julia_status()


def test_the_core_of_a_project_is_compared_with_ours(bare):
    status = core_by_path(bare, julia_sources())
    assert status.usable and status.warning == ""
    assert f'version = "{status.packages["PCNDECore"]}"' in (
        (julia_sources() / "Project.toml").read_text()
    )


def test_a_missing_package_of_the_core_is_named(bare):
    status = core_by_path(bare, julia_sources(), lacks="Lux")
    assert not status.usable and "lacks Lux. Add what is missing" in status.message
    with pytest.raises(EngineUnavailableError, match="lacks Lux"):
        select_engine("julia")


def test_another_core_is_named(bare):
    copy = shutil.copytree(julia_sources(), bare / "copy")
    (copy / "src" / "fit.jl").write_text("# otherwise\n")
    status = core_by_path(bare, copy)
    assert status.usable and str(copy) in status.warning and "differs" in status.warning
    (finding,) = (f for f in examine() if f.what == "engine julia")
    assert finding.good and finding.advice == status.warning


@pytest.mark.parametrize("damaged", ["Manifest.toml", "Project.toml"])
def test_a_project_that_cannot_be_read_is_not_usable(bare, damaged):
    copy = shutil.copytree(julia_sources(), bare / "copy")
    core_by_path(bare, copy)
    folder = copy if damaged == "Project.toml" else bare / "project"
    (folder / damaged).write_bytes(b"\xff")
    status = julia_status()
    assert not status.usable and "cannot be read: 'utf-8' codec" in status.message


def test_a_core_that_does_not_fit_is_refused(bare):
    copy = shutil.copytree(julia_sources(), bare / "copy")
    (copy / "Project.toml").write_text('version = "0.1.9"\n')
    status = core_by_path(bare, copy)
    assert not status.usable and "PCNDECore 0.1.9" in status.message
    assert str(copy) in status.message and "Pkg.develop" in status.message
    with pytest.raises(EngineUnavailableError, match=r"0\.1\.9"):
        runtime.start()


def test_signals_follow_the_threads(bare, monkeypatch):
    settings_file(
        executable=str(fake_julia(bare)),
        project=str(fake_project(bare, "PCNDECore", "PythonCall")),
    )
    for name in ("JULIA_NUM_THREADS", "PYTHON_JULIACALL_THREADS"):
        monkeypatch.setenv(name, "2")
        status = julia_status()
        assert (status.threads, status.handle_signals) == ("2", "yes")
    # What would die of Julia's own signals does not start.
    monkeypatch.setenv("PYTHON_JULIACALL_HANDLE_SIGNALS", "no")
    with pytest.raises(EngineUnavailableError, match="2 threads must handle signals"):
        runtime.start()


def test_a_julia_that_may_crash_gives_a_warning(bare, monkeypatch):
    juliacall = types.ModuleType("juliacall")
    juliacall.CONFIG = {"inited": True, "opt_threads": "2", "opt_handle_signals": None}
    monkeypatch.setitem(sys.modules, "juliacall", juliacall)
    with pytest.warns(PCNDEWarning, match="2 threads"):
        assert runtime.start() is juliacall
    juliacall.CONFIG["opt_handle_signals"] = "yes"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime.start()


def test_variables_come_before_the_file(bare, monkeypatch):
    settings_file(executable="/nowhere/julia", project="/nowhere")
    monkeypatch.setenv("PYTHON_JULIACALL_EXE", str(fake_julia(bare)))
    assert "together, or neither" in julia_status().message
    monkeypatch.setenv("PYTHON_JULIACALL_PROJECT", str(fake_project(bare, "PCNDECore")))
    status = julia_status()
    assert not status.usable and status.source == "environment"
    assert "lacks PythonCall" in status.message and "Pkg.develop" in status.message


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("julia version 1.6.7", "too old"),
        ("julia version 1.10.2", r"too old: 1\.10\.3 or newer"),
        ("hello", "does not run as Julia"),
    ],
)
def test_a_wrong_julia_is_refused(bare, answer, message):
    settings_file(executable=str(fake_julia(bare, answer)), project=str(bare))
    status = julia_status()
    assert not status.usable and re.search(message, status.message)
    with pytest.raises(EngineUnavailableError, match=message):
        runtime.start()


def test_the_variables_of_the_users_file_count(bare, monkeypatch):
    program, project = fake_julia(bare), fake_project(bare, "PCNDECore", "PythonCall")
    variables = {"JULIA_PKG_OFFLINE": "true", "JULIA_NUM_THREADS": "2"}
    settings_file(executable=str(program), project=str(project), environment=variables)
    status = julia_status()
    assert status.offline and (status.threads, status.handle_signals) == ("2", "yes")
    (finding,) = (f for f in examine() if f.what == "engine julia")
    assert "; offline; threads 2" in finding.found and "--load" in finding.advice
    # Variables that are set already take precedence.
    monkeypatch.setenv("JULIA_PKG_OFFLINE", "false")
    assert not julia_status().offline


def test_the_doctor_sees_that_julia_does_not_load(bare):
    program, project = fake_julia(bare), fake_project(bare, "PCNDECore", "PythonCall")
    depot = {"JULIA_DEPOT_PATH": str(bare)}
    settings_file(executable=str(program), project=str(project), environment=depot)
    cache = bare / "compiled" / "v1.10" / "PCNDECore"
    cache.mkdir(parents=True)
    (cache / "x.ji").touch()
    (finding,) = (f for f in examine() if f.what == "engine julia")
    assert not finding.good and finding.found.startswith("does not load")
    assert "Julia did not start" in finding.advice


def test_a_missing_julia_is_named(bare):
    settings_file(executable=str(bare / "absent"), project=str(bare))
    assert f"{bare / 'absent'}, which {julia_settings_file()} names" in julia_status().message
    with pytest.raises(EngineUnavailableError, match="absent"):
        runtime.start()


@pytest.mark.parametrize("text", ["{", "[]", '{"executable": "julia"}'])
def test_a_broken_file_is_named(bare, text):
    settings_file().write_text(text)
    status = julia_status()
    assert not status.usable and str(julia_settings_file()) in status.message


def numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))


def fits(version: str, bounds: str) -> bool:
    """Whether a version is within one entry of [compat]."""
    first, _, last = bounds.partition(" - ")
    low, found = numbers(first), numbers(version)
    # Without a last version, the first number that is not zero may not change.
    fixed = next(i for i, number in enumerate(low) if number) + 1
    high = numbers(last) if last else low[:fixed]
    return low <= found and found[: len(high)] <= high


def test_a_project_for_a_machine_without_network_access(bare):
    folder = bare / "new" / "project"
    commands = write_project(folder)
    assert f"cd {folder}" in commands and str(julia_settings_file()) in commands
    copied = folder / "PCNDECore"
    assert core_version(copied).startswith(OUR_SERIES)
    for file in (*julia_sources().glob("src/**/*.jl"), *julia_sources().glob("ext/*.jl")):
        assert (copied / file.relative_to(julia_sources())).read_bytes() == file.read_bytes()
    project = tomllib.loads((folder / "Project.toml").read_text())
    core = tomllib.loads((copied / "Project.toml").read_text())
    pinned = {name: bounds.removeprefix("=") for name, bounds in project["compat"].items()}
    assert set(project["deps"]) == set(pinned) - {"julia"}
    of_julia = {"LinearAlgebra", "Random", "TOML"}
    for name in set(core["deps"]) - of_julia:
        assert project["deps"][name] == core["deps"][name]
        assert fits(pinned[name], core["compat"][name]), name
    assert f"juliacall=={pinned['PythonCall']}" in requires("pcnde-bridge")
    with pytest.raises(InputError, match="not an empty folder"):
        write_project(folder)
    assert fits("4.15.2", "4.6 - 4.15") and not fits("4.16.0", "4.6 - 4.15")
    assert not fits("2.0.1", "2.1") and not fits("0.10.0", "0.9.30")


def test_nothing_is_downloaded_unasked(bare, monkeypatch):
    juliapkg = pytest.importorskip("juliapkg")
    monkeypatch.setattr(juliapkg, "resolve", lambda dry_run: not dry_run)
    status = julia_status()
    assert not status.usable and status.installable and "downloads" in status.message
    monkeypatch.setenv("PYTHON_JULIAPKG_OFFLINE", "yes")
    status = julia_status()
    assert status.offline and not status.installable
    with pytest.raises(EngineUnavailableError, match="PYTHON_JULIACALL_EXE"):
        runtime.start()


def test_the_julia_sources_are_found_and_declared():
    project = julia_sources()
    declared = json.loads((project.parents[1] / "juliapkg.json").read_text())
    (name, entry), *others = declared["packages"].items()
    assert (name, others) == ("PCNDECore", []) and entry["dev"]
    assert (project.parents[1] / entry["path"]).samefile(project)
    text = (project / "Project.toml").read_text()
    assert f'uuid = "{entry["uuid"]}"' in text
    # juliapkg looks at what the core needs only when this file has changed.
    assert f'\nversion = "{entry["version"]}"' in text


def test_importing_the_module_starts_nothing():
    code = "import pcnde_bridge.engines.julia.engine, sys; assert 'juliacall' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


# ---------------------------------------------------------------- with Julia


@pytest.fixture(scope="module")
def engine():
    return JuliaEngine()


@pytest.fixture(scope="module")
def flow_problem(small_cases):
    cases = small_cases
    grid = cases.grid
    inputs = cases.inflow, undeformed(cases.area_undeformed, cases.n_times)
    vector = initial_parameters(PAPER, cases.n_times, cases.n_points, seed=0).flow
    return vector, FitData(inputs, cases.flow, grid, PAPER)


@pytest.mark.julia
def test_versions(engine):
    assert engine.name == "julia"
    assert {"julia", "PCNDECore", "OrdinaryDiffEqTsit5", "Lux", "Optim"} <= set(engine.versions)
    assert all(version[0].isdigit() for version in engine.versions.values())


@pytest.mark.julia
def test_it_travels_to_another_process_as_a_name(engine):
    assert pickle.loads(pickle.dumps(engine)) is select_engine("julia")  # noqa: S301


@pytest.mark.julia
def test_status_of_the_running_julia(engine):
    status = julia_status()
    assert status.usable and status.source == "running"
    assert status.packages["PCNDECore"] == engine.versions["PCNDECore"]


@pytest.mark.julia
def test_results_are_numpys_own(engine, flow_problem):
    vector, (inputs, target, grid, config) = flow_problem
    flow = engine.flow.solve(vector, inputs, grid, config)
    _, gradient = loss_and_gradient_of(engine.flow, vector, inputs, target, grid, config)
    fit = engine.flow.fit(vector, FitData(inputs, target, grid, config), 2)
    for array in (flow, gradient, fit.parameters, fit.losses):
        assert type(array) is np.ndarray and array.dtype == np.float64
        assert array.flags.owndata and array.flags.writeable and array.flags.c_contiguous


@pytest.mark.julia
def test_any_memory_layout_will_do(engine, flow_problem):
    vector, (inputs, _, grid, config) = flow_problem
    expected = engine.flow.solve(vector, inputs, grid, config)
    frozen = vector.copy()
    frozen.flags.writeable = False
    area = np.asfortranarray(inputs[1].astype(np.float64))
    twice = np.repeat(inputs[0], 2, axis=1)[:, ::2]
    found = engine.flow.solve(frozen, (twice, area), grid, config)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.julia
def test_an_objective_keeps_no_view_of_its_inputs(engine, flow_problem):
    vector, (inputs, target, grid, config) = flow_problem
    arrays = [*(a.copy() for a in (*inputs, target)), np.ones(len(target), bool)]
    data = FitData(tuple(arrays[:2]), arrays[2], grid, config)
    evaluate = engine.flow.objective(data, arrays[3])
    loss, gradient = evaluate(vector)
    for array in arrays:
        array[:] = 0
    again, same_gradient = evaluate(vector)
    assert again == loss
    np.testing.assert_array_equal(same_gradient, gradient)


@pytest.mark.julia
def test_a_case_does_not_depend_on_its_neighbours(engine, flow_problem):
    vector, (inputs, _, grid, config) = flow_problem
    together = engine.flow.solve(vector, inputs, grid, config)
    alone = engine.flow.solve(vector, tuple(array[[7]] for array in inputs), grid, config)
    np.testing.assert_array_equal(together[[7]], alone)


@pytest.mark.julia
def test_an_objective_counts_the_chosen_cases(engine, flow_problem):
    vector, (inputs, target, grid, config) = flow_problem
    chosen = np.arange(len(target)) % 3 == 1
    data = FitData(inputs, target, grid, config)
    objective = engine.flow.objective(data, chosen)
    some = tuple(array[chosen] for array in inputs)
    loss, gradient = loss_and_gradient_of(engine.flow, vector, some, target[chosen], grid, config)
    other = engine.flow.objective(data, ~chosen)
    for _ in range(2):  # Julia keeps one problem at a time
        found, by_objective = objective(vector)
        assert found == loss
        np.testing.assert_array_equal(by_objective, gradient)
        assert other(vector)[0] != loss


@pytest.mark.julia
@pytest.mark.parametrize("loss", ["mean", "sum"])
@pytest.mark.parametrize("steps", [12, None])
def test_both_engines_weigh_the_squares_of_the_cases(engine, flow_problem, loss, steps):
    vector, (inputs, target, grid, config) = flow_problem
    config = config.replace(flow={"loss": loss, "steps": steps})
    weight = np.random.default_rng(0).uniform(0.2, 3.0, size=len(target))
    weight[::3] = 0
    data = FitData(inputs, target, grid, config)
    found, gradient = engine.flow.objective(data, weight)(vector)
    jax = select_engine("jax").flow.objective(data, weight)
    expected, theirs = jax(vector)
    assert found == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(gradient, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())
    squares = (engine.flow.solve(vector, inputs, grid, config) - target) ** 2
    each = squares.sum(axis=(1, 2)) if loss == "sum" else squares.mean(axis=(1, 2))
    total = weight @ each / (1 if loss == "sum" else weight.sum())
    # Adaptive steps are those of all cases together, and here of each on its own.
    assert found == pytest.approx(total, rel=1e-10 if steps else 1e-3)


@pytest.mark.julia
def test_a_solve_that_fails_is_a_solve_error(engine, flow_problem):
    vector, (inputs, target, grid, config) = flow_problem
    broken = np.full_like(vector, np.nan)
    with pytest.raises(SolveError, match=r"case 0.*units"):
        engine.flow.solve(broken, inputs, grid, config)
    assert loss_and_gradient_of(engine.flow, broken, inputs, target, grid, config)[0] == np.inf
    with pytest.raises(SolveError, match="not finite at the first parameters"):
        engine.flow.fit(broken, FitData(inputs, target, grid, config), 2)
    few = config.replace(flow={"max_steps": 2})
    with pytest.raises(SolveError):
        engine.flow.solve(vector, inputs, grid, few)


@pytest.mark.julia
def test_julias_errors_keep_their_words(engine, flow_problem):
    vector, (inputs, _, grid, config) = flow_problem
    with pytest.raises(EngineError, match=r"the network has \d+ parameters, not 10"):
        engine.flow.solve(vector[:10], inputs, grid, config)


@pytest.mark.julia
def test_iterations_reach_python_and_errors_come_back(engine, flow_problem):
    seen = []
    fit = engine.flow.fit(*flow_problem, 3, lambda number, loss: seen.append((number, loss)))
    assert [number for number, _ in seen] == [1, 2, 3]
    assert [loss for _, loss in seen] == list(fit.losses[1:])

    class Enough(Exception):
        pass

    def stop(number, loss):
        if number == 2:
            raise Enough("as agreed")

    with pytest.raises(Enough, match="as agreed"):
        engine.flow.fit(*flow_problem, 5, stop)
    # The engine is as good as new.
    np.testing.assert_array_equal(engine.flow.fit(*flow_problem, 3).losses, fit.losses)


@pytest.mark.julia
@pytest.mark.skipif(os.name == "nt", reason="signals are sent otherwise there")
@pytest.mark.parametrize("listening", [True, False])
def test_ctrl_c_ends_a_fit(engine, flow_problem, listening):
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    vector, data = flow_problem
    patient = data.config.replace(optimizer={"gradient_tolerance": 0.0})
    run = vector, data._replace(config=patient), 1000
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        for _ in range(20):
            engine.flow.fit(*run, *([lambda *_: None] if listening else []))
    timer.cancel()
    assert np.isfinite(engine.flow.fit(*flow_problem, 1).losses).all()


@pytest.mark.julia
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_ctrl_c_that_python_drops_ends_a_fit(engine, flow_problem, drop_ctrl_c):
    heard = []

    def listen(number, loss):
        heard.append(number)
        if number == 2:
            drop_ctrl_c()

    with pytest.raises(KeyboardInterrupt):
        engine.flow.fit(*flow_problem, 5, listen)
    assert heard == [1, 2]


@pytest.mark.julia
def test_a_fork_is_refused(engine, flow_problem, monkeypatch):
    vector, (inputs, _, grid, config) = flow_problem
    monkeypatch.setattr(engine._julia, "_process", -1)
    with pytest.raises(EngineError, match="spawn"):
        engine.flow.solve(vector, inputs, grid, config)


def _in_a_worker(problem):
    vector, (inputs, _, grid, config) = problem
    return JuliaEngine().flow.solve(vector, inputs, grid, config)


@pytest.mark.julia
def test_a_spawned_worker_has_a_julia_of_its_own(engine, flow_problem):
    vector, (inputs, _, grid, config) = flow_problem
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.apply(_in_a_worker, (flow_problem,))
    np.testing.assert_array_equal(found, engine.flow.solve(vector, inputs, grid, config))


def run(code: str, input=None, cwd=None, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh Python, which inherits only Julia and its project from the engine."""
    environment = {
        name: value
        for name, value in os.environ.items()
        if name in (EXECUTABLE, PROJECT) or not name.startswith("PYTHON_JULIACALL")
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=input,
        cwd=cwd,
        env=environment | variables,
        capture_output=True,
        timeout=600,
    )
    done.stdout, done.stderr = done.stdout.decode(), done.stderr.decode()
    return done


@pytest.mark.julia
def test_it_works_after_jax_and_leaves_main_alone():
    done = run(
        "import jax, jax.numpy as jnp; before = jnp.arange(3.0) * 2\n"
        "from pcnde_bridge.engines.julia.engine import JuliaEngine\n"
        "engine = JuliaEngine()\n"
        "import juliacall, numpy as np\n"
        "assert not juliacall.Main.seval('isdefined(Main, :PCNDECore)')\n"
        "from pcnde_bridge.config import PAPER\n"
        "from pcnde_bridge.data.grid import Grid\n"
        "grid = Grid(np.arange(20) / 20, np.linspace(0, 4, 5), 1.0)\n"
        "inputs = (np.ones((2, 20, 5)), np.ones((2, 5)))\n"
        "area = engine.fourier_area.solve(np.ones(10), inputs, grid, PAPER)\n"
        "assert np.allclose(area, 2) and (jnp.arange(3.0) * 2 == before).all()\n"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.julia
def test_a_julia_started_by_another_package_is_used():
    if julia_status().source == "juliapkg":
        pytest.skip("the other package would start Julia elsewhere")
    done = run(
        "import warnings; warnings.simplefilter('error', RuntimeWarning)\n"
        "from pcnde_bridge import PCNDEWarning\n"
        "warnings.simplefilter('error', PCNDEWarning)\n"
        "from pcnde_bridge.engines.julia.engine import JuliaEngine\n"
        "from pcnde_bridge.engines.julia.environment import julia_status\n"
        "status = julia_status()\n"
        "import os; os.environ.update(status.environment)\n"
        "os.environ['PYTHON_JULIACALL_HANDLE_SIGNALS'] = 'yes'\n"
        "os.environ['PYTHON_JULIACALL_EXE'] = str(status.executable)\n"
        "os.environ['PYTHON_JULIACALL_PROJECT'] = str(status.project)\n"
        "import juliacall\n"
        "JuliaEngine(); JuliaEngine()\n"
        "print(julia_status())\n"
    )
    assert done.returncode == 0, done.stderr
    assert "handle_signals='yes'" in done.stdout


_THREADED = """
import gc, pickle, sys, threading, time
import numpy as np
from pcnde_bridge.engines.julia.engine import JuliaEngine
from pcnde_bridge.engines.julia.environment import julia_status
inputs, parameters = pickle.loads(sys.stdin.buffer.read())
engine = JuliaEngine()
print(julia_status())
import juliacall
collect = juliacall.Main.seval("GC.gc")
stop = threading.Event()
def beside():
    while not stop.is_set():
        gc.collect(0)
        time.sleep(0.01)
thread = threading.Thread(target=beside)
thread.start()
for _ in range(10):
    found = engine.predict(parameters, *inputs)
    collect(False)
stop.set()
thread.join()
np.savez("found.npz", *found[:3])
"""


@pytest.mark.julia
def test_a_julia_that_computes_otherwise_is_refused():
    done = run(
        "from pcnde_bridge.engines.julia import runtime\n"
        "from pcnde_bridge.errors import EngineUnavailableError\n"
        "runtime.start().Main.seval('using PCNDECore; PCNDECore.CHECKED_LOSSES[1] += 1e-3')\n"
        "try: runtime.running()\n"
        "except EngineUnavailableError as error: print(error)\n"
    )
    assert "do not compute the flow as the tested ones" in done.stdout, done.stderr
    assert "OrdinaryDiffEqCore 4." in done.stdout and "pcnde doctor" in done.stdout


@pytest.mark.julia
def test_two_threads_give_the_same_beside_pythons_threads(
    engine, flow_problem, small_cases, tmp_path
):
    cases = small_cases
    parameters = initial_parameters(PAPER, cases.n_times, cases.n_points, seed=0)
    grid, config = flow_problem[1][2:]
    inputs = ModelInputs(cases.inflow, cases.area_undeformed, grid), config
    done = run(
        _THREADED,
        input=pickle.dumps((inputs, parameters)),
        cwd=tmp_path,
        JULIA_NUM_THREADS="2",
    )
    assert done.returncode == 0, done.stderr
    assert "threads='2', handle_signals='yes'" in done.stdout
    expected = engine.predict(parameters, *inputs)[:3]
    with np.load(tmp_path / "found.npz") as found:
        for name, array in zip(found.files, expected, strict=True):
            np.testing.assert_array_equal(found[name], array)


_INTERRUPTED = """
import os, pickle, signal, sys, threading
from pcnde_bridge.engines.julia.engine import JuliaEngine
problem = pickle.loads(sys.stdin.buffer.read())
engine = JuliaEngine()
engine.flow.fit(*problem, 1)
threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    for _ in range(10000):
        engine.flow.fit(*problem, 1000)
except KeyboardInterrupt:
    print("interrupted")
engine.flow.fit(*problem, 1)
"""


@pytest.mark.julia
@pytest.mark.skipif(os.name == "nt", reason="signals are sent otherwise there")
def test_ctrl_c_ends_a_fit_with_two_threads(flow_problem):
    vector, data = flow_problem
    patient = data.config.replace(optimizer={"gradient_tolerance": 0.0})
    problem = vector, data._replace(config=patient)
    done = run(_INTERRUPTED, input=pickle.dumps(problem), JULIA_NUM_THREADS="2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "interrupted"


@pytest.mark.julia
def test_another_thread_is_refused(engine, flow_problem):
    vector, (inputs, _, grid, config) = flow_problem
    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(EngineError, match="in the thread that started it"),
    ):
        pool.submit(engine.flow.solve, vector, inputs, grid, config).result()


@pytest.mark.julia
def test_an_error_holds_nothing_of_julias(engine, flow_problem):
    vector, (inputs, _, grid, config) = flow_problem
    with pytest.raises(EngineError) as caught:
        engine.flow.solve(vector[:10], inputs, grid, config)
    assert "Stacktrace" in str(caught.value.__cause__)
    frame = caught.traceback[-1].frame.f_locals
    kinds = {type(value).__module__ for value in (*frame.values(), *caught.value.args)}
    assert "juliacall" not in kinds and caught.value.__context__ is None


@pytest.mark.julia
def test_many_small_calls_do_not_leak_warnings(engine, small_cases):
    grid = small_cases.grid
    inputs = small_cases.flow, small_cases.area_undeformed
    vector = np.ones(2 * small_cases.n_points)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(20):
            engine.fourier_area.solve(vector, inputs, grid, PAPER)
