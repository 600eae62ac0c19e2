"""JAX's compiled functions on disk."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections import namedtuple

import pytest

from pcnde_bridge._utils import jax_context

COMPUTE = """
import warnings; warnings.simplefilter("error")
import logging, jax, jax.numpy as jnp
from pcnde_bridge._utils import jax_context
jax_context._SHORTEST_COMPILATION = 0.0
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name.endswith("cache_hits")))
with jax_context.double_precision():
    print(jax.jit(lambda x: jnp.sin(x) @ x)(jnp.arange(3.0)).item(), sum(hits) > 0)
"""


@pytest.fixture
def compute(tmp_path, monkeypatch):
    """Compute in a new process with a cache of its own: its result, and whether it was loaded."""
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path))

    def run():
        done = subprocess.run([sys.executable, "-c", COMPUTE], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        value, loaded = done.stdout.split()
        assert float(value) == pytest.approx(2.6600657)
        return loaded == "True"

    return run


def stored(folder):
    return sorted(p for p in folder.rglob("*-cache") if p.is_file())


def test_a_second_process_loads_what_the_first_one_compiled(compute, tmp_path):
    assert not compute()
    assert stored(tmp_path)
    assert compute()


def test_damaged_files_are_ignored(compute, tmp_path):
    compute()
    for path in stored(tmp_path):
        path.write_bytes(path.read_bytes()[:40])
    assert not compute()


def test_a_folder_that_others_can_write_to_is_not_used(compute, tmp_path):
    compute()
    stored(tmp_path)[0].parent.chmod(0o777)
    assert not compute()


def test_the_cache_folder_may_be_a_file(compute, tmp_path):
    (tmp_path / "compiled").write_text("no folder")
    assert not compute()


def test_jax_s_own_switches_are_respected(compute, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_ENABLE_COMPILATION_CACHE", "false")
    assert not compute()
    assert not stored(tmp_path)
    monkeypatch.delenv("JAX_ENABLE_COMPILATION_CACHE")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "own"))
    assert not compute()
    assert not (tmp_path / "compiled").exists()


def test_nothing_is_stored_on_a_full_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path))
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(jax_context.shutil, "disk_usage", lambda _: usage(1 << 20))
    jax = pytest.importorskip("jax")
    before = jax.config.jax_compilation_cache_dir
    try:
        jax.config.update("jax_compilation_cache_dir", None)
        jax_context._store_compiled_functions.__wrapped__()
        assert jax.config.jax_compilation_cache_dir is None
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_the_oldest_files_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(jax_context, "_LARGEST_CACHE", 250)
    for number in range(4):
        (tmp_path / f"{number}").write_bytes(bytes(100))
        os.utime(tmp_path / f"{number}", (number, number))
    jax_context._remove_oldest(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["2", "3"]


def test_the_number_of_threads_is_part_of_the_key(monkeypatch):
    monkeypatch.setenv("NPROC", "1")
    one = jax_context._machine()
    monkeypatch.setenv("NPROC", "2")
    assert jax_context._machine() != one


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_memory_of_arrays_is_reused_in_workers_of_dask(monkeypatch):
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    code = """
import resource, numpy as np
from pcnde_bridge._utils.jax_context import double_precision
with double_precision(): pass
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20): np.ones(1 << 20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    pages = (8 << 20) / os.sysconf("SC_PAGE_SIZE")  # of one array
    assert int(done.stdout) < 2 * pages
