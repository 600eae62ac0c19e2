from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge.engines.jax.engine import JaxEngine


@pytest.fixture(scope="session")
def engine():
    return JaxEngine()


@pytest.fixture(scope="session")
def grid(small_cases):
    return small_cases.grid


@pytest.fixture(scope="session")
def everything(small_cases):
    """All cases in one part: nothing is left for validation."""
    return (np.arange(len(small_cases)),)
