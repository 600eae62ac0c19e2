"""Activation study: its errors equal those of whole fits."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge import PCNDE, InputError
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.engines.parameters import PRESSURE_STAGES
from pcnde_bridge.model.metrics import (
    relative_error,
)
from pcnde_bridge.studies import (
    activation_study,
    fourier_effect,
)
from pcnde_bridge.studies.activations import explained_variance, fit_pressure

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")


@pytest.mark.parametrize("training", ["minibatch", "full_batch"])
def test_activations_equal_whole_fits(small_cases, toy_config, toy_engine, training):
    config = toy_config.replace(
        training=training, full_batch={"rounds": 1, "iterations": 4, "pressure_iterations": 6}
    )
    train, test = small_cases.split("paper")

    def fit(activation):
        changed = config.replace(temporal_pressure={"activation": activation})
        return PCNDE.fit(train, changed, engine=toy_engine, seed=1, progress=False)

    study = activation_study(fit("tanh"), train, test, activations=["swish", "tanh"], seeds=[1])
    assert list(study.index) == [("swish", 1), ("tanh", 1)]
    for activation in ("swish", "tanh"):
        whole = fit(activation)
        for name, cases in (("train", train), ("test", test)):
            error = relative_error(whole.predict(cases).pressure, cases.pressure)
            assert study.loc[(activation, 1), name] == error


def test_activations_without_test_cases_and_with_seeds(toy_model, small_cases):
    study = activation_study(toy_model, small_cases, activations=["relu"], seeds=[0, 1])
    assert list(study.columns) == ["train", "train_explained"]
    assert study["train"].nunique() == 2


def test_only_the_pressure_is_fitted_again(toy_model, small_cases, toy_engine):
    before = len(toy_engine.flow.fits)
    again = fit_pressure(toy_engine, toy_model.config, toy_model.parameters, 9, small_cases)
    assert len(toy_engine.flow.fits) == before
    assert np.array_equal(again.flow, toy_model.parameters.flow)
    assert np.array_equal(again.fourier_area, toy_model.parameters.fourier_area)
    for stage in PRESSURE_STAGES:
        assert not np.array_equal(getattr(again, stage), getattr(toy_model.parameters, stage))


def test_explained_variance_by_hand():
    truth = np.array([[[1.0], [3.0]], [[0.0], [4.0]]])
    assert explained_variance(truth, truth) == 1
    # The mean over time alone explains nothing.
    assert explained_variance(truth.mean(axis=1, keepdims=True) + 0 * truth, truth) == 0
    assert explained_variance(truth + 7, truth) == 1
    # Half of the amplitude leaves a quarter of the variance.
    assert explained_variance(truth / 2, truth) == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"activations": ["cosine"]}, "cosine"),
        ({"activations": []}, "Give some activations"),
        ({"activations": ["relu", "relu"]}, "none twice"),
        ({"seeds": []}, "at least one"),
        ({"seeds": [0, 0]}, "none twice"),
        ({"seeds": [-1]}, r"seeds\[0\] must be a whole number"),
    ],
)
def test_bad_arguments_of_the_activations(toy_model, small_cases, change, words):
    with pytest.raises(InputError, match=words):
        activation_study(toy_model, small_cases, **change)


def test_activations_need_the_models_grid(toy_model, small_cases, other_period):
    for train, test in ((other_period, None), (small_cases, other_period)):
        with pytest.raises(InputError, match=r"is 0\.76 in the cases but 0\.95 in"):
            activation_study(toy_model, train, test)


def test_physics_models_have_neither_network_nor_fourier_stage(small_cases, toy_model):
    toy_model.config = PHYSICS
    with pytest.raises(InputError, match="needs the paper's equations"):
        activation_study(toy_model, small_cases)
    with pytest.raises(InputError, match="needs the paper's equations"):
        fourier_effect(toy_model, small_cases)
