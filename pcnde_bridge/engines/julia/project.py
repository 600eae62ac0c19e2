"""What a Julia project holds: the versions in its manifest, and PCNDECore beside this package's."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from pcnde_bridge.errors import EngineUnavailableError


def julia_sources() -> Path:
    """Folder of the Julia package PCNDECore that belongs to this Python package."""
    package = Path(__file__).resolve().parents[2]
    for folder in (package, package.parent):  # a wheel, a checkout
        if (folder / "julia" / "PCNDECore" / "Project.toml").is_file():
            return folder / "julia" / "PCNDECore"
    raise EngineUnavailableError(
        f"The Julia sources are missing from {package}. Install pcnde_bridge again."
    )


def read_manifest(project: Path) -> tuple[dict[str, str], Path | None]:
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
                versions[name] = core_version(core) or versions[name] or "missing"
    return versions, core


def dependencies(core: Path | None) -> list[str]:
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


def core_version(folder: Path) -> str | None:
    """Version of the PCNDECore in a folder."""
    try:
        return _toml_text("version", (folder / "Project.toml").read_text(encoding="utf-8"))
    except OSError:
        return None


def compatible(version: str, other: str) -> bool:
    """Return whether two versions are equal up to their first non-zero number."""
    numbers, others = (re.findall(r"\d+", v) for v in (version, other))
    significant = 1 if numbers[:1] != ["0"] else 2
    return numbers[:significant] == others[:significant]


def difference_of_cores(folder: Path | None) -> str:
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


def is_precompiled(version: str, environment: Mapping[str, str]) -> bool:
    """Say whether some depot holds a compiled PCNDECore for this version of Julia."""
    depots = os.environ.get("JULIA_DEPOT_PATH", environment.get("JULIA_DEPOT_PATH", ""))
    folders = [d for d in depots.split(os.pathsep) if d] or [str(Path.home() / ".julia")]
    major_minor = ".".join(version.split(".")[:2])
    caches = (Path(d) / "compiled" / f"v{major_minor}" / "PCNDECore" for d in folders)
    return any(any(cache.glob("*.ji")) for cache in caches)


def recipe(project: Path | str) -> str:
    """Return the command that puts this package's PCNDECore, and PythonCall, into a project."""
    return (
        f"julia --project={project} -e 'using Pkg; "
        f'Pkg.develop(path="{julia_sources()}"); Pkg.add(name="PythonCall", version="0.9.34"); '
        "Pkg.precompile()'"
    )


def incompatible(version: str, where: str, ours: str, project: Path | str) -> str:
    """Say that a project's PCNDECore is not the one needed, and how to mend it."""
    return (
        f"The Julia project {project} has PCNDECore {version} ({where}), and pcnde_bridge needs "
        f"{ours}. Bring it up to date with: {recipe(project)}"
    )
