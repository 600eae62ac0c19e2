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

import contextlib
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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from pcnde_bridge import interrupts
from pcnde_bridge.config import ClosureConfig, PCNDEConfig
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.base import (
    Fit,
    FlowInputs,
    FourierAreaInputs,
    IntermediateAreaInputs,
    Mask,
    Objective,
    OnAccepted,
    OnIteration,
    Solution,
    SpatialPressureInputs,
    TemporalFlowInputs,
    TemporalPressureInputs,
)
from pcnde_bridge.engines.julia_closures import JuliaClosures
from pcnde_bridge.errors import EngineError, EngineUnavailableError, PCNDEWarning, SolveError
from pcnde_bridge.grid import Grid
from pcnde_bridge.inference import predict_by_stages
from pcnde_bridge.parameters import Parameters

__all__ = ["JuliaEngine", "JuliaStatus", "julia_settings_file", "julia_sources", "julia_status"]

Array = npt.NDArray[np.float64]
InputsT = TypeVar("InputsT")

_EXECUTABLE, _PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
_NEEDED = ("PCNDECore", "PythonCall")
_COMPUTING = (*_NEEDED, "OrdinaryDiffEqTsit5", "Lux", "Optim")
_OLDEST = (1, 10)

_SIGNALS, _THREADS = "PYTHON_JULIACALL_HANDLE_SIGNALS", "PYTHON_JULIACALL_THREADS"

