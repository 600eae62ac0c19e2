"""Fixtures of the studies: a model without compilation, its predictions, and the hardest case."""

from __future__ import annotations

import warnings

import pytest

from pcnde_bridge import PCNDE, OutsideTrainingWarning
from pcnde_bridge.config import PAPER, PCNDEConfig


@pytest.fixture
def toy_model(small_cases, toy_config, toy_engine) -> PCNDE:
    return PCNDE.fit(small_cases, toy_config, engine=toy_engine, seed=3, progress=False)


@pytest.fixture
def predicted(toy_model, small_cases):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        return toy_model.predict(small_cases).variables()


@pytest.fixture
def hardest(small_cases):
    return small_cases.select(geometry=3, waveform=3)


@pytest.fixture(scope="session")
def short_config() -> PCNDEConfig:
    """Two epochs in two batches, coupled once: one short training for all tests."""
    return PAPER.replace(
        batch_size=6,
        flow={"epochs": 2, "couple_every": 1, "iterations": 2, "steps": 20, "hidden": (4,)},
        temporal_flow={"epochs": 2, "iterations": 2, "hidden": (4,)},
        intermediate_area={"iterations": 2},
        fourier_area={"iterations": 2},
    )
