"""Sweeps with fits that need no compiling."""

from __future__ import annotations

import pytest
from helpers import FailingEngine, ToyEngine

from pcnde_bridge import PCNDE, InputError, sweep


@pytest.fixture(scope="module")
def engine():
    return ToyEngine()


@pytest.fixture(scope="module")
def config(toy_config):
    return toy_config.replace(flow={"epochs": 2, "couple_every": 1})


def test_a_sweep(small_cases, other_period, config, engine):
    train, held = small_cases.select(waveform=[0, 1, 3]), small_cases.select(waveform=[2])
    configs = {"plain": config, "longer": config.replace(flow={"iterations": 5})}
    table = sweep(train, held, configs, (0, 4), engine, progress=False)
    assert list(table.index) == [(name, k) for name in configs for k in (0, 4)]
    model = PCNDE.fit(train, configs["longer"], engine, 4, progress=False)
    assert (
        table.loc[("longer", 4), ["flow", "area", "pressure"]].tolist()
        == model.evaluate(held).iloc[-1][["flow", "area", "pressure"]].tolist()
    )
    assert table["flow"].nunique() == 4
    alone = sweep(train, None, {"plain": config}, (0,), engine, progress=False)
    assert "flow" not in alone
    assert alone["train_flow"].iloc[0] == table["train_flow"].iloc[0]
    with pytest.raises(InputError, match="mapping of names to configurations: at least one"):
        sweep(train, held, {}, (0,), engine)
    with pytest.raises(InputError, match=r"none twice; got \[0, 0, 1\]"):
        sweep(train, held, configs, [0, 0, 1], engine)
    # Before anything is fitted.
    for arguments, message in (
        ((train, other_period, configs), r"bring the cases to the model's grid \(train.time\)"),
        ((None, held, configs), "train must be Cases, got NoneType"),
        ((train, held.flow, configs), "held_out must be Cases, got ndarray"),
        ((train, held, "fast"), "needs a mapping of names"),
    ):
        with pytest.raises(InputError, match=message):
            sweep(*arguments, (0,), FailingEngine(set()))
