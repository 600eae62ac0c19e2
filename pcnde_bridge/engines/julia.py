"""The Julia engine: Tsit5, Lux and Optim.jl's BFGS over juliacall.

Julia starts when a :class:`JuliaEngine` is made, not when this module is imported.
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
import threading
import types
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.engines.base import (
    Fit,
    FlowInputs,
    FourierAreaInputs,
    Grid,
    IntermediateAreaInputs,
    OnIteration,
    Solution,
    SpatialPressureInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.errors import EngineError, EngineUnavailableError, SolveError
from pcnde_bridge.inference import predict_by_stages
from pcnde_bridge.parameters import Parameters

__all__ = ["JuliaEngine", "JuliaStatus", "julia_settings_file", "julia_sources", "julia_status"]

Array = npt.NDArray[np.float64]
InputsT = TypeVar("InputsT")

_EXECUTABLE, _PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
_NEEDED = ("PCNDECore", "PythonCall")
_OLDEST = (1, 10)

# Set before Julia starts, unless the user has set them.
_JULIACALL_SETTINGS = {
    # Python keeps Ctrl-C: it is seen between two iterations, as KeyboardInterrupt.
    "PYTHON_JULIACALL_HANDLE_SIGNALS": "no",
    # With more threads Julia's garbage collector needs the signals that Python keeps.
    "PYTHON_JULIACALL_THREADS": "1",
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
        Whether making a :class:`JuliaEngine` would let juliapkg install what is missing.
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


def julia_settings_file() -> Path:
    """Path of the user's file that names a prepared Julia; it need not exist."""
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "pcnde_bridge" / "julia.json"


