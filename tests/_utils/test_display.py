"""Short representations of the public objects, as text and as a table in notebooks."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import made_by_the_closures

from pcnde_bridge import FAST, PAPER, PHYSICS, PRESETS, PCNDEConfig
from pcnde_bridge.config import settings
from pcnde_bridge.hemodynamics import Stenosis, Vessel, Waveform, coronary
from pcnde_bridge.studies import pressure_drops


@pytest.fixture(scope="module")
def objects(physics_model, physics_cases, physics_prediction):
    model = physics_model
    parts = model.grid, model.parameters, model.novelty, model.uncertainty, model.engine
    drops = pressure_drops(physics_prediction.pressure, physics_cases, model.config.physics)
    hemodynamics = coronary(), Waveform(1.0), Vessel((Stenosis(0.7),))
    return [
        model,
        physics_cases,
        physics_prediction,
        *parts,
        drops,
        *hemodynamics,
        *PRESETS.values(),
    ]


def test_every_representation_is_short(objects):
    for shown in objects:
        text = repr(shown)
        assert text.startswith(f"{type(shown).__name__}(")
        assert len(text) <= 200
        assert "\n" not in text


def test_facts_that_identify_a_model(physics_model):
    text = repr(physics_model)
    for fact in ("preset physics", "16 training cases, seed 0", "41 points", "engine jax"):
        assert fact in text


def test_facts_of_a_prediction(physics_model, physics_prediction, physics_cases):
    text = repr(physics_prediction)
    for fact in ("16 cases: flow, area, pressure, wall shear stress", "12 samples", "novelty up"):
        assert fact in text
    alone = physics_model.predict(physics_cases[0])
    assert "samples" not in repr(alone)
    assert "1 case:" in repr(alone)


def test_a_configuration_shows_what_differs_and_can_be_read_again():
    assert repr(PAPER) == "PCNDEConfig()"
    assert repr(FAST.flow) == "FlowStage(steps=12)"
    for config in (*PRESETS.values(), PHYSICS.replace(correction={"hidden": (4, 3)})):
        assert eval(repr(config), vars(settings)) == config
    assert PCNDEConfig(flow={"steps": 12}).flow.steps == 12


def test_tables_in_notebooks(objects, physics_prediction):
    for shown in objects:
        if hasattr(shown, "_repr_html_"):
            assert shown._repr_html_().startswith(f"<table><tr><th>{type(shown).__name__}<")
    assert "<td>12 samples</td>" in physics_prediction._repr_html_()
    assert "<td>flow: {" in FAST._repr_html_()
    assert "<script>" not in Waveform(1.0)._repr_html_()


def test_figures_of_objects(physics_prediction, physics_cases):
    assert len(physics_cases.plot().axes) == 3
    figure = physics_prediction.plot(3, physics_cases, "exact")
    assert len(figure.axes) == 8
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["exact", "PCNDE", "90 % interval"]
    low, high = physics_prediction.interval(0.9)["flow"]
    band = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    point = int(np.abs(physics_cases.z - 3.6).argmin())
    assert band.min() == pytest.approx(low[3, :, point].min())
    assert band.max() == pytest.approx(high[3, :, point].max())
    alone = made_by_the_closures().plot()
    assert alone.axes[0].lines
