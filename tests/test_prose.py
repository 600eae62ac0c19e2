"""README, documentation and public docstrings use the terms of ``tests/data/prose.toml``."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RULES = tomllib.loads((ROOT / "tests/data/prose.toml").read_text(encoding="utf-8"))
SKIPPED = {"_build", "_templates", "generated", "notebooks", "jupyter_execute"}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if not SKIPPED & {*page.relative_to(ROOT).parts}]
MODULES = sorted((ROOT / "pcnde_bridge").rglob("*.py"))


def prose(text: str) -> str:
    """Return a text without code, formulas and addresses."""
    for pattern, instead in (
        (r"```.*?```", ""),
        (r"\$\$.*?\$\$", ""),
        (r"`[^`]*`", "X"),
        (r"\$[^$]*\$", "X"),
        (r"\]\([^)]*\)", "]"),
    ):
        text = re.sub(pattern, instead, text, flags=re.DOTALL)
    return text


def wrong_terms(text: str) -> list[str]:
    return [
        f"{found[0]!r}: write {instead}"
        for pattern, instead in RULES["terms"].items()
        for found in re.finditer(pattern, prose(text), flags=re.IGNORECASE)
    ]


def long_sentences(text: str) -> list[str]:
    """Return sentences with too many words; tables, headings and quotations have none."""
    blocks = re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", prose(text))
    plain = [block for block in blocks if not block.lstrip().startswith(("|", "#", ">", "{"))]
    sentences = [s for block in plain for s in re.split(r"(?<=[.?!:;])\s+", block)]
    longest = RULES["longest_sentence"]
    return [s for s in sentences if len(re.findall(r"[^\W\d][\w\u2019'/-]*", s)) > longest]


def docstrings(path: Path) -> dict[str, str]:
    """Return the docstrings of a module and of its public classes and functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    named = (ast.Module, ast.ClassDef, ast.FunctionDef)
    nodes = [node for node in ast.walk(tree) if isinstance(node, named)]
    found = {getattr(node, "name", "module"): ast.get_docstring(node) for node in nodes}
    return {name: text for name, text in found.items() if text and not name.startswith("_")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages(page):
    text = page.read_text(encoding="utf-8")
    assert not wrong_terms(text)
    assert not long_sentences(text)


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.stem)
def test_docstrings(module):
    assert not {
        name: bad for name, text in docstrings(module).items() if (bad := wrong_terms(text))
    }


def test_the_rules_find_what_they_should():
    assert wrong_terms("All instants are kept, in some cases.") == [
        "'instants': write time point",
        "'kept': write retained, cached, stored",
        "'some cases': write subset, fold, several cases",
    ]
    assert wrong_terms("The colour of `colour`")[0].startswith("'colour'")
    assert not wrong_terms("Time points are stored.")
    assert long_sentences("word " * 26 + ".") and not long_sentences("word " * 25 + ".")
    assert not long_sentences("| " + "word " * 30)
    assert len(PAGES) > 20