# Set before Julia starts, unless the user has set them; _juliacall_settings adds signals.
_JULIACALL_SETTINGS = {
    _THREADS: "1",
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
        message = str(error)
    except (OSError, ValueError) as error:  # files of a project that cannot be read
        message = f"The Julia project cannot be read: {error}. {_prepare()}"
    return JuliaStatus(False, False, message, "environment", **_settings())


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
    versions, core = _manifest(project)
    packages = {name: versions[name] for name in _COMPUTING if versions.get(name)}
    facts |= {"project": project, "packages": packages, "warning": _other_core(core)}
    missing = [name for name in _NEEDED if name not in packages]
    missing += [name for name in _dependencies(core) if name not in versions]
    if missing:
        message = (
            f"The Julia project {project} lacks {', '.join(missing)}. Add what is missing "
            f"with: {_recipe(project)}"
        )
        return JuliaStatus(False, False, message, **facts)
    ours = _core_version(julia_sources()) or ""
    if not _compatible(packages["PCNDECore"], ours):
        message = _incompatible(packages["PCNDECore"], f"{core or project}", ours, project)
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
        threads, signals = _threads(), wanted[_SIGNALS]
    offline = os.environ.get("PYTHON_JULIAPKG_OFFLINE") == "yes" or (
        os.environ.get("JULIA_PKG_OFFLINE", "").lower() == "true"
    )
    return {"threads": str(threads), "handle_signals": signals, "offline": offline}


def _threads() -> str:
    """Julia's threads, as the user wants them and juliacall reads it."""
    return os.environ.get(_THREADS, os.environ.get("JULIA_NUM_THREADS", "1"))


def _juliacall_settings() -> dict[str, str]:
    settings = dict(_JULIACALL_SETTINGS)
    if "JULIA_NUM_THREADS" in os.environ:
        del settings[_THREADS]
    # With one thread Julia needs no signals, and Python keeps them all. With more, a thread
    # that collects garbage stops the others by letting them run into SIGSEGV on purpose:
    # unless Julia handles that signal, the process dies of it (signal 11). The price is
    # Ctrl-C, which Julia then takes from Python and does not act upon during a fit.
    settings[_SIGNALS] = "no" if _threads() == "1" else "yes"
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


def _manifest(project: Path) -> tuple[dict[str, str], Path | None]:
    """Versions of all packages, empty where none is said, and PCNDECore's own folder if any."""
    versions: dict[str, str] = {}
    core = None
    for file in sorted(project.glob("*Manifest*.toml"))[:1]:
        text = file.read_text(encoding="utf-8")
        for entry in re.split(r"^\[\[deps\.", text, flags=re.MULTILINE)[1:]:
            name = entry.partition("]]")[0]
            versions[name] = _toml_text("version", entry) or ""
            path = _toml_text("path", entry)
            if name == "PCNDECore" and path:
                # The manifest keeps the version of the day on which it was written.
                core = project / path
                versions[name] = _core_version(core) or versions[name] or "missing"
    return versions, core


def _dependencies(core: Path | None) -> list[str]:
    """Name what a core with its own folder needs: its sources can be newer than the manifest."""
    if core is None or not (core / "Project.toml").is_file():
        return []
    project = (core / "Project.toml").read_text(encoding="utf-8")
    section = re.search(r"^\[deps\]\n(.*?)(?=^\[|\Z)", project, re.MULTILINE | re.DOTALL)
    return re.findall(r"^(\w+) =", section[1], re.MULTILINE) if section else []


def _toml_text(key: str, toml: str) -> str | None:
    """Value of the first line that sets a key to a text."""
    found = re.search(rf'^{key} = "([^"]+)"', toml, flags=re.MULTILINE)
    return json.loads(f'"{found[1]}"') if found else None


def _core_version(folder: Path) -> str | None:
    try:
        return _toml_text("version", (folder / "Project.toml").read_text(encoding="utf-8"))
    except OSError:
        return None


def _compatible(version: str, other: str) -> bool:
    """As Julia counts it: up to the first number that is not zero."""
    numbers, others = (re.findall(r"\d+", v) for v in (version, other))
    significant = 1 if numbers[:1] != ["0"] else 2
    return numbers[:significant] == others[:significant]


def _other_core(folder: Path | None) -> str:
    """Say that a project has another PCNDECore than this package's; empty if it does not."""
    ours = julia_sources()
    if folder is None or _contents(folder) == _contents(ours):
        return ""
    return (
        f"The project has PCNDECore from {folder}, which differs from this package's {ours}: "
        "the former runs."
    )


def _contents(package: Path) -> dict[str, bytes]:
    files = [package / "Project.toml", *(package / "src").rglob("*.jl")]
    return {str(file.relative_to(package)): file.read_bytes() for file in files if file.is_file()}


def _is_precompiled(version: str, environment: Mapping[str, str]) -> bool:
    depots = os.environ.get("JULIA_DEPOT_PATH", environment.get("JULIA_DEPOT_PATH", ""))
    folders = [d for d in depots.split(os.pathsep) if d] or [str(Path.home() / ".julia")]
    major_minor = ".".join(version.split(".")[:2])
    caches = (Path(d) / "compiled" / f"v{major_minor}" / "PCNDECore" for d in folders)
    return any(any(cache.glob("*.ji")) for cache in caches)


def _incompatible(version: str, where: str, ours: str, project: Path | str) -> str:
    return (
        f"The Julia project {project} has PCNDECore {version} ({where}), and pcnde_bridge needs "
        f"{ours}. Bring it up to date with: {_recipe(project)}"
    )


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
        self._process, self._thread = os.getpid(), threading.get_ident()
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
        # A function's name is looked up once: each time takes as long as calling it.
        self._function = functools.lru_cache(functools.partial(getattr, self._core))
        found, ours = self.versions()["PCNDECore"], _core_version(julia_sources()) or ""
        if not _compatible(found, ours):
            project = str(self._juliacall.CONFIG["project"])
            raise EngineUnavailableError(_incompatible(found, "running", ours, project))
        self._config = functools.lru_cache(maxsize=64)(self._new_config)
        self.held: object = None  # whose problem Julia holds

    def versions(self) -> dict[str, str]:
        """Versions of Julia and the packages that compute."""
        return {str(name): str(version) for name, version in self.call("versions").items()}

    def call(self, name: str, *arguments: Any, in_place: Iterable[Array] = ()) -> Any:
        """Call one of PCNDECore's functions; arrays and settings are converted.

        Of the arrays ``in_place``, float64 and C-ordered, the function is told, last, where
        they are; it reads and fills them there, and keeps none.
        """
        if os.getpid() != self._process:
            raise EngineError(
                "Julia does not survive a fork: start worker processes with the 'spawn' method "
                '(multiprocessing.get_context("spawn")), and make the engine there.'
            )
        if threading.get_ident() != self._thread:
            raise EngineError(
                "Julia answers only in the thread that started it: make and use the engine in "
                'one thread, or take engine="jax", which any thread may use.'
            )
        try:
            where = [number for array in in_place for number in _memory(array)]
            result = self._function(name)(*map(self._to_julia, arguments), *where)
            return self._to_python(result)
        except self._juliacall.JuliaError as error:
            failure = self._failure(error)
        # Raised here, so that it holds nothing of Julia's, which another thread might let go.
        raise failure

    def _to_julia(self, value: Any) -> Any:
        """Copy arrays: a C-ordered (case, time, z) array is (z, time, case) in Julia's order."""
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value, dtype=np.float64)
            return self._function("from_python")(*_memory(array))
        if isinstance(value, tuple):
            return tuple(map(self._to_julia, value))
        if isinstance(value, PCNDEConfig | ClosureConfig):
            return self._config(value)
        return value

    def _to_python(self, value: Any) -> Any:
        """Copy arrays: the results are numpy's own, not views of Julia's memory."""
        if isinstance(value, self._juliacall.ArrayValue):
            return np.array(value.to_numpy(copy=False).T, order="C")
        if isinstance(value, tuple):
            return tuple(map(self._to_python, value))
        return value

    def _new_config(self, config: PCNDEConfig | ClosureConfig) -> Any:
        """Julia's copy of the settings, as a TOML text of plain numbers and words."""
        lines = [
            f"{group}.{name} = {json.dumps(value)}"
            for group, settings in config.to_dict().items()
            if isinstance(settings, dict)
            for name, value in settings.items()
            if value is not None
        ]
        read = self._core.config if isinstance(config, PCNDEConfig) else self._core.closure_config
        return read("\n".join(lines))

    def _failure(self, error: Any) -> BaseException:
        kind = str(self._juliacall.Base.nameof(self._juliacall.Base.typeof(error.exception)))
        if kind == "InterruptException":
            return KeyboardInterrupt()
        if kind == "SolveError":
            return SolveError(self._words(error))
        failure = EngineError(f"Julia failed: {self._words(error)}")
        failure.__cause__ = RuntimeError(str(error))  # with Julia's stack trace
        return failure

    def _words(self, error: Any) -> str:
        """Julia's own message, without its stack trace."""
        base = self._juliacall.Base
        text = str(base.sprint(base.showerror, error.exception)).strip()
        return text if len(text) <= 1000 else f"{text[:1000]} …"


