"""Given outlets of the preset ``physics``: at training and at prediction."""

import numpy as np
import pytest
from helpers import (
    AREA,
    CONFIG,
    CORRECTED,
    GRID,
    INFLOW,
    PHYSICS_CONFIG,
    RADIUS,
    as_cases,
    fit_physics,
    same_bits,
)

from pcnde_bridge import PCNDE, Ensemble, InputError, cross_validate, sweep
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.evaluation import learning_curve
from pcnde_bridge.hemodynamics import (
    CoronaryOutlet,
    Reflection,
    Tube1D,
    Waveform,
    Windkessel,
    synthetic,
)
from pcnde_bridge.model.predictor import predict

MUSCLE = Waveform(2e4, (-1e4, 2e3), (5e3, 0.0))
SUCTION = Windkessel(5e4, distal_pressure=MUSCLE)
CORONARY = CoronaryOutlet(3e4, 5e4, 2e4, 4e-7, 3e-6, MUSCLE, 5e3)
RESISTANCES = np.linspace(6e4, 1.2e5, 16)
OWN = Windkessel(0.2 * RESISTANCES, 0.8 * RESISTANCES, 5e-7, 5e3)
INPUTS = ModelInputs(INFLOW, AREA, GRID)


def made_with(outlet):
    """Cases of the closures with an outlet."""
    config = CONFIG.replace(losses={"spacing": RADIUS / 10})
    at_end = CORRECTED.respond(outlet, INPUTS, config)
    found = select_engine("jax").closures.predict(CORRECTED, np.zeros(16), INPUTS, config, at_end)
    return as_cases(found)


@pytest.fixture(scope="module")
def own_cases():
    return made_with(OWN)


@pytest.fixture(scope="module")
def own_model(own_cases):
    return fit_physics(own_cases, outlet=OWN)


@pytest.mark.parametrize("outlet", [SUCTION, CORONARY, OWN, Reflection(0.5, 8e4)])
def test_the_outlet_is_met_and_another_one_than_the_trained(physics_model, outlet):
    reference = made_with(outlet)
    found = physics_model.predict(reference, outlet=outlet)
    at_end = CORRECTED.respond(outlet, INPUTS, CONFIG)
    own = np.fft.irfft(at_end[:, 0] * np.fft.rfft(found.flow[:, :, -1]) + at_end[:, 1], n=32)
    if not isinstance(outlet, Reflection):  # which refers to the model's wall
        np.testing.assert_allclose(found.pressure[:, :, -1], own, rtol=1e-6)
    errors = physics_model.evaluate(reference, outlet).iloc[-1]
    assert (errors[["flow", "area", "pressure"]] < [2e-3, 1e-3, 2e-3]).all()
    trained = physics_model.evaluate(reference).iloc[-1]
    assert trained["pressure"] > 10 * errors["pressure"]


