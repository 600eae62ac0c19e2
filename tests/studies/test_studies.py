"""Studies: their numbers against direct computations."""

from __future__ import annotations

import pickle
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

from pcnde_bridge import PCNDE, InputError
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.engines.parameters import PRESSURE_STAGES
from pcnde_bridge.hemodynamics import pressure_losses as stenosis
from pcnde_bridge.model.metrics import (
    AREA_MARGIN,
    error_table,
    relative_error,
)
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.studies import (
    activation_study,
    box_statistics,
    error_matrix,
    fourier_effect,
    noise_study,
    pointwise_errors,
    pressure_drops,
)
from pcnde_bridge.studies.activations import explained_variance, fit_pressure
from pcnde_bridge.studies.noise import noisy_inputs

pytestmark = pytest.mark.filterwarnings("ignore::pcnde_bridge.OutsideTrainingWarning")


@pytest.fixture
def toy_model(small_cases, toy_config, toy_engine) -> PCNDE:
    return PCNDE.fit(small_cases, toy_config, engine=toy_engine, seed=3, progress=False)


@pytest.fixture
def predicted(toy_model, small_cases):
    return toy_model.predict(small_cases).variables()


@pytest.fixture
def hardest(small_cases):
    return small_cases.select(geometry=3, waveform=3)


# ---- noise --------------------------------------------------------------------


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


def test_noise_has_the_size_asked_for_and_spares_the_other_input(hardest):
    inflow, area = noisy_inputs(hardest, "inflow", 0.05, 4000, 1, exact=2)
    np.testing.assert_array_equal(area, np.repeat(hardest.area_undeformed, 4002, axis=0))
    np.testing.assert_array_equal(inflow[:2], np.repeat(hardest.inflow, 2, axis=0))
    size = 0.05 * hardest.inflow.max()
    np.testing.assert_allclose(inflow[2:].std(axis=0), size, rtol=0.06)
    np.testing.assert_allclose(inflow[2:].mean(axis=0), hardest.inflow[0], atol=0.1 * size)
    # Every instant is drawn on its own.
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


def test_what_goes_to_a_process_can_go(small_model, hardest):
    """The tasks' arguments can be pickled, and give the same result there."""
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
        ({"seed": -1}, "seed must be"),
    ],
)
def test_bad_arguments_of_the_noise(toy_model, hardest, change, words):
    with pytest.raises(InputError, match=words):
        noise_study(toy_model, hardest, **change)


def test_noise_needs_one_case_on_the_models_grid(toy_model, small_cases, hardest):
    with pytest.raises(InputError, match="takes one case, got 12"):
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


# ---- activation functions -----------------------------------------------------


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
    # Only the mean over time, or that and an offset: nothing is explained.
    assert explained_variance(truth.mean(axis=1, keepdims=True) + 0 * truth, truth) == 0
    assert explained_variance(truth + 7, truth) == 1
    # Half of the swing leaves a quarter of its square.
    assert explained_variance(truth / 2, truth) == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"activations": ["cosine"]}, "cosine"),
        ({"activations": []}, "at least one"),
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
    with pytest.raises(InputError, match="no pressure network"):
        activation_study(toy_model, small_cases)
    with pytest.raises(InputError, match="no Fourier stage"):
        fourier_effect(toy_model, small_cases)


# ---- Fourier stage ------------------------------------------------------------


def test_fourier_effect_on_the_equations(small_model, small_cases):
    cases = small_cases
    effect = fourier_effect(small_model, cases)
    prediction = small_model.predict(cases)
    np.testing.assert_array_equal(effect.final, prediction.area)
    # The drift is that of the continuity equation: period times its mean right-hand side.
    a, b = np.split(small_model.parameters.intermediate_area, 2)
    slope = np.gradient(prediction.flow, cases.z, axis=2).mean(axis=1)
    inner = slice(1, -1)
    expected = (cases.period * (b - a * slope))[:, inner]
    np.testing.assert_allclose(effect.drift[:, inner], expected, rtol=1e-6, atol=1e-12)
    # Ŝ starts from S_u: two drifts before the last of its three cycles.
    before = effect.intermediate[:, 0] - 2 * effect.drift
    np.testing.assert_allclose(before, cases.area_undeformed, rtol=1e-9)

    frame = effect.to_frame()
    whole = slice(AREA_MARGIN, -AREA_MARGIN)
    truth = cases.area[:, :, whole]
    for name, area in (("intermediate", effect.intermediate), ("final", effect.final)):
        assert frame.loc[name, "error"] == relative_error(area[:, :, whole], truth)
    near = np.abs(effect.final - cases.area) < np.abs(effect.intermediate - cases.area)
    assert frame.loc["final", "closer"] == pytest.approx(near[:, :, whole].mean())
    drift = np.abs(effect.drift / cases.area_undeformed)[:, whole].max()
    assert frame.loc["intermediate", "drift"] == pytest.approx(drift)
    assert frame.loc["final", "drift"] == 0


# ---- pressure drop ------------------------------------------------------------


def test_pressure_drops_by_hand(small_cases, predicted):
    drops = pressure_drops(predicted["pressure"], small_cases)
    # z = 0, 0.2, … 4: the points nearest to 4/3 and 8/3 are 1.4 and 2.6.
    first, second = 7, 13
    np.testing.assert_array_equal(
        drops.predicted, predicted["pressure"][:, :, first] - predicted["pressure"][:, :, second]
    )
    truth = small_cases.pressure[:, :, first] - small_cases.pressure[:, :, second]
    np.testing.assert_array_equal(drops.truth, truth)
    throat = small_cases.area_undeformed[5].argmin()
    formula = stenosis.pressure_drop(
        small_cases.flow[5, 4, throat],
        small_cases.area_undeformed[5, 0],
        small_cases.area_undeformed[5].min(),
        0.5,
    )
    assert drops.empirical[5, 4] == pytest.approx(formula)

    frame = drops.to_frame()
    assert len(frame) == 13
    assert frame.loc[("pooled", "pooled"), "empirical"] == relative_error(drops.empirical, truth)
    assert frame.loc[(2, 1), "model"] == relative_error(drops.predicted[5], truth[5])
    above = (drops.empirical > truth).mean()
    assert frame.loc[("pooled", "pooled"), "overestimated"] == above


