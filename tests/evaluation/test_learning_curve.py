"""Learning curves with fits that need no compiling."""

from __future__ import annotations

import pytest
from helpers import ToyEngine

from pcnde_bridge import PCNDE, Cases, InputError
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.evaluation import learning_curve
from pcnde_bridge.evaluation.design import choose


def test_designed_and_random_subsets(small_cases, toy_config, tmp_path):
    train, test = small_cases.select(slice(0, 8)), small_cases.select(slice(8, 12))
    engine, config = ToyEngine(), toy_config.replace(flow={"epochs": 2, "couple_every": 1})
    run = train, test, (2, 4), config, engine, 3
    table = learning_curve(*run, draws=2, folder=tmp_path, progress=False)
    assert table.index.tolist() == [
        (size, name) for size in (2, 4) for name in ("designed", "random 0", "random 1")
    ]
    assert table["failure"].isna().all()
    order = choose(ModelInputs(train.inflow, train.area_undeformed, train.grid), 4)["case"]
    model = PCNDE.fit(train.select(order.tolist()), config, engine, 3, progress=False)
    expected = model.evaluate(test).iloc[-1]
    found = table.loc[(4, "designed")]
    assert found["flow"] == expected["flow"]
    assert found["pressure_drop"] == expected["pressure_drop"]
    again = learning_curve(*run, draws=2, folder=tmp_path, progress=False)
    assert again.equals(table)
    with pytest.raises(InputError, match="result of other tasks"):
        learning_curve(train, test[:2], *run[2:], draws=2, folder=tmp_path, progress=False)
    with pytest.raises(InputError, match="numbers up to 8"):
        learning_curve(train, test, (9,), config, engine)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"train": "cases.npz"}, "train must be Cases, got str"),
        ({"test": None}, "test must be Cases, got NoneType"),
        ({"sizes": 4}, "sizes must be a sequence, got int"),
        ({"sizes": "4"}, r"sizes\[0\] must be a whole number ≥ 1, got '4'"),
        ({"sizes": [4, 0.5]}, r"sizes\[1\] must be a whole number ≥ 1, got 0.5"),
        ({"sizes": []}, r"numbers up to 12, got \[\]"),
    ],
)
def test_unusable_arguments_are_refused(small_cases, change, message):
    with pytest.raises(InputError, match=message):
        learning_curve(**{"train": small_cases, "test": small_cases, "sizes": [4]} | change)


def test_test_cases_on_another_grid_are_refused(small_cases, toy_config):
    names = "flow", "area", "pressure"
    halved = {name: getattr(small_cases, name)[:, ::2] for name in names}
    rest = {name: getattr(small_cases, name) for name in ("area_undeformed", "z", "period")}
    test = Cases(**halved, **rest, time=small_cases.time[::2], check=False)
    with pytest.raises(InputError, match="bring the cases to the model's grid"):
        learning_curve(small_cases, test, [4], toy_config, ToyEngine())