def _memory(array: Array) -> tuple[int, ...]:
    """Address and shape in Julia's order, so that Julia need not compile for Python's types."""
    return array.__array_interface__["data"][0], *reversed(array.shape)


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
    elif status.threads != "1" and status.handle_signals == "no":
        raise EngineUnavailableError(
            f"Julia with {status.threads} threads must handle signals, or it dies of its own: "
            f"unset {_SIGNALS}, or set {_THREADS}=1."
        )
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
    """Warn, once, of another package's settings that are not safe."""
    global _warned
    if status.threads != "1" and status.handle_signals == "no" and not _warned:
        _warned = True
        warnings.warn(
            f"Julia was already started by another package with {status.threads} threads but "
            "without its signals, and may crash. Make the pcnde_bridge engine first, or set "
            f"{_SIGNALS}=yes.",
            PCNDEWarning,
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
        args = parameters, inputs, target, grid, config
        loss, gradient = self._compare("loss_and_gradient", *args)
        return float(loss), gradient

    def losses(
        self, parameters: Array, inputs: InputsT, target: Array, grid: Grid, config: PCNDEConfig
    ) -> Array:
        """See :class:`pcnde_bridge.engines.base.Stage`."""
        result: Array = self._compare("losses", parameters, inputs, target, grid, config)
        return result

    def _compare(
        self,
        function: str,
        parameters: Array,
        inputs: InputsT,
        target: Array,
        grid: Grid,
        config: PCNDEConfig,
        *more: Any,
    ) -> Any:
        """Call what compares the stage's result with a target."""
        where = grid.z, float(grid.period)
        arrays = _arrays(inputs)
        return self._julia.call(
            function, self._name, parameters, arrays, target, *where, config, *more
        )

    def objective(
        self, inputs: InputsT, target: Array, chosen: Mask, grid: Grid, config: PCNDEConfig
    ) -> Objective:
        """See :class:`pcnde_bridge.engines.base.Stage`."""
        chosen_inputs = dataclasses.replace(
            inputs,  # type: ignore[type-var]
            **{f.name: getattr(inputs, f.name)[chosen] for f in fields(inputs)},  # type: ignore[arg-type]
        )
        arrays, chosen_target = _arrays(chosen_inputs), target[chosen]
        ours = object()

        def evaluate(parameters: Array) -> tuple[float, Array]:
            # Julia keeps the last problem itself: Python's hold on one might be let go by
            # another thread.
            if self._julia.held is not ours:
                self._julia.held = None
                period = float(grid.period)
                self._julia.call("hold", self._name, arrays, chosen_target, grid.z, period, config)
                self._julia.held = ours
            loss, gradient = self._julia.call("held_loss_and_gradient", parameters)
            return float(loss), gradient

        return evaluate

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
        with interrupts.kept() as look:

            def after_iteration(number: int, loss: float) -> None:
                # Called even if nobody listens: here Python notices a Ctrl-C.
                look()
                if on_iteration is not None:
                    on_iteration(int(number), float(loss))

            args = parameters, inputs, target, grid, config
            fitted, losses, converged, message = self._compare(
                "fit", *args, iterations, after_iteration
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
        self.closures = JuliaClosures(self._julia.call)
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
        self.temporal_flow: JuliaStage[TemporalFlowInputs] = JuliaStage(
            self._julia, "temporal_flow"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to another process as a name: Julia's functions cannot."""
        return select_engine, (self.name,)

    def predict(
        self,
        parameters: Parameters,
        inflow: Array,
        area_undeformed: Array,
        grid: Grid,
        config: PCNDEConfig,
    ) -> Solution:
        """See :class:`pcnde_bridge.engines.base.Engine`."""
        if config.flow.terms:
            return predict_by_stages(self, parameters, inflow, area_undeformed, grid, config)
        flow, area, pressure = self._julia.call(
            "predict",
            tuple(vector for _, vector in parameters),
            inflow,
            area_undeformed,
            grid.z,
            float(grid.period),
            config.coupling_passes,
            config,
        )
        return Solution(flow, area, pressure)

    def lbfgs(
        self, objective: Objective, start: Array, memory: int, iterations: int, after: OnAccepted
    ) -> None:
        """Optim's ``LBFGS``; see :class:`pcnde_bridge.engines.base.Engine`."""

        def evaluate(x: Any, found: Any) -> None:
            room = found.to_numpy(copy=False)
            room[0], room[1:] = objective(x.to_numpy())

        def accepted(x: Any, loss: float) -> None:
            after(x.to_numpy(), float(loss))

        with contextlib.suppress(StopIteration):
            self._julia.call("lbfgs", evaluate, start, memory, iterations, accepted)

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of Julia and the packages that compute."""
        return self._julia.versions()


def _arrays(inputs: Any) -> tuple[Array, ...]:
    return tuple(getattr(inputs, f.name) for f in fields(inputs))
