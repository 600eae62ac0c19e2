"""Noise study: mean and standard deviation equal a direct loop."""

from __future__ import annotations

import pickle
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
from helpers import ToyEngine

from pcnde_bridge import PCNDE, InputError, PCNDEWarning, SolveError, TaskError
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.studies import (
    noise_study,
)
from pcnde_bridge.studies.noise import noisy_inputs

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")


@pytest.mark.parametrize("noisy", ["inflow", "area_undeformed"])
@pytest.mark.parametrize("samples", [2, 7, 40])
def test_noise_equals_a_direct_loop(toy_model, hardest, noisy, samples):
    study = noise_study(toy_model, hardest, noisy, level=0.1, samples=samples, seed=5)
    inflow, area = noisy_inputs(hardest, noisy, 0.1, samples, 5)
    each = [toy_model.predict(q, s).variables() for q, s in zip(inflow, area, strict=True)]
    for name in ("flow", "area", "pressure"):
        values = np.array([one[name][0] for one in each])
        np.testing.assert_allclose(study.mean[name], values.mean(axis=0), rtol=1e-12)
        deviation = values.std(axis=0, ddof=1)
        np.testing.assert_allclose(study.standard_deviation[name], deviation, rtol=1e-9, atol=1e-14)
        spread = deviation.mean() / np.abs(values.mean(axis=0)).max()
        assert study.spread()[name] == pytest.approx(spread, rel=1e-9)
        clean = toy_model.predict(hardest).variables()[name][0]
        np.testing.assert_allclose(study.unperturbed[name], clean, rtol=1e-12)
        bias = np.abs(values.mean(axis=0) - clean).max() / np.abs(values.mean(axis=0)).max()
        assert study.to_frame().loc[name, "bias"] == pytest.approx(bias, rel=1e-6)


def test_noise_has_its_size_and_leaves_the_other_input(hardest):
    inflow, area = noisy_inputs(hardest, "inflow", 0.05, 4000, 1, exact=2)
    np.testing.assert_array_equal(area, np.repeat(hardest.area_undeformed, 4002, axis=0))
    np.testing.assert_array_equal(inflow[:2], np.repeat(hardest.inflow, 2, axis=0))
    size = 0.05 * hardest.inflow.max()
    np.testing.assert_allclose(inflow[2:].std(axis=0), size, rtol=0.06)
    np.testing.assert_allclose(inflow[2:].mean(axis=0), hardest.inflow[0], atol=0.1 * size)
    # Every time point has independent noise.
    correlation = np.corrcoef((inflow[2:] - hardest.inflow).T) - np.eye(inflow.shape[1])
    assert np.abs(correlation).max() < 0.1


def test_noisy_areas_stay_positive(hardest):
    _, area = noisy_inputs(hardest, "area_undeformed", 0.5, 200, 0)
    assert (area > 0).all()
    assert np.unique(area).size == area.size


def test_no_noise_no_deviation(toy_model, hardest):
    study = noise_study(toy_model, hardest, level=0.0, samples=3)
    assert max(study.spread().values()) < 1e-14


def test_noise_in_an_executor_gives_the_same_bits(toy_model, hardest):
    here = noise_study(toy_model, hardest, samples=70)
    with ThreadPoolExecutor(2) as executor:
        there = noise_study(toy_model, hardest, samples=70, executor=executor)
    for name in here.mean:
        np.testing.assert_array_equal(here.mean[name], there.mean[name])
        np.testing.assert_array_equal(here.standard_deviation[name], there.standard_deviation[name])


def test_tasks_can_be_sent_to_processes(small_model, hardest):
    """Arguments of the tasks can be pickled, and give the same result."""
    sent = []

    class Process(Executor):
        def submit(self, function, /, *arguments):
            again, *rest = pickle.loads(pickle.dumps((function, *arguments)))  # noqa: S301
            sent.append(rest)
            future = Future()
            future.set_result(again(*rest))
            return future

    there = noise_study(small_model, hardest, samples=11, executor=Process())
    here = noise_study(small_model, hardest, samples=11)
    assert len(sent) == 1  # eleven samples are one task
    np.testing.assert_array_equal(here.standard_deviation["flow"], there.standard_deviation["flow"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"noisy": "pressure"}, "noisy must be one of"),
        ({"level": -0.1}, "level must be"),
        ({"level": np.nan}, "level must be"),
        ({"samples": 1}, "samples must be"),
        ({"samples": True}, "samples must be"),
        ({"samples": 10**9}, "GB of memory"),
        ({"seed": -1}, "seed must be"),
    ],
)
def test_bad_arguments_of_the_noise(toy_model, hardest, change, words):
    with pytest.raises(InputError, match=words):
        noise_study(toy_model, hardest, **change)


def test_noise_needs_one_case_on_the_models_grid(toy_model, small_cases, hardest):
    with pytest.raises(InputError, match="needs one case, got 12"):
        noise_study(toy_model, small_cases)
    other = type(hardest)(
        hardest.flow[:, :, 1:],
        hardest.area[:, :, 1:],
        hardest.pressure[:, :, 1:],
        hardest.area_undeformed[:, 1:],
        hardest.time,
        hardest.z[1:],
    )
    with pytest.raises(InputError, match="model was trained on 21"):
        noise_study(toy_model, other)


def test_noise_of_a_model_without_pressure(toy_model, hardest):
    model = PCNDE(
        toy_model.config,
        toy_model.parameters.without_pressure(),
        hardest.grid,
        toy_model.engine,
    )
    assert isinstance(model.predict(hardest), Prediction)
    study = noise_study(model, hardest, samples=4)
    assert list(study.mean) == ["flow", "area"]
    assert isinstance(study.to_frame(), pd.DataFrame)


@pytest.mark.parametrize("lost", [[3], [0, 5, 6]])
def test_samples_that_cannot_be_solved_are_left_out(toy_model, hardest, lost):
    """Mean and deviation are those of the others, whatever the blocks."""
    inflow, area = noisy_inputs(hardest, "inflow", 0.05, 40)
    bad = inflow[lost]
    engine = Diverging(toy_model.engine, bad)
    model = PCNDE(toy_model.config, toy_model.parameters, hardest.grid, engine)
    with pytest.warns(PCNDEWarning, match=rf"diverge for {len(lost)} of 40 samples"):
        study = noise_study(model, hardest, samples=40)
    assert study.samples == 40 - len(lost)
    rest = np.setdiff1d(np.arange(40), lost)
    flow = np.array([toy_model.predict(inflow[i], area[i]).flow[0] for i in rest])
    np.testing.assert_allclose(study.mean["flow"], flow.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(
        study.standard_deviation["flow"], flow.std(axis=0, ddof=1), rtol=1e-9
    )
    with pytest.raises(TaskError, match=r"without noise|cannot be solved"):
        noise_study(
            PCNDE(model.config, model.parameters, hardest.grid, Diverging(engine, hardest.inflow)),
            hardest,
            samples=4,
        )


class Diverging(ToyEngine):
    """Toy engine that cannot solve some inflows, and names the first of each batch."""

    def __init__(self, engine, bad):
        super().__init__()
        self.bad = bad

    def predict(self, parameters, inputs, *arguments):
        for case, inflow in enumerate(inputs.inflow):
            if (inflow == self.bad).all(axis=1).any():
                raise SolveError("cannot be solved", [case])
        return super().predict(parameters, inputs, *arguments)
