"""The stored reference outputs are those of the scripts beside them."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from reference_outputs import assert_near, reference

FOLDER = Path(__file__).parent
SELF_CONVERGED = {"boileau"}  # curves of the solver itself, see benchmarks/boileau.py
SCRIPTS = sorted({path.stem for path in FOLDER.glob("*.npz")} - SELF_CONVERGED)


def test_scripts_use_numpy_and_scipy_alone():
    assert SCRIPTS == ["paper_stages", "physics_closures", "tube"]
    for path in FOLDER.glob("*.py"):
        if not path.name.startswith("test_"):
            assert "pcnde_bridge" not in path.read_text(encoding="utf-8").split("import", 1)[1]
    assert sum(path.stat().st_size for path in FOLDER.glob("*.npz")) < 1e6


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_outputs_are_those_of_the_scripts(name):
    stored, computed = reference(name), runpy.run_path(str(FOLDER / f"{name}.py"))["compute"]()
    assert stored.keys() == computed.keys()
    for key, values in stored.items():
        # The tolerance of newton_krylov, and of the least accurate solver, Radau.
        assert_near(np.asarray(computed[key]), values, 1e-8)