def julia_sources() -> Path:
    """Folder of the Julia package PCNDECore that belongs to this Python package."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package, package.parent):  # a wheel, a checkout
        if (folder / "julia" / "PCNDECore" / "Project.toml").is_file():
            return folder / "julia" / "PCNDECore"
    raise EngineUnavailableError(
        f"The Julia sources are missing from {package}. Install pcnde_bridge again."
    )


def julia_status() -> JuliaStatus:
    """Say whether Julia is usable, and why; starts and installs nothing.

    Returns
    -------
    JuliaStatus
        Never raises; whatever is wrong is in its message.
    """
    try:
        return _status(_choice())
    except EngineUnavailableError as error:
        return JuliaStatus(False, False, str(error), "environment", **_settings())


# --------------------------------------------------------------------- which Julia


@dataclass(frozen=True)
class _Choice:
    """What names the Julia to use: ``source`` as in :class:`JuliaStatus`."""

    source: str
    executable: str | None = None
    project: str | None = None
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)


def _choice() -> _Choice:
    juliacall = sys.modules.get("juliacall")
    if juliacall is not None and juliacall.CONFIG.get("inited"):
        return _Choice("running", juliacall.CONFIG.get("exepath"), juliacall.CONFIG.get("project"))
    executable, project = os.environ.get(_EXECUTABLE), os.environ.get(_PROJECT)
    if executable or project:
        if not (executable and project):
            raise EngineUnavailableError(
                f"{_EXECUTABLE} and {_PROJECT} must be set together: set the other one too, "
                "or neither."
            )
        return _Choice("environment", executable, project)
    file = julia_settings_file()
    if file.is_file():
        return _from_file(file)
    return _Choice("juliapkg")


def _from_file(file: Path) -> _Choice:
    try:
        settings = json.loads(file.read_text(encoding="utf-8"))
        executable, project = str(settings["executable"]), str(settings["project"])
        environment = {str(k): str(v) for k, v in settings.get("environment", {}).items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise EngineUnavailableError(
            f"{file} cannot be read as Julia's settings ({error!r}): it needs the JSON keys "
            '"executable" and "project". Mend or remove it.'
        ) from error
    return _Choice("file", executable, project, environment)


def _status(choice: _Choice) -> JuliaStatus:
    if choice.source == "juliapkg":
        return _juliapkg_status()
    named = {"environment": f"{_EXECUTABLE}", "file": f"{julia_settings_file()}"}.get(choice.source)
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
    packages = _manifest_versions(project)
    facts |= {"project": project, "packages": packages}
    missing = [name for name in _NEEDED if name not in packages]
    if missing:
        message = (
            f"The Julia project {project} lacks {' and '.join(missing)}. Add what is missing "
            f"with: {_recipe(project)}"
        )
        return JuliaStatus(False, False, message, **facts)
    precompiled = _is_precompiled(facts["version"], environment)
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
        message = f"juliapkg, which installs Julia, failed: {error}. {_prepare()}"
        return JuliaStatus(False, False, message, **facts)
    if facts["offline"]:
        message = f"Julia is not installed, and PYTHON_JULIAPKG_OFFLINE forbids it. {_prepare()}"
        return JuliaStatus(False, False, message, **facts)
    message = (
        'Julia is not installed yet: engine="julia" downloads it and its packages once '
        f"(some minutes, about 2 GB). Without a network: {_prepare()}"
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
        wanted = {**_juliacall_settings(), **os.environ}
        threads = wanted.get("PYTHON_JULIACALL_THREADS", os.environ.get("JULIA_NUM_THREADS", "1"))
        signals = wanted["PYTHON_JULIACALL_HANDLE_SIGNALS"]
    offline = os.environ.get("PYTHON_JULIAPKG_OFFLINE") == "yes" or (
        os.environ.get("JULIA_PKG_OFFLINE", "").lower() == "true"
    )
    return {"threads": str(threads), "handle_signals": signals, "offline": offline}


def _juliacall_settings() -> dict[str, str]:
    settings = dict(_JULIACALL_SETTINGS)
    if "JULIA_NUM_THREADS" in os.environ:
        del settings["PYTHON_JULIACALL_THREADS"]
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


def _manifest_versions(project: Path) -> dict[str, str]:
    """Versions of the packages that compute, from the project's manifest."""
    names = (*_NEEDED, "OrdinaryDiffEqTsit5", "Lux", "Optim")
    for file in sorted(project.glob("*Manifest*.toml")):
        text = file.read_text(encoding="utf-8")
        versions = {}
        for entry in re.split(r"^\[\[deps\.", text, flags=re.MULTILINE)[1:]:
            name = entry.partition("]]")[0]
            version = re.search(r'^version = "([^"]+)"', entry, flags=re.MULTILINE)
            if name in names and version:
                versions[name] = version[1]
        return versions
    return {}


def _is_precompiled(version: str, environment: Mapping[str, str]) -> bool:
    depots = os.environ.get("JULIA_DEPOT_PATH", environment.get("JULIA_DEPOT_PATH", ""))
    folders = [d for d in depots.split(os.pathsep) if d] or [str(Path.home() / ".julia")]
    major_minor = ".".join(version.split(".")[:2])
    caches = (Path(d) / "compiled" / f"v{major_minor}" / "PCNDECore" for d in folders)
    return any(any(cache.glob("*.ji")) for cache in caches)


def _recipe(project: Path | str) -> str:
    return (
        f"julia --project={project} -e 'using Pkg; "
        f'Pkg.develop(path="{julia_sources()}"); Pkg.add(name="PythonCall", version="0.9.34"); '
        "Pkg.precompile()'"
    )


def _prepare() -> str:
    return (
        f"Prepare a project where there is one ({_recipe('DIR')}), and name Julia and that "
        f"project in {julia_settings_file()} or in {_EXECUTABLE} and {_PROJECT}."
    )


# --------------------------------------------------------------------- running Julia


