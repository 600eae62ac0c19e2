"""Which Julia is used, and whether it is usable; starts and installs nothing.

Which Julia, and which project with its packages, is decided in this order:

1. the environment variables ``PYTHON_JULIACALL_EXE`` and ``PYTHON_JULIACALL_PROJECT``,
   both or neither, as juliacall defines them;
2. the user's file ``~/.config/pcnde_bridge/julia.json`` (under ``XDG_CONFIG_HOME`` if
   that is set), for machines whose Julia was prepared by hand::

       {
         "executable": "/path/to/julia",
         "project": "/path/to/a/project/with/PCNDECore/and/PythonCall",
         "environment": {"JULIA_DEPOT_PATH": "/path/to/depot"}
       }

   ``environment``, optional, holds variables for Julia; what is set already stays;
3. juliapkg, which downloads Julia and the packages of ``juliapkg.json`` once, on the
   first use of ``engine="julia"``, unless ``PYTHON_JULIAPKG_OFFLINE=yes``.

:func:`julia_status` says what would be used, without starting or installing it.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcnde_bridge.engines.julia.project import (
    compatible,
    core_version,
    dependencies,
    difference_of_cores,
    incompatible,
    is_precompiled,
    julia_sources,
    read_manifest,
    recipe,
)
from pcnde_bridge.errors import EngineUnavailableError

__all__ = ["JuliaStatus", "julia_settings_file", "julia_status"]

EXECUTABLE, PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
_NEEDED = ("PCNDECore", "PythonCall")
_COMPUTING = (*_NEEDED, "OrdinaryDiffEqTsit5", "Lux", "Optim")
_OLDEST = (1, 10)

SIGNALS, THREADS = "PYTHON_JULIACALL_HANDLE_SIGNALS", "PYTHON_JULIACALL_THREADS"

# Set before Julia starts, unless the user has set them; juliacall_settings adds signals.
_JULIACALL_SETTINGS = {
    THREADS: "1",
    "PYTHON_JULIACALL_STARTUP_FILE": "no",
    "PYTHON_JULIACALL_AUTOLOAD_IPYTHON_EXTENSION": "no",
}


@dataclass(frozen=True)
class JuliaStatus:
    """What is known of Julia on this machine without starting it.

    Attributes
    ----------
    usable : bool
        Whether the engine can start now, with nothing to install.
    installable : bool
        Whether making an engine would let juliapkg install what is missing.
    message : str
        Why, and if it is not usable, how to mend it.
    source : {'environment', 'file', 'juliapkg', 'running'}
        What names the executable and the project.
    executable, project : Path or None
        Julia's program and the project with its packages.
    version : str or None
        Julia's version.
    packages : mapping of str to str
        Versions of the project's packages that compute.
    precompiled : bool
        Whether PCNDECore has been precompiled; if not, the first start takes minutes.
    offline : bool
        Whether nothing may be downloaded.
    threads, handle_signals : str
        Settings that Julia starts, or has been started, with.
    warning : str
        What is odd although it can be used; empty if nothing is.
    """

    usable: bool
    installable: bool
    message: str
    source: str
    executable: Path | None = None
    project: Path | None = None
    version: str | None = None
    packages: Mapping[str, str] = dataclasses.field(default_factory=dict)
    precompiled: bool = False
    offline: bool = False
    threads: str = "1"
    handle_signals: str = "no"
    warning: str = ""


def julia_settings_file() -> Path:
    """Path of the user's file that names a prepared Julia; it need not exist."""
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "pcnde_bridge" / "julia.json"


def julia_status() -> JuliaStatus:
    """Say whether Julia is usable, and why; starts and installs nothing.

    Returns
    -------
    JuliaStatus
        Never raises; whatever is wrong is in its message.
    """
    try:
        return status_of(choose())
    except EngineUnavailableError as error:
        message = str(error)
    except (OSError, ValueError) as error:  # files of a project that cannot be read
        message = f"The Julia project cannot be read: {error}. {how_to_prepare()}"
    return JuliaStatus(False, False, message, "environment", **_settings())


@dataclass(frozen=True)
class Choice:
    """What names the Julia to use: ``source`` as in :class:`JuliaStatus`."""

    source: str
    executable: str | None = None
    project: str | None = None
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)


def choose() -> Choice:
    """Find what names the Julia to use, in the order of this module's docstring.

    Raises
    ------
    EngineUnavailableError
        If it is named by halves, or in a file that cannot be read.
    """
    juliacall = sys.modules.get("juliacall")
    if juliacall is not None and juliacall.CONFIG.get("inited"):
        return Choice("running", juliacall.CONFIG.get("exepath"), juliacall.CONFIG.get("project"))
    executable, project = os.environ.get(EXECUTABLE), os.environ.get(PROJECT)
    if executable or project:
        if not (executable and project):
            raise EngineUnavailableError(
                f"{EXECUTABLE} and {PROJECT} must be set together: set the other one too, "
                "or neither."
            )
        return Choice("environment", executable, project)
    file = julia_settings_file()
    if file.is_file():
        return _from_file(file)
    return Choice("juliapkg")


