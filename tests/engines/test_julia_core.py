"""Julia's own tests of PCNDECore, where the machine has a usable Julia."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from pcnde_bridge.engines.julia.environment import julia_status

pytestmark = pytest.mark.julia

# Tests of the checkout: an installed package does not contain them.
_TESTS = Path(__file__).parents[2] / "julia" / "PCNDECore" / "test" / "runtests.jl"


def test_julias_own_tests_pass():
    status = julia_status()
    if not (status.usable and status.executable and status.project):
        pytest.skip(status.message)
    done = subprocess.run(
        [
            str(status.executable),
            f"--project={status.project}",
            "--startup-file=no",
            str(_TESTS),
        ],
        env={**status.environment, **os.environ},
        capture_output=True,
        text=True,
        check=False,
        timeout=1200,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    assert "Pass" in done.stdout


def test_the_cores_tests_load_packages_through_the_core_only():
    """A project has the other packages only indirectly; static checks are optional."""
    loaded = {
        name
        for file in _TESTS.parent.glob("*.jl")
        for name in re.findall(r"^using (\w+)", file.read_text(), re.MULTILINE)
    }
    assert loaded == {"PCNDECore", "Test"}


_ONE_CASE_FAILS = """
include(ARGS[1])
for failing in 1:20  # in either thread
    done = Threads.Atomic{Int}(0)
    try
        threaded_batches(40) do batches
            for batch in batches
                batch == failing:failing && error("fails")
                began = time()
                while time() - began < 0.001
                end
                Threads.atomic_add!(done, 1)
            end
        end
    catch failure
        print(failure.msg, " ", done[], " ")
    end
end
print(Threads.nthreads())
"""


def test_no_thread_writes_on_after_another_failed():
    status = julia_status()
    if not (status.usable and status.executable):
        pytest.skip(status.message)
    done = subprocess.run(
        [
            str(status.executable),
            "--startup-file=no",
            "--threads=2",
            "-e",
            _ONE_CASE_FAILS,
            str(_TESTS.parents[1] / "src" / "threading.jl"),
        ],
        env={**status.environment, **os.environ},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.stdout == 20 * "fails 39 " + "2", done.stderr[-2000:]
