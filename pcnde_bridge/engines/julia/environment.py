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

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcnde_bridge.errors import EngineUnavailableError

EXECUTABLE, PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
SIGNALS, THREADS = "PYTHON_JULIACALL_HANDLE_SIGNALS", "PYTHON_JULIACALL_THREADS"

_NEEDED = ("PCNDECore", "PythonCall")
_COMPUTING = (*_NEEDED, "OrdinaryDiffEqTsit5", "Lux", "Optim")
_OLDEST = (1, 10, 3)  # of juliacall


@dataclass(frozen=True)
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
        Variables to set for Julia unless they are set already.
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

    usable: bool
    message: str
    source: str
    installable: bool = False
    executable: Path | None = None
    project: Path | None = None
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)
    version: str | None = None
    packages: Mapping[str, str] = dataclasses.field(default_factory=dict)
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
    facts: dict[str, Any] = {"source": "environment", **_settings(os.environ)}
    try:
        facts |= _named()
        facts |= _settings(_variables(facts))
        if facts["source"] == "juliapkg":
            facts |= _by_juliapkg(facts)
        facts |= _executable(facts)
        facts |= _packages(facts)
    except EngineUnavailableError as error:
        return JuliaStatus(False, str(error), **facts)
    except (OSError, ValueError) as error:
        message = f"The Julia project cannot be read: {error}. {how_to_prepare()}"
        return JuliaStatus(False, message, **facts)
    message = f"Julia {facts['version']} with PCNDECore {facts['packages']['PCNDECore']} is ready"
    if not facts["precompiled"]:
        message += ", but not precompiled: the first start takes minutes"
    return JuliaStatus(True, f"{message}.", **facts)


def julia_settings_file() -> Path:
    """Return the path of the user's file that names a prepared Julia; it may not exist."""
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "pcnde_bridge" / "julia.json"


def julia_sources() -> Path:
    """Return the folder of the Julia package PCNDECore that belongs to this Python package."""
    package = Path(__file__).resolve().parents[2]
    for folder in (package, package.parent):  # a wheel, a checkout
        if (folder / "julia" / "PCNDECore" / "Project.toml").is_file():
            return folder / "julia" / "PCNDECore"
    raise EngineUnavailableError(
        f"The Julia sources are missing from {package}. Install pcnde_bridge again."
    )