def test_pressure_drops_need_the_cases_pressure(small_cases, predicted):
    with pytest.raises(InputError, match=r"shape \(11, 20, 21\)"):
        pressure_drops(predicted["pressure"][1:], small_cases)


# ---- errors in detail ---------------------------------------------------------


def test_error_matrix_equals_the_table(small_cases, predicted):
    table = error_table(predicted, small_cases)
    matrices = error_matrix(predicted, small_cases)
    assert list(matrices) == ["flow", "area", "pressure"]
    for name, matrix in matrices.items():
        assert matrix.shape == (3, 4)
        for geometry in matrix.index:
            for waveform in matrix.columns:
                assert matrix.loc[geometry, waveform] == table.loc[(geometry, waveform), name]


def test_error_matrix_has_gaps_where_cases_are_missing(small_cases, predicted):
    chosen = small_cases.select([0, 5])
    matrix = error_matrix({"flow": predicted["flow"][[0, 5]]}, chosen)["flow"]
    assert matrix.isna().to_numpy().tolist() == [[False, True], [True, False]]


def test_error_matrix_is_in_order_whatever_the_cases_are(small_cases, predicted):
    order = np.random.default_rng(2).permutation(len(small_cases))
    shuffled = error_matrix({"flow": predicted["flow"][order]}, small_cases.select(order))["flow"]
    pd.testing.assert_frame_equal(shuffled, error_matrix(predicted, small_cases)["flow"])


def test_pointwise_errors_by_hand(toy_model, hardest):
    prediction = toy_model.predict(hardest)
    errors = pointwise_errors(prediction.variables(), hardest)
    flow = np.abs(prediction.flow[0] - hardest.flow[0])
    np.testing.assert_array_equal(errors.distance["flow"], flow)
    area = np.abs(prediction.area[0] - hardest.area[0]) / hardest.area[0, 0]
    np.testing.assert_array_equal(errors.distance["area"], area)
    frame = errors.to_frame()
    assert frame.loc["flow", "mean"] == flow.mean()
    assert frame.loc["area", "largest"] == area.max()
    # 21 points: ten on either side of the middle.
    assert frame.loc["flow", "upstream"] == pytest.approx(flow[:, :10].mean())
    assert frame.loc["flow", "downstream"] == pytest.approx(flow[:, 11:].mean())


def test_pointwise_errors_are_of_one_case(small_cases, predicted):
    with pytest.raises(InputError, match="of one case, got 12"):
        pointwise_errors(predicted, small_cases)


def test_errors_in_detail_are_of_like_shapes(small_cases, predicted, hardest):
    with pytest.raises(InputError, match=r"shape \(1, 20, 21\), not \(12, 20, 21\)"):
        box_statistics({"mine": {"flow": predicted["flow"][:1]}}, small_cases)
    with pytest.raises(InputError, match=r"shape \(1, 1, 21\), not \(1, 20, 21\)"):
        pointwise_errors({"flow": predicted["flow"][:1, :1]}, hardest)


def test_a_method_that_diverged_has_no_statistics(small_cases, predicted):
    nowhere = {"flow": np.full_like(small_cases.flow, np.nan)}
    frame = box_statistics({"diverged": nowhere, "PCNDE": predicted}, small_cases)
    assert frame.loc[("flow", "diverged")].isna().all()
    assert frame.loc[("flow", "PCNDE")].notna().all()


def test_box_statistics_equal_matplotlibs(small_cases, predicted):
    from matplotlib.cbook import boxplot_stats

    other = {"flow": small_cases.flow * 1.01, "area": small_cases.area * 0.98}
    frame = box_statistics({"PCNDE": predicted, "other": other}, small_cases)
    assert list(frame.index[:3]) == [(name, "PCNDE") for name in ("flow", "area", "pressure")]
    inner = slice(AREA_MARGIN, -AREA_MARGIN)
    truth = small_cases.area[:, :, inner]
    errors = (np.abs(predicted["area"][:, :, inner] - truth) / truth).ravel()
    box = boxplot_stats(errors)[0]
    row = frame.loc[("area", "PCNDE")]
    names = {"median": "med", "lower": "q1", "upper": "q3", "low": "whislo", "high": "whishi"}
    for mine, theirs in names.items():
        assert row[mine] == pytest.approx(box[theirs], rel=1e-12)
    assert row["largest"] == errors.max()
    assert row["outliers"] == pytest.approx(len(box["fliers"]) / errors.size)
    assert frame.loc[("flow", "other"), "median"] == pytest.approx(0.01)
    assert frame.loc[("area", "other"), "largest"] == pytest.approx(0.02)


def test_box_statistics_need_a_truth_without_zeros(small_cases):
    flow = small_cases.flow.copy()
    flow[3, 2, 1] = 0
    cases = type(small_cases)(
        flow,
        small_cases.area,
        small_cases.pressure,
        small_cases.area_undeformed,
        small_cases.time,
        small_cases.z,
    )
    with pytest.raises(InputError, match="flow is 0 somewhere"):
        box_statistics({"mine": {"flow": flow}}, cases)


# ---- models without pressure --------------------------------------------------


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