def _from_file(file: Path) -> Choice:
    try:
        settings = json.loads(file.read_text(encoding="utf-8"))
        executable, project = str(settings["executable"]), str(settings["project"])
        environment = {str(k): str(v) for k, v in settings.get("environment", {}).items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise EngineUnavailableError(
            f"{file} cannot be read as Julia's settings ({error!r}): it needs the JSON keys "
            '"executable" and "project". Mend or remove it.'
        ) from error
    return Choice("file", executable, project, environment)


def status_of(choice: Choice) -> JuliaStatus:
    """Return the status of the Julia that a choice names."""
    if choice.source == "juliapkg":
        return _juliapkg_status()
    named = {"environment": f"{EXECUTABLE}", "file": f"{julia_settings_file()}"}.get(choice.source)
    facts: dict[str, Any] = {"source": choice.source, **_settings()}
    executable = shutil.which(choice.executable or "julia")
    if executable is None:
        return JuliaStatus(
            False,
            False,
            f"There is no Julia at {choice.executable}, which {named} names. Correct it there.",
            **facts,
        )
    facts |= {"executable": Path(executable), "version": _julia_version(executable)}
    if facts["version"] is None:
        message = f"{executable} does not run as Julia. Correct it in {named}."
        return JuliaStatus(False, False, message, **facts)
    version = tuple(int(n) for n in re.findall(r"\d+", facts["version"])[:2])
    if version < _OLDEST:
        message = f"Julia {facts['version']} at {executable} is too old: 1.10 or newer is needed."
        return JuliaStatus(False, False, message, **facts)
    return _project_status(Path(choice.project or ""), choice.environment, facts)


def _project_status(
    project: Path, environment: Mapping[str, str], facts: dict[str, Any]
) -> JuliaStatus:
    """Status once Julia itself is known to run."""
    versions, core = read_manifest(project)
    packages = {name: versions[name] for name in _COMPUTING if versions.get(name)}
    facts |= {"project": project, "packages": packages, "warning": difference_of_cores(core)}
    missing = [name for name in _NEEDED if name not in packages]
    missing += [name for name in dependencies(core) if name not in versions]
    if missing:
        message = (
            f"The Julia project {project} lacks {', '.join(missing)}. Add what is missing "
            f"with: {recipe(project)}"
        )
        return JuliaStatus(False, False, message, **facts)
    ours = core_version(julia_sources()) or ""
    if not compatible(packages["PCNDECore"], ours):
        message = incompatible(packages["PCNDECore"], f"{core or project}", ours, project)
        return JuliaStatus(False, False, message, **facts)
    precompiled = is_precompiled(facts["version"], environment)
    message = f"Julia {facts['version']} with PCNDECore {packages['PCNDECore']} is ready" + (
        "." if precompiled else ", but not precompiled: the first start takes minutes."
    )
    return JuliaStatus(True, False, message, precompiled=precompiled, **facts)


def _juliapkg_status() -> JuliaStatus:
    facts: dict[str, Any] = {"source": "juliapkg", **_settings()}
    try:
        import juliapkg

        resolved = juliapkg.resolve(dry_run=True)
        if resolved:
            executable, project = juliapkg.executable(), Path(juliapkg.project())
            facts |= {"executable": Path(executable), "version": _julia_version(executable)}
            if facts["version"] is not None:
                return _project_status(project, {}, facts)
    except Exception as error:
        message = f"juliapkg, which installs Julia, failed: {error}. {how_to_prepare()}"
        return JuliaStatus(False, False, message, **facts)
    if facts["offline"]:
        message = (
            f"Julia is not installed, and PYTHON_JULIAPKG_OFFLINE forbids it. {how_to_prepare()}"
        )
        return JuliaStatus(False, False, message, **facts)
    message = (
        'Julia is not installed yet: engine="julia" downloads it and its packages once '
        f"(some minutes, about 2 GB). Without a network: {how_to_prepare()}"
    )
    return JuliaStatus(False, True, message, **facts)


def _settings() -> dict[str, Any]:
    """Return the settings that Julia starts, or was started, with."""
    juliacall = sys.modules.get("juliacall")
    if juliacall is not None and juliacall.CONFIG.get("inited"):
        threads = juliacall.CONFIG.get("opt_threads") or "1"
        signals = juliacall.CONFIG.get("opt_handle_signals")
        signals = signals if isinstance(signals, str) else ("yes" if signals else "no")
    else:
        wanted = {**juliacall_settings(), **os.environ}
        threads, signals = _threads(), wanted[SIGNALS]
    offline = os.environ.get("PYTHON_JULIAPKG_OFFLINE") == "yes" or (
        os.environ.get("JULIA_PKG_OFFLINE", "").lower() == "true"
    )
    return {"threads": str(threads), "handle_signals": signals, "offline": offline}


def _threads() -> str:
    """Julia's threads, as the user wants them and juliacall reads it."""
    return os.environ.get(THREADS, os.environ.get("JULIA_NUM_THREADS", "1"))


def juliacall_settings() -> dict[str, str]:
    """Return juliacall's variables, which hold unless the user has set others."""
    settings = dict(_JULIACALL_SETTINGS)
    if "JULIA_NUM_THREADS" in os.environ:
        del settings[THREADS]
    # With one thread Julia needs no signals, and Python keeps them all. With more, a thread
    # that collects garbage stops the others by letting them run into SIGSEGV on purpose:
    # unless Julia handles that signal, the process dies of it (signal 11). The price is
    # Ctrl-C, which Julia then takes from Python and does not act upon during a fit.
    settings[SIGNALS] = "no" if _threads() == "1" else "yes"
    return settings


@functools.lru_cache
def _julia_version(executable: str) -> str | None:
    try:
        result = subprocess.run(
            [executable, "--version"], capture_output=True, text=True, timeout=60, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    found = re.fullmatch(r"julia version (\S+)", result.stdout.strip())
    return found[1] if found else None


def how_to_prepare() -> str:
    """Return what to do where juliapkg cannot install Julia."""
    return (
        f"Prepare a project where there is one ({recipe('DIR')}), and name Julia and that "
        f"project in {julia_settings_file()} or in {EXECUTABLE} and {PROJECT}."
    )