def juliacall_settings(variables: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the defaults for juliacall's variables; the user's own values take precedence.

    Parameters
    ----------
    variables : mapping of str to str, optional
        The user's environment variables; by default, those of this process.
    """
    given = os.environ if variables is None else variables
    settings = {
        "PYTHON_JULIACALL_STARTUP_FILE": "no",
        "PYTHON_JULIACALL_AUTOLOAD_IPYTHON_EXTENSION": "no",
    }
    if "JULIA_NUM_THREADS" not in given:
        settings[THREADS] = "1"
    # With one thread Julia needs no signals, and Python keeps them all.  With more, the garbage
    # collector stops the other threads through SIGSEGV: unless Julia handles that signal, the
    # process dies (signal 11).
    settings[SIGNALS] = "no" if _threads(given) == "1" else "yes"
    return settings


def how_to_prepare() -> str:
    """Return instructions for machines where juliapkg cannot install Julia."""
    return (
        f"Prepare a project on a machine with network access ({_command('DIR')}), and name Julia "
        f"and that project in {julia_settings_file()} or in {EXECUTABLE} and {PROJECT}."
    )


def check_core(version: str, where: Path | str, project: Path | str) -> None:
    """Raise unless a project's PCNDECore is compatible with this package.

    Parameters
    ----------
    version : str
        Version of the project's PCNDECore.
    where, project : Path or str
        Its location and the project, for the message.

    Raises
    ------
    EngineUnavailableError
        With both versions and the command that updates the project.
    """
    ours = core_version(julia_sources()) or ""
    if not compatible(version, ours):
        raise EngineUnavailableError(
            f"The Julia project {project} has PCNDECore {version} ({where}), and pcnde_bridge "
            f"needs {ours}. Update it with: {_command(project)}"
        )


def core_version(folder: Path) -> str | None:
    """Return the version of the PCNDECore in a folder."""
    version: str | None = _toml(folder / "Project.toml").get("version")
    return version


def compatible(version: str, other: str) -> bool:
    """Return whether two versions agree up to their first non-zero number."""
    numbers, others = (re.findall(r"\d+", v) for v in (version, other))
    significant = 1 if numbers[:1] != ["0"] else 2
    return numbers[:significant] == others[:significant]


def _named() -> dict[str, Any]:
    """Return the source and, unless that is juliapkg, the executable and the project."""
    juliacall = sys.modules.get("juliacall")
    if juliacall is not None and juliacall.CONFIG.get("inited"):
        return _paths("running", juliacall.CONFIG.get("exepath"), juliacall.CONFIG.get("project"))
    executable, project = os.environ.get(EXECUTABLE), os.environ.get(PROJECT)
    if executable and project:
        return _paths("environment", executable, project)
    if executable or project:
        raise EngineUnavailableError(
            f"{EXECUTABLE} and {PROJECT} must be set together: set the other one too, or neither."
        )
    file = julia_settings_file()
    if not file.is_file():
        return {"source": "juliapkg"}
    try:
        settings = json.loads(file.read_text(encoding="utf-8"))
        named = _paths("file", settings["executable"], settings["project"])
        variables = {str(k): str(v) for k, v in settings.get("environment", {}).items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise EngineUnavailableError(
            f"{file} cannot be read as Julia settings ({error!r}): it needs the JSON keys "
            '"executable" and "project". Correct or remove it.'
        ) from error
    return {**named, "environment": variables}


def _paths(source: str, executable: str | None, project: str | None) -> dict[str, Any]:
    return {
        "source": source,
        "executable": Path(executable or "julia"),
        "project": Path(project or ""),
    }


def _by_juliapkg(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the executable and project that juliapkg has installed."""
    try:
        import juliapkg

        if juliapkg.resolve(dry_run=True):
            return _paths("juliapkg", juliapkg.executable(), juliapkg.project())
    except Exception as error:
        raise EngineUnavailableError(
            f"juliapkg, which installs Julia, failed: {error}. {how_to_prepare()}"
        ) from error
    if facts["offline"]:
        raise EngineUnavailableError(
            "Julia is not installed, and PYTHON_JULIAPKG_OFFLINE forbids its installation. "
            f"{how_to_prepare()}"
        )
    facts["installable"] = True
    raise EngineUnavailableError(
        'Julia is not installed yet: engine="julia" downloads it and its packages once '
        f"(some minutes, about 2 GB). For a machine without network access: {how_to_prepare()}"
    )


def _executable(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the checked executable and its version."""
    from juliapkg.find_julia import julia_version

    named = {"environment": EXECUTABLE, "file": str(julia_settings_file())}
    where = named.get(facts["source"], facts["source"])
    executable = shutil.which(facts["executable"])
    if executable is None:
        raise EngineUnavailableError(
            f"There is no Julia at {facts['executable']}, which {where} names. Correct it there."
        )
    version = julia_version(executable)
    if version is None:
        raise EngineUnavailableError(f"{executable} does not run as Julia. Correct it in {where}.")
    if (version.major, version.minor, version.patch) < _OLDEST:
        oldest = ".".join(map(str, _OLDEST))
        raise EngineUnavailableError(
            f"Julia {version} at {executable} is too old: {oldest} or newer is needed."
        )
    return {"executable": Path(executable), "version": str(version)}


def _packages(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the checked packages of the project."""
    project = facts["project"]
    versions, core = _read_manifest(project)
    missing = [name for name in _NEEDED if not versions.get(name)]
    if core is not None:  # its sources can be newer than the manifest
        dependencies = _toml(core / "Project.toml").get("deps", {})
        missing += [name for name in dependencies if name not in versions]
    if missing:
        raise EngineUnavailableError(
            f"The Julia project {project} lacks {', '.join(missing)}. Add what is missing "
            f"with: {_command(project)}"
        )
    check_core(versions["PCNDECore"], core or project, project)
    depots = _variables(facts).get("JULIA_DEPOT_PATH", "")
    return {
        "packages": {name: versions[name] for name in _COMPUTING if versions.get(name)},
        "precompiled": _is_precompiled(facts["version"], depots),
        "warning": _difference(core),
    }


def _read_manifest(project: Path) -> tuple[dict[str, str], Path | None]:
    """Return the versions of all packages, and PCNDECore's own folder if it has one."""
    versions: dict[str, str] = {}
    core = None
    for file in sorted(project.glob("*Manifest*.toml"))[:1]:
        for name, (entry, *_) in _toml(file).get("deps", {}).items():
            versions[name] = entry.get("version", "")
            if name == "PCNDECore" and "path" in entry:
                core = project / entry["path"]
                # The manifest has the version of the day on which it was written.
                versions[name] = core_version(core) or versions[name] or "missing"
    return versions, core


def _toml(file: Path) -> dict[str, Any]:
    """Return the contents of a TOML file; empty if it does not exist."""
    return tomllib.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def _difference(core: Path | None) -> str:
    """Return a warning if a project's PCNDECore differs from this package's."""
    ours = julia_sources()
    if core is None or _contents(core) == _contents(ours):
        return ""
    return (
        f"The project has PCNDECore from {core}, which differs from this package's {ours}: "
        "the former runs."
    )


def _contents(package: Path) -> dict[str, bytes]:
    files = [package / "Project.toml", *(package / "src").rglob("*.jl")]
    return {str(file.relative_to(package)): file.read_bytes() for file in files if file.is_file()}


def _is_precompiled(version: str, depots: str) -> bool:
    """Return whether a depot has a compiled PCNDECore for this version of Julia."""
    folders = [d for d in depots.split(os.pathsep) if d] or [str(Path.home() / ".julia")]
    major_minor = ".".join(version.split(".")[:2])
    pattern = f"compiled/v{major_minor}/PCNDECore/*.ji"
    return any(any(Path(folder).glob(pattern)) for folder in folders)


def _command(project: Path | str) -> str:
    """Return the command that adds this package's PCNDECore, and PythonCall, to a project."""
    return (
        f"julia --project={project} -e 'using Pkg; "
        f'Pkg.develop(path="{julia_sources()}"); Pkg.add(name="PythonCall", version="0.9.34"); '
        "Pkg.precompile()'"
    )


def _variables(facts: Mapping[str, Any]) -> dict[str, str]:
    """Return the environment variables with which Julia starts."""
    return {**facts.get("environment", {}), **os.environ}


def _settings(variables: Mapping[str, str]) -> dict[str, Any]:
    """Return the settings with which Julia starts, or was started."""
    juliacall = sys.modules.get("juliacall")
    if juliacall is not None and juliacall.CONFIG.get("inited"):
        threads = juliacall.CONFIG.get("opt_threads") or "1"
        signals = juliacall.CONFIG.get("opt_handle_signals")
        signals = signals if isinstance(signals, str) else ("yes" if signals else "no")
    else:
        threads = _threads(variables)
        signals = {**juliacall_settings(variables), **variables}[SIGNALS]
    offline = variables.get("PYTHON_JULIAPKG_OFFLINE") == "yes" or (
        variables.get("JULIA_PKG_OFFLINE", "").lower() == "true"
    )
    return {"threads": str(threads), "handle_signals": signals, "offline": offline}


def _threads(variables: Mapping[str, str]) -> str:
    """Return the user's choice of threads, as juliacall reads it."""
    return variables.get(THREADS, variables.get("JULIA_NUM_THREADS", "1"))
