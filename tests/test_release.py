"""Files of a release name one version, and the conda recipe the dependencies of the package."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from pcnde_bridge import __version__

ROOT = Path(__file__).parents[1]
RECIPE = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
OTHER_NAMES = {
    "matplotlib": "matplotlib-base",
    "juliacall": "pyjuliacall",
    "juliapkg": "pyjuliapkg",
}


def test_one_version_everywhere():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(__version__)} – ", changes, flags=re.MULTILINE)
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: \"?{re.escape(__version__)}\"?$", citation, flags=re.MULTILINE)
    assert f'version: "{__version__}"' in RECIPE


def test_the_recipe_has_the_dependencies_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    run = RECIPE.partition("  run:\n")[2].partition("\ntest:")[0]
    listed = re.findall(r"- (\S+) (\S+)", run)
    wanted = {}
    for requirement in project["dependencies"]:
        name, limits = re.fullmatch(r"([\w-]+)(.*)", requirement).groups()
        wanted[OTHER_NAMES.get(name, name)] = limits
    assert dict(listed) == wanted | {"python": project["requires-python"]}