class _Julia:
    """The running Julia: PCNDECore's entry points, with arrays and errors converted."""

    def __init__(self) -> None:
        self._juliacall = _start()
        self._process = os.getpid()
        # A module of our own keeps the user's Main as it is.
        module = self._juliacall.newmodule("PCNDEBridge")
        try:
            module.seval("using PCNDECore")
        except self._juliacall.JuliaError as error:
            raise EngineUnavailableError(
                "PCNDECore does not load in the Julia project "
                f"{self._juliacall.CONFIG['project']}: {self._words(error)}. {_prepare()}"
            ) from error
        self._core = module.PCNDECore
        self._config = functools.lru_cache(maxsize=64)(self._new_config)

    def versions(self) -> dict[str, str]:
        """Versions of Julia and the packages that compute."""
        return {str(name): str(version) for name, version in self.call("versions").items()}

    def call(self, name: str, *arguments: Any) -> Any:
        """Call one of PCNDECore's functions; arrays and settings are converted."""
        if os.getpid() != self._process:
            raise EngineError(
                "Julia does not survive a fork: start worker processes with the 'spawn' method "
                '(multiprocessing.get_context("spawn")), and make the engine there.'
            )
        try:
            result = getattr(self._core, name)(*map(self._to_julia, arguments))
            return self._to_python(result)
        except self._juliacall.JuliaError as error:
            self._raise(error)

    def _to_julia(self, value: Any) -> Any:
        """Transpose: a C-ordered (case, time, z) array is (z, time, case) in Julia's order."""
        if isinstance(value, np.ndarray):
            return np.ascontiguousarray(value, dtype=np.float64).T
        if isinstance(value, tuple):
            return tuple(map(self._to_julia, value))
        if isinstance(value, PCNDEConfig):
            return self._config(value)
        return value

    def _to_python(self, value: Any) -> Any:
        """Copy arrays: the results are numpy's own, not views of Julia's memory."""
        if isinstance(value, self._juliacall.ArrayValue):
            return np.array(value.to_numpy(copy=False).T, order="C")
        if isinstance(value, tuple):
            return tuple(map(self._to_python, value))
        return value

    def _new_config(self, config: PCNDEConfig) -> Any:
        """Julia's copy of the settings, as a TOML text of plain numbers and words."""
        lines = [
            f"{group}.{name} = {json.dumps(value)}"
            for group, settings in config.to_dict().items()
            if isinstance(settings, dict)
            for name, value in settings.items()
            if value is not None
        ]
        return self._core.config("\n".join(lines))

    def _raise(self, error: Any) -> NoReturn:
        kind = str(self._juliacall.Base.nameof(self._juliacall.Base.typeof(error.exception)))
        if kind == "InterruptException":
            raise KeyboardInterrupt from None
        if kind == "SolveError":
            raise SolveError(self._words(error)) from None
        raise EngineError(f"Julia failed: {self._words(error)}") from error

    def _words(self, error: Any) -> str:
        """Julia's own message, without its stack trace."""
        base = self._juliacall.Base
        text = str(base.sprint(base.showerror, error.exception)).strip()
        return text if len(text) <= 1000 else f"{text[:1000]} …"


_lock = threading.Lock()
_julia: _Julia | None = None
_warned = False


def _running() -> _Julia:
    """Return the one Julia of this process, started if need be."""
    global _julia
    with _lock:
        if _julia is None:
            _julia = _Julia()
        return _julia


def _start() -> types.ModuleType:
    """Start Julia through juliacall; return juliacall.

    Raises
    ------
    EngineUnavailableError
        Saying what is missing and how to mend it.
    """
    choice = _choice()
    status = _status(choice)
    if choice.source == "running":
        _warn_if_foreign(status)
    elif not (status.usable or status.installable):
        raise EngineUnavailableError(status.message)
    else:
        for name, value in {**choice.environment, **_juliacall_settings()}.items():
            os.environ.setdefault(name, value)
        if choice.executable and choice.project:
            os.environ[_EXECUTABLE] = choice.executable
            os.environ[_PROJECT] = choice.project
        if status.installable:
            print(
                "pcnde_bridge installs Julia and its packages, once; this takes some minutes.",
                file=sys.stderr,
            )
    try:
        import juliacall
    except Exception as error:
        raise EngineUnavailableError(
            f"Julia did not start: {_last_line(error)}. {_prepare()}"
        ) from error
    return juliacall  # type: ignore[no-any-return]


def _last_line(error: Exception) -> str:
    output = getattr(error, "stderr", None) or str(error)
    return str(output).strip().splitlines()[-1].rstrip(".") if str(output).strip() else repr(error)


