"""The documentation site: ``sphinx-build -W docs docs/_build``."""

from __future__ import annotations

import shutil
import types
from pathlib import Path
from typing import Any

from pcnde_bridge import __version__

HERE = Path(__file__).parent

project = "pcnde_bridge"
author = "The pcnde-bridge developers"
copyright = author
version = release = __version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
    "numpydoc",
    "myst_nb",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "_templates", "jupyter_execute"]
suppress_warnings = ["misc.highlighting_failure"]

html_theme = "furo"
html_title = f"pcnde_bridge {version}"

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3

autosummary_generate = True
autodoc_typehints = "none"  # the signature would repeat the docstring's types
numpydoc_show_class_members = False

# The site shows the outputs that notebooks/execute.py stores; a test keeps them current.
nb_execution_mode = "off"


def _bring_notebooks() -> None:
    """Copy the notebooks, because Sphinx only reads pages below its own folder."""
    shutil.rmtree(HERE / "notebooks", ignore_errors=True)
    shutil.copytree(
        HERE.parent / "notebooks",
        HERE / "notebooks",
        ignore=shutil.ignore_patterns(".ipynb_checkpoints"),
    )


_bring_notebooks()


def _keep_bars(
    app: object, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Escape the bars of |Q|, which reStructuredText would read as a substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def _skip_aliases(
    app: object, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """Leave out type aliases, whose signature Sphinx cannot format."""
    return True if isinstance(obj, types.GenericAlias) else None


def setup(app: Any) -> None:
    """Register the hooks with Sphinx."""
    app.connect("autodoc-process-docstring", _keep_bars)
    app.connect("autodoc-skip-member", _skip_aliases)
