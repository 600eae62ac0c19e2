"""Import of the package: heavy dependencies are loaded on first use."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import pcnde_bridge

ROOT = Path(pcnde_bridge.__file__).parent
HEAVY = (
    *("jax", "jaxlib", "diffrax", "juliacall", "juliapkg"),
    *("matplotlib", "scipy.optimize", "h5py"),
)
OPTIONAL = ("vtkmodules", "xarray", "dash")


@pytest.mark.parametrize(
    "code",
    [
        "import pcnde_bridge",
        "import pcnde_bridge.plots, pcnde_bridge.plots.figures",
        "from pcnde_bridge import cli; import pcnde_bridge.cli.doctor as d; d.examine()",
    ],
)
def test_no_engine_and_no_plotting_is_imported(code):
    heavy = [m for m in HEAVY if m != "juliapkg"] if "doctor" in code else HEAVY
    check = f"import sys; print([m for m in {(*heavy, *OPTIONAL)!r} if m in sys.modules])"
    result = subprocess.run(
        [sys.executable, "-c", f"{code}\n{check}"], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("module", ["pcnde_bridge", "pcnde_bridge.cli.main"])
def test_neither_numpy_nor_pandas_is_imported(module):
    check = f"import sys, {module}; print([m for m in ('numpy', 'pandas') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True)
    assert result.stdout.strip() == "[]"


def test_public_names_for_type_checkers_are_those_at_run_time():
    """The names that are imported for type checkers come from the same modules."""
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    named = {alias.name: node.module for node in block.body for alias in node.names}
    assert {*named, "__version__"} == set(pcnde_bridge.__all__)
    for name, module in named.items():
        assert getattr(pcnde_bridge, name) is getattr(importlib.import_module(module), name)


def test_public_names_exist_and_are_listed():
    assert all(hasattr(pcnde_bridge, name) for name in pcnde_bridge.__all__)
    assert len(set(pcnde_bridge.__all__)) == len(pcnde_bridge.__all__)


def test_subpackages_are_attributes_and_nothing_else_is_listed():
    subpackages = {p.parent.name for p in ROOT.glob("*/__init__.py")} - {"_utils"} | {"errors"}
    listed = {*pcnde_bridge.__all__, *subpackages}
    assert set(dir(pcnde_bridge)) == listed
    code = "import pcnde_bridge as p\n" + "\n".join(f"p.{name}" for name in sorted(subpackages))
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = pcnde_bridge.nothing


def test_errors_are_one_family():
    errors = [
        getattr(pcnde_bridge, name) for name in pcnde_bridge.__all__ if name.endswith("Error")
    ]
    assert len(errors) >= 7
    assert all(issubclass(error, pcnde_bridge.PCNDEError) for error in errors)
    assert issubclass(pcnde_bridge.InputError, ValueError)
    assert issubclass(pcnde_bridge.FileError, ValueError)
