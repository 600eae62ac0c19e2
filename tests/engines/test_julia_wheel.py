"""The wheel holds what juliapkg needs, where juliapkg looks for it."""

from __future__ import annotations

import json
import posixpath
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("needs the sources' folder")
    pytest.importorskip("hatchling", reason="builds a wheel without a network")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_every_julia_source_is_in_the_wheel(wheel):
    package = ROOT / "julia" / "PCNDECore"
    code = [*package.glob("src/**/*.jl"), *package.glob("ext/*.jl")]
    sources = [package / "Project.toml", package.parent / "tested_versions.toml", *code]
    assert len(code) > 10
    for source in sources:
        name = f"pcnde_bridge/{source.relative_to(ROOT).as_posix()}"
        assert wheel.get(name) == source.read_bytes(), name


def test_juliapkg_finds_the_package_in_the_wheel(wheel):
    # One level below a folder of sys.path, with a path relative to the file.
    declared = json.loads(wheel["pcnde_bridge/juliapkg.json"])
    assert declared == json.loads((ROOT / "juliapkg.json").read_text())
    path = declared["packages"]["PCNDECore"]["path"]
    assert f"{posixpath.join('pcnde_bridge', path)}/Project.toml" in wheel


def test_no_leftovers_of_julia_are_in_the_wheel(wheel):
    assert not [name for name in wheel if name.endswith(("Manifest.toml", ".ji", ".cov"))]
