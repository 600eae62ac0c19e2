"""The architecture: imports run downward through the subpackages, without cycles."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "pcnde_bridge"

# The subpackages, lowest first.  A module may import from its own and from lower ones.
SUBPACKAGES = (
    "_version",
    "_typing",
    "errors",
    "_utils",
    "config",
    "data",
    "hemodynamics",
    "io",
    "engines",
    "uncertainty",
    "training",
    "model",
    "evaluation",
    "studies",
    "plots",
    "app",
    "cli",
    "__init__",
    "__main__",
)


def modules() -> dict[str, Path]:
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = ("pcnde_bridge", *path.relative_to(PACKAGE).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """Return the package's modules that a module imports, also while type checking."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in known else node.module for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & set(known)


def subpackage(module: str) -> str:
    return [*module.split("."), "__init__"][1]


def test_imports_run_downward():
    known = modules()
    upward = [
        f"{module} imports {other}"
        for module, path in known.items()
        for other in imported(path, known)
        if SUBPACKAGES.index(subpackage(other)) > SUBPACKAGES.index(subpackage(module))
    ]
    assert not upward


def test_there_is_no_circle():
    known = modules()
    order = TopologicalSorter({name: imported(path, known) for name, path in known.items()})
    assert len(list(order.static_order())) == len(known)  # raises CycleError


def test_every_room_is_there():
    assert {subpackage(module) for module in modules()} == set(SUBPACKAGES)
