from __future__ import annotations

import pytest

from pcnde_bridge.engines.jax.engine import JaxEngine


@pytest.fixture(scope="session")
def engine():
    return JaxEngine()


@pytest.fixture(scope="session")
def grid(small_cases):
    return small_cases.grid
