"""Julia environment of this machine: which Julia and project are used, and whether they are usable.

They are named by the first of these that is present:

1. a Julia that another package has started in this process;
2. the environment variables ``PYTHON_JULIACALL_EXE`` and ``PYTHON_JULIACALL_PROJECT`` of
   juliacall, which must be set together;
3. the user's file ``~/.config/pcnde_bridge/julia.json`` (under ``XDG_CONFIG_HOME`` if
   that is set), for machines whose Julia was prepared by hand::

       {
         "executable": "/path/to/julia",
         "project": "/path/to/a/project/with/PCNDECore/and/PythonCall",
         "environment": {"JULIA_DEPOT_PATH": "/path/to/depot"}
       }

   ``environment`` is optional; its variables do not replace those that are already set;
4. juliapkg, which downloads Julia and the packages of ``juliapkg.json`` once, on the
   first use of ``engine="julia"``, unless ``PYTHON_JULIAPKG_OFFLINE=yes``.
"""

import json
import os
import shutil
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcnde_bridge.errors import EngineUnavailableError, FileError, InputError

EXECUTABLE, PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
SIGNALS, THREADS = "PYTHON_JULIACALL_HANDLE_SIGNALS", "PYTHON_JULIACALL_THREADS"

_COMPUTING = ("PCNDECore", "PythonCall", "OrdinaryDiffEqTsit5", "Lux", "Optim")
_OLDEST = "1.10.3"  # of juliacall
_PARTS = "Project.toml", "src/**/*.jl", "ext/*.jl"  # of a Julia package
_OWN = {"PYTHON_JULIACALL_STARTUP_FILE": "no", "PYTHON_JULIACALL_AUTOLOAD_IPYTHON_EXTENSION": "no"}
_OF_JULIACALL = (  # variable, its key in the configuration of a running juliacall, and default
    (EXECUTABLE, "exepath", "julia"),
    (PROJECT, "project", ""),
    (THREADS, "opt_threads", "1"),
    (SIGNALS, "opt_handle_signals", "no"),
)


@dataclass
class JuliaStatus:
    """Julia on this machine, examined without starting it.

    Attributes
    ----------
    usable : bool
        Whether the engine can start now, with nothing to install.
    message : str
        Reason, and what to do if Julia is not usable.
    source : {'running', 'environment', 'file', 'juliapkg'}
        Origin of the executable and the project; see this module's docstring.
    installable : bool
        Whether juliapkg would install what is missing when an engine is created.
    executable, project : Path or None
        Julia's program, and the project with its packages.
    environment : mapping of str to str
        Variables to set before Julia starts; none of them is set in this process.
    version : str or None
        Julia's version.
    packages : mapping of str to str
        Versions of the packages that compute.
    precompiled : bool
        Whether PCNDECore is precompiled; otherwise the first start takes minutes.
    offline : bool
        Whether downloads are disabled.
    threads, handle_signals : str
        Settings with which Julia starts, or was started.
    warning : str
        Problem that does not prevent its use; may be empty.
    """

    usable: bool = False
    message: str = ""
    source: str = "environment"
    installable: bool = False
    executable: Path | None = None
    project: Path | None = None
    environment: Mapping[str, str] = field(default_factory=dict)
    version: str | None = None
    packages: Mapping[str, str] = field(default_factory=dict)
    precompiled: bool = False
    offline: bool = False
    threads: str = "1"
    handle_signals: str = "no"
    warning: str = ""


def julia_status() -> JuliaStatus:
    """Examine Julia without starting or installing it.

    Returns
    -------
    JuliaStatus
        Problems are reported in its message; nothing is raised.
    """
    status = JuliaStatus()
    try:
        variables = _read_settings(status)
        if status.source == "juliapkg":
            _ask_juliapkg(status)
        status.version = _check_executable(status)
        _check_packages(status, variables.get("JULIA_DEPOT_PATH", ""))
    except EngineUnavailableError as error:
        status.message = str(error)
    except (OSError, ValueError) as error:
        status.message = f"The Julia project cannot be read: {error}. {how_to_prepare()}"
    else:
        core, status.usable = status.packages["PCNDECore"], True
        slow = "" if status.precompiled else ", but not precompiled: the first start takes minutes"
        status.message = f"Julia {status.version} with PCNDECore {core} is ready{slow}."
    return status


def julia_settings_file() -> Path:
    """Return the path of the user's file that names a prepared Julia; it may not exist."""
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "pcnde_bridge" / "julia.json"