def _warn_if_foreign(status: JuliaStatus) -> None:
    """Warn, once, of another package's settings that change how the engine behaves."""
    global _warned
    differences = []
    if status.handle_signals == "yes":
        differences.append("it handles Ctrl-C itself, so that an interruption may end Python")
    if status.threads != "1":
        differences.append(f"it has {status.threads} threads, which may crash beside Python")
    if differences and not _warned:
        _warned = True
        warnings.warn(
            f"Julia was already started by another package: {' and '.join(differences)}. Make the "
            "pcnde_bridge engine first, or set PYTHON_JULIACALL_HANDLE_SIGNALS=no and "
            "PYTHON_JULIACALL_THREADS=1.",
            RuntimeWarning,
            stacklevel=5,
        )


# --------------------------------------------------------------------- the engine


class JuliaStage(Generic[InputsT]):
    """One stage; see :class:`pcnde_bridge.engines.base.Stage`."""

    def __init__(self, julia: _Julia, name: str) -> None:
        self._julia = julia
        self._name = name

    def solve(self, parameters: Array, inputs: InputsT, grid: Grid, config: PCNDEConfig) -> Array:
        """See :class:`pcnde_bridge.engines.base.Stage`."""
        result: Array = self._julia.call(
            "solve", self._name, parameters, _arrays(inputs), grid.z, float(grid.period), config
        )
        return result

    def loss_and_gradient(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> tuple[float, Array]:
        """See :class:`pcnde_bridge.engines.base.Stage`."""
        loss, gradient = self._julia.call(
            "loss_and_gradient",
            self._name,
            parameters,
            _arrays(inputs),
            target,
            grid.z,
            float(grid.period),
            config,
        )
        return float(loss), gradient

    def fit(
        self,
        parameters: Array,
        inputs: InputsT,
        target: Array,
        grid: Grid,
        config: PCNDEConfig,
        iterations: int,
        on_iteration: OnIteration | None = None,
    ) -> Fit:
        """See :class:`pcnde_bridge.engines.base.Stage`."""

        def after_iteration(number: int, loss: float) -> None:
            # Called even if nobody listens: here Python notices a Ctrl-C.
            if on_iteration is not None:
                on_iteration(int(number), float(loss))

        fitted, losses, converged, message = self._julia.call(
            "fit",
            self._name,
            parameters,
            _arrays(inputs),
            target,
            grid.z,
            float(grid.period),
            config,
            iterations,
            after_iteration,
        )
        return Fit(fitted, losses, bool(converged), str(message))


class JuliaEngine:
    """The five stages in Julia; see :class:`pcnde_bridge.engines.base.Engine`.

    Making one starts Julia, once per process.

    Raises
    ------
    EngineUnavailableError
        If Julia cannot be started; the message says what is missing.
    """

    name = "julia"

    def __init__(self) -> None:
        self._julia = _running()
        self.flow: JuliaStage[FlowInputs] = JuliaStage(self._julia, "flow")
        self.intermediate_area: JuliaStage[IntermediateAreaInputs] = JuliaStage(
            self._julia, "intermediate_area"
        )
        self.fourier_area: JuliaStage[FourierAreaInputs] = JuliaStage(self._julia, "fourier_area")
        self.temporal_pressure: JuliaStage[TemporalPressureInputs] = JuliaStage(
            self._julia, "temporal_pressure"
        )
        self.spatial_pressure: JuliaStage[SpatialPressureInputs] = JuliaStage(
            self._julia, "spatial_pressure"
        )

    def predict(
        self,
        parameters: Parameters,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        config: PCNDEConfig,
    ) -> Solution:
        """See :class:`pcnde_bridge.engines.base.Engine`."""
        return predict_by_stages(self, parameters, inflow, area_undeformed, grid, config)

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of Julia and the packages that compute."""
        return self._julia.versions()


def _arrays(inputs: Any) -> tuple[Array, ...]:
    return tuple(getattr(inputs, f.name) for f in fields(inputs))
