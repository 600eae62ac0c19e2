from __future__ import annotations

import pytest
from helpers import ToyEngine

from pcnde_bridge import Ensemble


@pytest.fixture(scope="session")
def engine():
    return ToyEngine()


@pytest.fixture(scope="session")
def config(toy_config):
    return toy_config.replace(flow={"epochs": 2, "couple_every": 1})


@pytest.fixture(scope="session")
def ensemble(small_cases, config, engine):
    return Ensemble.fit(small_cases, config, engine, members=3, folds=2, progress=False)