def julia_sources() -> Path:
    """Return the folder of the Julia package PCNDECore that belongs to this Python package."""
    _, _, package, checkout, *_ = Path(__file__).resolve().parents
    for folder in (package / "julia" / "PCNDECore", checkout / "julia" / "PCNDECore"):
        if (folder / "Project.toml").is_file():
            return folder
    raise EngineUnavailableError(
        f"The Julia sources are missing from {package}. Install pcnde_bridge again."
    )


def how_to_prepare() -> str:
    """Return instructions for machines where juliapkg cannot install Julia."""
    return (
        "Prepare a project on a machine with network access (pcnde doctor --write-project DIR), "
        f"and name Julia and that project in {julia_settings_file()} or in {EXECUTABLE} and "
        f"{PROJECT}."
    )


def write_project(folder: Path) -> str:
    """Write a Julia project with PCNDECore and the tested version of every other package.

    Parameters
    ----------
    folder : Path
        A new folder, or an empty one.

    Returns
    -------
    str
        Commands that install the packages, and the settings that select the project.

    Raises
    ------
    InputError
        If the folder contains something.
    FileError
        If it cannot be written.
    """
    sources = julia_sources()
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} exists and is not an empty folder: name a new one.")
        for part in _PARTS:
            for file in sources.glob(part):
                target = folder / sources.name / file.relative_to(sources)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, target)
        shutil.copyfile(sources.parent / "tested_versions.toml", folder / "Project.toml")
    except OSError as error:
        raise FileError(f"The project cannot be written to {folder}: {error}.") from error
    environment = {"JULIA_DEPOT_PATH": "/path/to/depot"}
    named = {"executable": "/path/to/julia", "project": str(folder), "environment": environment}
    return (
        f"The project is in {folder}. Install its packages with Julia {_OLDEST} or newer, on a "
        f"machine with network access:\n"
        f"  cd {folder}\n"
        "  julia --project=. -e 'using Pkg; Pkg.develop(path=\"PCNDECore\"); Pkg.precompile()'\n"
        "Copy the folder and Julia's depot (by default ~/.julia) to the machine without network "
        f"access, and write their paths there into {julia_settings_file()}:\n"
        f"  {json.dumps(named)}\n"
        "Then pcnde doctor --load compiles the packages there and reports errors."
    )


def check_core(version: str, where: Path | str, project: Path | str) -> None:
    """Raise unless a project's PCNDECore is compatible with this package.

    Parameters
    ----------
    version : str
        Version of the project's PCNDECore; only its last number may differ from ours.
    where, project : Path or str
        Its location and the project, for the message.

    Raises
    ------
    EngineUnavailableError
        With both versions and the command that updates the project.
    """
    ours = core_version(julia_sources())
    if version.rpartition(".")[0] != ours.rpartition(".")[0]:
        raise EngineUnavailableError(
            f"The Julia project {project} has PCNDECore {version} ({where}), and pcnde_bridge "
            f"needs {ours}. Update it with: {_command(project)}"
        )


def core_version(folder: Path) -> str:
    """Return the version of the PCNDECore in a folder; empty if it has none."""
    return str(_toml(folder / "Project.toml").get("version", ""))


def _read_settings(status: JuliaStatus) -> dict[str, str]:
    """Enter the settings with which Julia starts, or was started; return all variables."""
    config = getattr(sys.modules.get("juliacall"), "CONFIG", {})
    if config.get("inited"):
        status.source = "running"
        variables: dict[str, str] = {**os.environ}
        for name, key, default in _OF_JULIACALL:
            variables[name] = str(config.get(key) or default)
    else:
        given = [name for name in (EXECUTABLE, PROJECT) if os.environ.get(name)]
        if len(given) == 1:
            raise EngineUnavailableError(f"Set {EXECUTABLE} and {PROJECT} together, or neither.")
        variables = {**_OWN, **({} if given else _read_file(status)), **os.environ}
    if variables.get(EXECUTABLE):
        status.executable, status.project = Path(variables[EXECUTABLE]), Path(variables[PROJECT])
    else:
        status.source = "juliapkg"
    status.threads = variables.get(THREADS, variables.get("JULIA_NUM_THREADS", "1"))
    # With one thread Julia needs no signals, and Python keeps them all.  With more, the garbage
    # collector stops the other threads through SIGSEGV: unless Julia handles that signal, the
    # process dies (signal 11).
    variables.setdefault(SIGNALS, "no" if status.threads == "1" else "yes")
    status.handle_signals = variables[SIGNALS]
    status.offline = variables.get("PYTHON_JULIAPKG_OFFLINE") == "yes" or (
        variables.get("JULIA_PKG_OFFLINE", "").lower() == "true"
    )
    if status.source != "running":
        status.environment = {k: v for k, v in variables.items() if k not in os.environ}
    return variables