def test_batches_and_samples_have_the_outlet(physics_model, physics_cases):
    given = physics_cases.inflow, physics_cases.area_undeformed
    whole = physics_model.predict(*given, outlet=OWN, samples=4)
    parts = list(physics_model.predict_batches(*given, outlet=OWN, samples=4, batch=5))
    for name in ("flow", "pressure"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_allclose(joined, getattr(whole, name), rtol=1e-9)
        of_samples = np.concatenate([part.samples[name] for part in parts], axis=1)
        np.testing.assert_allclose(of_samples, whole.samples[name], rtol=1e-9)
    assert whole.samples["pressure"][:, 0].mean() < 0.8 * whole.samples["pressure"][:, -1].mean()


def test_training_with_an_outlet_for_each_case(own_model, own_cases, tmp_path):
    errors = own_model.evaluate(own_cases, OWN).iloc[-1]
    assert (errors[["flow", "area", "pressure"]] < [1e-3, 5e-4, 1e-3]).all()
    # One outlet for all of them cannot be right.
    fitted = fit_physics(own_cases).evaluate(own_cases).iloc[-1]
    assert fitted["pressure"] > 20 * errors["pressure"]
    own_model.save(tmp_path / "model.npz")
    loaded = PCNDE.load(tmp_path / "model.npz", "jax")
    assert same_bits(loaded.predict(own_cases, outlet=OWN), predict(own_model, own_cases, OWN))
    for model in (own_model, loaded):
        with pytest.raises(InputError, match="its own outlet: give outlet="):
            model.predict(own_cases)


def test_one_given_outlet_is_that_of_the_predictions(own_cases, tmp_path):
    file = tmp_path / "model.npz"
    given = made_with(CORONARY)
    without = PHYSICS_CONFIG.replace(correction={"folds": 0})
    model = fit_physics(given, without, outlet=CORONARY, checkpoint=tmp_path / "checkpoint")
    assert model.evaluate(given)["pressure"].iloc[-1] < 1e-3
    model.save(file)
    assert same_bits(PCNDE.load(file, "jax").predict(given), model.predict(given))
    for outlet in (None, SUCTION):
        with pytest.raises(InputError, match="another outlet"):
            fit_physics(given, without, outlet=outlet, checkpoint=tmp_path / "checkpoint")


def test_only_the_preset_physics_takes_outlets(small_model, small_cases, toy_engine, toy_config):
    for use in (
        lambda: small_model.predict(small_cases, outlet=SUCTION),
        lambda: PCNDE.fit(small_cases, toy_config, toy_engine, outlet=SUCTION),
    ):
        with pytest.raises(InputError, match="only the preset 'physics'"):
            use()


@pytest.mark.parametrize(
    ("outlet", "words"),
    [
        ({"kind": "Reflection"}, r"such as Windkessel\(resistance=1e4\), .* Reflection, got {"),
        (Windkessel(np.ones(3)), "one for each of 16 cases"),
        (Windkessel(8e4, distal_pressure=Waveform(1.0, period=0.8)), "period of 0.8 s"),
    ],
)
def test_unusable_outlets(physics_model, physics_cases, outlet, words):
    with pytest.raises(InputError, match=words):
        physics_model.predict(physics_cases, outlet=outlet)


def test_an_ensemble_passes_the_outlet_on(physics_model, physics_cases):
    calibration = physics_model.uncertainty.calibration
    ensemble = Ensemble([physics_model, physics_model], calibration)
    alone = physics_model.predict(physics_cases, outlet=SUCTION)
    np.testing.assert_allclose(ensemble.predict(physics_cases, outlet=SUCTION).flow, alone.flow)


@pytest.fixture
def fits(own_model, monkeypatch):
    """Fits that return the model of all cases; their cases and outlets."""
    found = []

    def fit(cases, *_, outlet, **__):
        found.append((cases, outlet))
        return own_model

    monkeypatch.setattr(PCNDE, "fit", fit)
    return found


def test_each_fit_and_fold_has_the_outlets_of_its_cases(fits, own_cases, own_model):
    """The errors are those of the model with the outlets of the cases."""
    given = own_cases, PHYSICS_CONFIG, "jax"
    ensemble = Ensemble.fit(*given, members=2, folds=2, outlet=OWN, progress=False)
    table = cross_validate(*given, outlet=OWN, progress=False)
    assert {len(cases) for cases, _ in fits} == {8, 12, 16}
    for cases, outlet in fits:
        rows = (4 * cases.labels["geometry"] + cases.labels["waveform"] - 4).to_numpy()
        np.testing.assert_array_equal(outlet.resistance, 0.2 * RESISTANCES[rows])
        assert outlet.capacitance == OWN.capacitance
    assert (table[["pressure", "train_pressure"]] < 1e-3).to_numpy().all()
    assert ensemble.calibration.profile[2].max() < 5e-3 * own_cases.pressure.max()
    errors = ensemble.evaluate(own_cases, OWN)
    assert errors.equals(own_model.evaluate(own_cases, OWN))


def test_outlets_of_fits_that_are_not_usable(fits, own_cases, toy_config):
    def unusable(words, function, *given, **options):
        with pytest.raises(InputError, match=words):
            function(*given, progress=False, **options)
        assert not fits

    unusable("common to all cases", sweep, own_cases, own_cases, {"a": "physics"}, outlet=OWN)
    unusable("common to all cases", learning_curve, own_cases, own_cases, [4], outlet=OWN)
    for function in (Ensemble.fit, cross_validate):
        wrong = Windkessel(np.ones(17))
        unusable("one for each of 16 cases", function, own_cases, "physics", outlet=wrong)
        unusable("only the preset 'physics'", function, own_cases, toy_config, outlet=SUCTION)


def test_a_sweep_has_one_outlet(fits, own_cases):
    for outlet in (SUCTION, None):
        sweep(own_cases, None, {"a": PHYSICS_CONFIG}, outlet=outlet, progress=False)
        assert fits.pop()[1] is outlet


def test_outlet_of_some_cases():
    other = Waveform(1e4)
    both = Windkessel([1.0, 2.0, 3.0], 5.0, distal_pressure=(MUSCLE, other, MUSCLE))
    found = both.select(np.array([2, 1]))
    assert found.resistance.tolist() == [3.0, 2.0]
    assert (found.distal_resistance, found.distal_pressure) == (5.0, (MUSCLE, other))


def test_ffr_of_another_patient_is_that_of_the_solver():
    """Trained with one resistance at maximal flow; predicted with others."""
    tube = Tube1D(n_times=32, steps=320)
    cases = synthetic(4, 4, hyperemia=4.0, n_points=41, tube=tube, cache=False, progress=False)
    model = fit_physics(cases, PHYSICS_CONFIG.replace(correction={"folds": 0}))
    strongest = cases[3::4]
    own = model.evaluate(strongest)["pressure_drop"].iloc[-1]
    muscle = Waveform(4e4, (-2.5e4,), (1.5e4,))
    for outlet in (
        Windkessel(3e3, 1.2e4, 3e-6, 2e4),
        CoronaryOutlet(6e3, 1e4, 4e3, 4e-7, 3e-6, muscle, 7e3),
    ):
        like = tube.solve_like(strongest, outlet)
        errors = model.evaluate(like, outlet).iloc[-1]
        assert errors["flow"] < 1e-3
        assert errors["pressure_drop"] < 1.2 * own
        found, trained = model.predict(like, outlet=outlet), model.predict(like)
        ffr, unchanged, expected = (of.indices()["ffr"] for of in (found, trained, like))
        np.testing.assert_allclose(ffr, expected, atol=0.015)
        assert np.abs(unchanged - expected).max() > 0.05
