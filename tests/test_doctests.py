"""The examples in docstrings run."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import pcnde_bridge

MODULES = sorted(
    module.name for module in pkgutil.walk_packages(pcnde_bridge.__path__, "pcnde_bridge.")
)


@pytest.mark.parametrize("name", [name for name in MODULES if "__main__" not in name])
def test_examples(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.failed == 0


def test_there_are_examples():
    found = doctest.DocTestFinder()
    modules = [importlib.import_module(name) for name in MODULES if "__main__" not in name]
    assert sum(len(test.examples) for module in modules for test in found.find(module)) > 20