def _read_file(status: JuliaStatus) -> dict[str, str]:
    """Return the variables that the user's file sets; none without the file."""
    file = julia_settings_file()
    if not file.is_file():
        return {}
    status.source = "file"
    try:
        settings = json.loads(file.read_text(encoding="utf-8"))
        named = {EXECUTABLE: settings["executable"], PROJECT: settings["project"]}
        return {k: str(v) for k, v in {**settings.get("environment", {}), **named}.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise EngineUnavailableError(
            f"{file} cannot be read as Julia settings ({error!r}): it needs the JSON keys "
            '"executable" and "project". Correct or remove it.'
        ) from error


def _ask_juliapkg(status: JuliaStatus) -> None:
    """Enter the executable and project that juliapkg has installed."""
    try:
        import juliapkg

        if juliapkg.resolve(dry_run=True):
            status.executable, status.project = map(
                Path, (juliapkg.executable(), juliapkg.project())
            )
            return
    except Exception as error:
        raise EngineUnavailableError(
            f"juliapkg, which installs Julia, failed: {error}. {how_to_prepare()}"
        ) from error
    status.installable = not status.offline
    reason = "and PYTHON_JULIAPKG_OFFLINE forbids its installation."
    if status.installable:
        reason = (
            'yet: engine="julia" downloads it and its packages once (some minutes, about 2 GB). '
            "For a machine without network access:"
        )
    raise EngineUnavailableError(f"Julia is not installed {reason} {how_to_prepare()}")


def _check_executable(status: JuliaStatus) -> str:
    """Return Julia's version, unless Julia cannot be used."""
    from juliapkg.find_julia import julia_version

    executable, version = status.executable, julia_version(str(status.executable))
    if version is None:
        named = {"environment": EXECUTABLE, "file": str(julia_settings_file())}
        where = named.get(status.source, status.source)
        problem = f"{executable}, which {where} names, does not run as Julia. Correct it there."
    elif version < _OLDEST:
        problem = f"Julia {version} at {executable} is too old: {_OLDEST} or newer is needed."
    else:
        return str(version)
    raise EngineUnavailableError(problem)


def _check_packages(status: JuliaStatus, depots: str) -> None:
    """Enter the packages of the project, unless some are missing or do not fit."""
    project = status.project or Path()
    manifest = next(iter(sorted(project.glob("*Manifest*.toml"))), project / "Manifest.toml")
    entries = {name: entry for name, (entry, *_) in _toml(manifest).get("deps", {}).items()}
    versions = {name: entry.get("version", "Julia's own") for name, entry in entries.items()}
    ours, where, needed = julia_sources(), project, ["PCNDECore", "PythonCall"]
    if "path" in entries.get("PCNDECore", {}):
        # The manifest has the version of the day on which it was written.
        where = project / entries["PCNDECore"]["path"]
        versions["PCNDECore"] = core_version(where)
        needed += _toml(where / "Project.toml").get("deps", {})
        if _contents(where) != _contents(ours):
            status.warning = (
                f"The project has PCNDECore from {where}, which differs from this package's "
                f"{ours}: the former runs."
            )
    if missing := [name for name in needed if not versions.get(name)]:
        raise EngineUnavailableError(
            f"The Julia project {project} lacks {', '.join(missing)}. Add what is missing "
            f"with: {_command(project)}"
        )
    check_core(versions["PCNDECore"], where, project)
    status.packages = {name: versions[name] for name in _COMPUTING if versions.get(name)}
    compiled = f"compiled/v{str(status.version).rpartition('.')[0]}/PCNDECore/*.ji"
    folders = [folder for folder in depots.split(os.pathsep) if folder] or ["~/.julia"]
    status.precompiled = any(any(Path(folder).expanduser().glob(compiled)) for folder in folders)


def _toml(file: Path) -> dict[str, Any]:
    """Return the contents of a TOML file; empty if it does not exist."""
    return tomllib.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def _contents(package: Path) -> dict[Path, bytes]:
    """Return the files of a Julia package that Julia runs."""
    files = [file for part in _PARTS for file in package.glob(part)]
    return {file.relative_to(package): file.read_bytes() for file in files}


def _command(project: Path | str) -> str:
    """Return the command that adds this package's PCNDECore, and PythonCall, to a project."""
    return (
        f"julia --project={project} -e 'using Pkg; "
        f'Pkg.develop(path="{julia_sources()}"); Pkg.add(name="PythonCall", version="0.9.34"); '
        "Pkg.precompile()'"
    )
