"""Sobol indices of a formula, and of a fitted model."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import InputError, MissingExtraError, PCNDEWarning
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.evaluation import sensitivity, sobol_indices
from pcnde_bridge.hemodynamics import Reflection, Stenosis, Vessel, coronary

pytest.importorskip("SALib")

RANGES = {"blockage": (0.4, 0.8), "mean_flow": (1.0, 2.0), "amplitude": (0.5, 1.5)}


class Formula:
    """Model whose index is 5·blockage + mean flow, as its inputs show them."""

    grid = Grid(np.arange(40) / 40, np.linspace(0, 4, 401), 1.0)

    def predict_batches(self, inflow, area_undeformed):
        blockage = 1 - area_undeformed.min(axis=1) / area_undeformed[:, 0]
        index = 5 * blockage + inflow.mean(axis=1)
        for part in np.split(index, range(100, len(index), 100)):
            table = pd.DataFrame({"ffr": part, "flow": part**2})
            yield SimpleNamespace(indices=lambda table=table: table)


def test_indices_of_a_sum():
    """The shares of the variance are known: 5²·0.4² and 1."""
    found = sobol_indices(Formula(), RANGES, ("ffr",), samples=1024).loc["ffr"]
    shares = np.array([4.0, 1.0, 0.0]) / 5
    assert found.index.tolist() == [*RANGES]
    assert np.allclose(found["total"], shares, atol=0.02)
    assert np.allclose(found["first"], shares, atol=0.02)
    assert (found["total_interval"] < 0.15).all()


def test_a_repetition_has_the_same_intervals():
    first, second = (sobol_indices(Formula(), RANGES, ("ffr",), samples=16) for _ in range(2))
    assert first.equals(second)


def test_a_model_of_the_preset_physics(physics_model):
    ranges = {"blockage": (0.45, 0.6), "amplitude": (0.8, 1.0)}
    found = sobol_indices(physics_model, ranges, ("ffr", "mean_drop_mmHg"), samples=16)
    assert found.index.names == ["index", "input"]
    assert found.loc[("mean_drop_mmHg", "blockage"), "total"] > 0.5


def test_length_and_period_are_those_of_the_vessel_and_the_waveform(physics_model, monkeypatch):
    given = {}

    def predict_batches(_, inflow, area_undeformed, **options):
        given.update(options)
        index = np.asarray(area_undeformed).min(axis=1)
        yield SimpleNamespace(indices=lambda: pd.DataFrame({"ffr": index}))

    monkeypatch.setattr(type(physics_model), "predict_batches", predict_batches)
    vessel, waveform = Vessel((Stenosis(0.6),), length=5.0), replace(coronary(), period=0.8)
    options = {"samples": 2, "vessel": vessel, "waveform": waveform}
    sobol_indices(physics_model, {"blockage": (0.5, 0.6)}, ["ffr"], **options)
    assert given["period"] == 0.8
    assert given["z"][-1] == 5.0
    monkeypatch.setattr(type(physics_model), "any_grid", False)
    with pytest.raises(InputError, match=r"5 cm long and the period of the waveform is 0.8 s, but"):
        sobol_indices(physics_model, {"blockage": (0.5, 0.6)}, ["ffr"], **options)


def test_outlet_and_wall(physics_model):
    """Pressures grow with the resistance; the stiffness has little effect on their means."""
    ranges = {"outlet_resistance": (0.8, 1.2), "wall_stiffness": (0.5, 2.0)}
    pressures = ("mean_pressure_mmHg", "systolic_mmHg")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = sobol_indices(physics_model, ranges, pressures, samples=32)
    # Not once more for each value of the stiffness.
    kinds = [w.category for w in caught if issubclass(w.category, PCNDEWarning)]
    assert len(kinds) == len(set(kinds))
    means = found.loc["mean_pressure_mmHg", "total"]
    assert means["outlet_resistance"] > 0.9 > 0.1 > means["wall_stiffness"]
    assert found.loc[("systolic_mmHg", "wall_stiffness"), "total"] > means["wall_stiffness"]


def test_factors_of_one_change_nothing(physics_model):
    names = ["blockage", "outlet_resistance", "wall_stiffness"]
    points = np.array([[0.5, 1.0, 1.0], [0.6, 1.0, 1.0 + 1e-12]])
    rest = ["ffr"], Vessel((Stenosis(0.5),)), coronary()
    expected = sensitivity._evaluate(physics_model, names[:1], points[:, :1], *rest)
    found = sensitivity._evaluate(physics_model, names, points, *rest)
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["outlet_resistance", "wall_stiffness"])
def test_factors_need_the_preset_physics_and_are_positive(name, physics_model):
    for model, limits in ((Formula(), (0.5, 2.0)), (physics_model, (0.0, 2.0))):
        with pytest.raises(InputError, match=f"{name}: .* positive factors"):
            sobol_indices(model, {name: limits})


def test_an_outlet_without_resistance_is_refused(physics_model):
    model = replace(physics_model, outlet=Reflection())
    with pytest.raises(InputError, match="has no resistance common to all cases"):
        sobol_indices(model, {"outlet_resistance": (0.5, 2.0)}, samples=2)


@pytest.mark.parametrize(
    "change",
    [
        {"ranges": {}},
        {"ranges": ["blockage"]},
        {"ranges": None},
        {"ranges": {"blockage": 0.5}},
        {"ranges": {"blockage": "ab"}},
        {"indices": "ffr"},
        {"indices": []},
        {"indices": 3},
        {"indices": ["positions"]},
        {"vessel": Vessel()},
        {"vessel": "paper"},
        {"waveform": np.ones(40)},
        {"samples": 2**40},
        {"samples": 1000},
    ],
)
def test_unusable_arguments_are_refused(physics_model, change):
    with pytest.raises(InputError, match=next(iter(change)).replace("indices", "ind(ices|ex)")):
        sobol_indices(physics_model, **{"ranges": {"blockage": (0.5, 0.6)}, "samples": 2} | change)


@pytest.mark.parametrize(
    "ranges",
    [{"colour": (0, 1)}, {"blockage": (0.8, 0.4)}, {"blockage": (0.4, 0.5, 0.6)}, {3: (0, 1)}],
)
def test_unusable_ranges_are_refused(ranges):
    with pytest.raises(InputError, match="is not a range of one of"):
        sobol_indices(Formula(), ranges)


def test_no_model_is_refused():
    with pytest.raises(InputError, match="model must be a fitted model, got str"):
        sobol_indices("model.npz", RANGES)


def test_unknown_indices_are_refused():
    with pytest.raises(InputError, match="no index 'weight'"):
        sobol_indices(Formula(), RANGES, ("weight",), samples=2)


def test_a_missing_extra_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "SALib.sample.sobol", None)
    with pytest.raises(MissingExtraError, match=r"pip install \"\.\[sensitivity\]\""):
        sobol_indices(Formula(), RANGES)
