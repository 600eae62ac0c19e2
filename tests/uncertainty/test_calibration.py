"""Width of intervals, for constructed predictions."""

from __future__ import annotations

from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import CONFIG, CORRECTED, made_by_the_closures

from pcnde_bridge import Cases, InputError, UnitsWarning
from pcnde_bridge.config import PHYSICS
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.splits import neighboring_folds
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.types import ModelInputs, Solution
from pcnde_bridge.uncertainty.calibration import (
    Calibration,
    amplitude,
    fit_loss_scales,
    fit_scales,
    relative_amplitude,
    shared_error,
)
from pcnde_bridge.uncertainty.sampling import (
    RandomNumbers,
    SampledModel,
    Uncertainty,
    calibrate,
    sample,
)

GRID = Grid(np.arange(4) / 4, np.linspace(0, 4, 6), 1.0)
UNITS = np.array([1e-3, 1e-4, 10.0])  # of the errors of flow, area and pressure
# Nothing at the inlet, where the flow is given; the pressure is off by the same everywhere.
ALONG = np.array([[0.0, 1.0, 2.0, 4.0, 2.0, 1.0]] * 2 + [[1.0] * 6])
FACTOR = 1 / NormalDist().inv_cdf(0.95)
PARAMETERS = ClosureParameters(np.ones(4), np.ones(10), np.ones(5), np.array([1000.0]))


def truth(inflow):
    flow = np.repeat(inflow[:, :, None], 6, axis=2)
    return Solution(flow, 0.1 + 0.01 * flow, 1e5 * flow)


class ByHand:
    """Errs by amount·(the correction's number) + response·shift, with the case in the inflow."""

    def __init__(self, amount, response):
        self.amount, self.response = np.broadcast_arrays(amount, response)
        self.shifts = []

    def predict(self, parameters, shift, inputs, config, outlet=None):
        self.shifts.append(shift)
        inflow = inputs.inflow
        case = np.rint(inflow[:, 0]).astype(int) - 1
        error = self.amount[case] * parameters.correction[0] + self.response[case] * shift
        return Solution(
            *(
                values + unit * np.multiply.outer(error, np.ones((4, 1)) * along)
                for values, unit, along in zip(truth(inflow)[:3], UNITS, ALONG, strict=True)
            ),
            20.0 * truth(inflow).flow,
        )


def member(correction):
    """Parameters of a member that differs in its correction."""
    return PARAMETERS.replace(correction=np.array([correction])).refitted


def inflow_of(count):
    return np.repeat(np.arange(1.0, count + 1)[:, None], 4, axis=1)


@pytest.fixture
def ten_cases():
    inflow = inflow_of(10)
    fields = *truth(inflow)[:3], np.full((10, 6), 0.1), GRID.time, GRID.z
    with pytest.warns(UnitsWarning):
        return Cases(*fields, period=1.0, check=False)


# Five cases are off by a half, three by one, two by ten, in places where ALONG is one.
AMOUNT = 0.5, 10.0, 0.5, 1.0, 1.0, 0.5, 0.5, 10.0, 1.0, 0.5


@pytest.mark.parametrize(
    ("responding", "shift", "factor"),
    [
        # A shift of one half widens what is off by ten to that, and nothing else.
        (np.equal(AMOUNT, 10.0), 0.5, 1.0),
        # What is off by ten needs a factor of ten, whatever the shift does elsewhere.
        (np.less(AMOUNT, 10.0), 0.0, 10.0),
    ],
)
def test_known_errors_give_profile_shift_and_scale(ten_cases, responding, shift, factor):
    members = [member(1.0), member(-1.0)]
    left_out = [np.arange(5), np.arange(5, 10)]
    model = SampledModel(ByHand(AMOUNT, 20.0 * responding), PARAMETERS, PHYSICS)
    found = calibrate(model, members, left_out, ten_cases)
    assert np.array_equal(found.members, members)
    assert found.shift == [shift]
    # 68 % of the cases are off by one at most.
    assert np.allclose(found.profile, UNITS[:, None] * ALONG, rtol=1e-7, atol=0)
    assert np.isfinite(found.losses).all()
    assert np.allclose(found.scale, factor * FACTOR, rtol=1e-7)


def drawn(
    members, shift, profile, scale, samples, amount=(1.0,), response=0.0, z=GRID.z, losses=(0, 0, 0)
):
    """Return samples minus the truth, in terms of UNITS, and their shifts."""
    engine, inflow = ByHand(amount, response), inflow_of(len(amount))
    uncertainty = Uncertainty(
        np.array([member(correction) for correction in members]),
        np.array([shift]),
        np.array(losses),
        np.empty(0),
        UNITS[:, None] * profile,
        np.array(scale),
        np.zeros(1),
    )
    mean, area = truth(inflow), np.full((len(amount), 6), 0.1)
    numbers = RandomNumbers.generate(uncertainty, samples, len(amount), np.random.default_rng(0))
    inputs = ModelInputs(inflow, area, Grid(GRID.time, z, 1.0))
    model = SampledModel(engine, PARAMETERS, PHYSICS)
    found = sample(model, uncertainty, mean, inputs, numbers)
    off = [(found[n] - getattr(mean, n)) / u for n, u in zip(VARIABLES, UNITS, strict=True)]
    return np.stack(off), np.concatenate(engine.shifts)


def test_samples_of_members_are_their_predictions():
    nothing = np.zeros((3, 2))
    off, _ = drawn([1.0, -2.0, 5.0], 0.0, nothing, [1.0, 2.0, 3.0], 30, amount=(1.0, 3.0))
    for one, scale, along in zip(off, (1.0, 2.0, 3.0), ALONG, strict=True):
        of_case = one[:, 0, 0, 1]
        assert sorted(set(np.rint(of_case))) == [-2 * scale, scale, 5 * scale]
        for case, amount in enumerate((1.0, 3.0)):
            member = np.rint(of_case / scale)[:, None, None]
            expected = scale * amount * member * along * np.ones((4, 1))
            assert np.allclose(one[:, case], expected, rtol=1e-6, atol=1e-6)


def test_samples_have_the_standard_deviation_of_the_profile():
    profile = np.array([[0.0, 1.0], [1.0, 3.0], [2.0, 0.0]])
    z = np.array([5.0, 6.0, 7.0, 7.5, 8.0, 9.0])  # anywhere: the profile reaches from end to end
    off, _ = drawn([0.0], 0.0, profile, [1.0, 0.5, 2.0], 4000, amount=(1.0, 1.0), z=z)
    place = (z - 5) / 4
    expected = np.array([place, 0.5 * (1 + 2 * place), 2 * (2 - 2 * place)])
    deviation = off.std(axis=1, ddof=1)
    assert np.allclose(deviation, expected[:, None, None], rtol=0.05, atol=1e-6)
    # One multiple for a whole case and variable, of its own.
    assert np.allclose(off, off[:, :, :, :1], rtol=1e-5, atol=1e-6)
    apart = np.corrcoef(np.concatenate([off[0, :, :, 0, 3], off[1, :, :, 0, 3]], axis=1).T)
    assert np.abs(apart - np.eye(4)).max() < 0.06


def test_samples_have_the_standard_deviation_of_the_shift():
    off, shifts = drawn([0.0], 0.7, np.zeros((3, 2)), np.ones(3), 4000, (1.0, 1.0), (1.0, 5.0))
    assert shifts.size == 8000
    shifts = shifts.reshape(4000, 2)
    assert np.allclose(shifts.std(axis=0), 0.7, rtol=0.05)
    assert abs(np.corrcoef(shifts.T)[0, 1]) < 0.06
    expected = np.multiply.outer(shifts * [1.0, 5.0], np.ones((4, 1)) * ALONG[:, None])
    expected = np.moveaxis(expected, 2, 0)
    assert np.allclose(off, expected, rtol=1e-5, atol=1e-6)


def test_errors_of_the_losses_do_not_cancel_in_a_drop():
    """The pressure falls in proportion to Q; the samples' drops vary as the widths say."""
    relative, constant, varying = widths = 0.1, 2.0, 3.0
    inflow, area = inflow_of(2), np.full((2, 6), 0.1)
    flow, fields, *_ = truth(inflow)
    below = np.array([5.0, 4.0, 4.0, 1.0, 1.0, 0.0])
    mean = Solution(flow, fields, 1e5 + 100.0 * flow * below, flow)
    engine = SimpleNamespace(predict=lambda *_: Solution(*(np.tile(a, (4000, 1, 1)) for a in mean)))
    profile = np.array([[0.0], [0.0], [50.0]]) * np.ones(6)
    uncertainty = Uncertainty(
        member(0.0)[None],
        np.zeros(1),
        np.array(widths),
        np.empty(0),
        profile,
        np.array([1.0, 1.0, 0.5]),
        np.zeros(1),
    )
    numbers = RandomNumbers.generate(uncertainty, 4000, 2, np.random.default_rng(1))
    model = SampledModel(engine, PARAMETERS, PHYSICS)
    inputs = ModelInputs(inflow, area, GRID)
    pressure = sample(model, uncertainty, mean, inputs, numbers)["pressure"]
    assert np.allclose(pressure[..., -1].std(axis=0), 0.5 * 50, rtol=0.05)
    drop = pressure[..., 1] - pressure[..., 4]
    dynamic = PHYSICS.physics.density / 2 * (inflow / 0.1) ** 2 * 0.6
    losses = 300.0 * inflow
    expected = 0.5 * np.sqrt((relative * losses) ** 2 + (constant**2 + varying**2) * dynamic**2)
    assert np.allclose(drop.std(axis=0), expected, rtol=0.05)
    of_means = 0.5 * np.hypot(relative * losses, constant * dynamic)[:, 0]
    assert np.allclose(drop.mean(axis=-1).std(axis=0), of_means, rtol=0.05)


def test_wall_shear_stress_varies_with_itself_and_with_poiseuilles():
    inflow, area = inflow_of(2), np.full((2, 6), 0.1)
    mean = Solution(*truth(inflow)[:3], 20.0 * truth(inflow).flow)
    widths = 0.1, 0.02, 0.03
    uncertainty = Uncertainty(
        member(1.0)[None],
        np.zeros(1),
        np.zeros(3),
        np.array(widths),
        np.zeros((3, 6)),
        np.ones(3),
        np.zeros(1),
    )
    numbers = RandomNumbers.generate(uncertainty, 4000, 2, np.random.default_rng(1))
    model = SampledModel(ByHand([0.0, 0.0], 0.0), PARAMETERS, PHYSICS)
    found = sample(model, uncertainty, mean, ModelInputs(inflow, area, GRID), numbers)
    stress = found["wall_shear_stress"]
    poiseuille = 4 * 0.04 * inflow[:, :, None] / (np.pi * (0.1 / np.pi) ** 1.5)
    expected = np.hypot(0.1 * mean.wall_shear_stress, np.hypot(0.02, 0.03) * poiseuille)
    assert np.allclose(stress.std(axis=0), expected, rtol=0.05)
    of_means = np.hypot(0.1 * mean.wall_shear_stress, 0.02 * poiseuille)[:, 0]
    assert np.allclose(stress.mean(axis=2).std(axis=0), of_means, rtol=0.05)


@pytest.mark.parametrize("known", [True, False])
def test_errors_of_the_wall_shear_stress_are_calibrated_where_it_is_known(ten_cases, known):
    """A stress that is 25 % too high at all points needs intervals of a quarter on each side."""
    stress = 16.0 * ten_cases.flow if known else None
    fields = {name: getattr(ten_cases, name) for name in ("flow", "area", "pressure")}
    grid = ten_cases.area_undeformed, ten_cases.time, ten_cases.z
    with pytest.warns(UnitsWarning):
        cases = Cases(*fields.values(), *grid, wall_shear_stress=stress, period=1.0, check=False)
    model = SampledModel(ByHand(AMOUNT, 0.0), PARAMETERS, PHYSICS)
    left_out = [np.arange(5), np.arange(5, 10)]
    members = [member(1.0), member(-1.0)]
    given = model, members, left_out, cases
    found = calibrate(*given).wall_shear_stress
    if not known:
        assert found.shape == (0,)
        return
    error, values = 4.0 * cases.inflow, 20.0 * cases.inflow
    poiseuille = 4 * 0.04 * cases.inflow / (np.pi * (0.1 / np.pi) ** 1.5)
    width = np.hypot(found[0] * values, np.hypot(*found[1:]) * poiseuille)
    assert np.quantile(error / width, 0.9) == pytest.approx(NormalDist().inv_cdf(0.95), rel=1e-6)


@pytest.mark.parametrize(("constant", "varying"), [(0.3, 0.4), (0.0, 0.5), (0.5, 0.0)])
def test_scales_of_normal_losses(constant, varying):
    rng = np.random.default_rng(2)
    phase = 2 * np.pi * np.arange(20) / 20
    losses = rng.uniform(1, 100, size=(2000, 1)) * (1 + 0.5 * np.cos(phase))
    noise = rng.standard_normal((4, 2000, 1))
    wave = noise[2] * np.cos(phase) + noise[3] * np.sin(phase)
    error = 0.02 * noise[0] * losses + 2.0 * (constant * noise[1] + varying * wave)
    found = fit_loss_scales(error, losses, np.full(losses.shape, 2.0))
    assert found == pytest.approx([0.02, constant, varying], rel=0.1, abs=0.1)


def test_factor_of_normal_errors():
    error = np.abs(np.random.default_rng(0).normal(scale=3.0, size=(3, 100, 10, 100)))
    spread = np.array([1.5, 3.0, 0.0])[:, None, None, None] * np.ones(error.shape)
    # Where the values are known, errors by round-off do not count.
    spread[0, :, :, :80] = 0
    found, width = fit_scales(np.zeros((3, 100)), error, spread, np.ones(100))
    assert found == pytest.approx([2, 1, 0], rel=0.02)
    assert width == pytest.approx([3 * 0.2, 3, 0], rel=0.02)


def test_shared_errors_grow_with_the_amplitude_of_the_inflow():
    wave = np.sqrt(2) * np.cos(2 * np.pi * np.arange(8) / 8)
    inflow = 1.3 + np.array([[0.1], [2.0], [4.0]]) * wave
    reference = amplitude(np.array([[2.0], [2.0]]) * wave)
    assert reference == pytest.approx([2.0])
    relative = relative_amplitude(inflow, reference)
    assert relative == pytest.approx([0.3, 1.0, 2.0])
    assert relative_amplitude(inflow, np.zeros(1)).tolist() == [1.0, 1.0, 1.0]
    error = relative[:, None, None] * np.ones((3, 3, 8, 6)) * UNITS[:, None, None, None]
    profile = shared_error(error, relative)
    assert profile == pytest.approx(np.repeat(UNITS[:, None], 6, axis=1))
    factor, _ = fit_scales(profile, error, np.zeros(error.shape), relative)
    assert factor == pytest.approx(np.full(3, FACTOR))
    calibration = Calibration(profile, factor, reference)
    found = calibration.standard_deviation("area", np.zeros((3, 8, 6)), inflow, GRID.z)
    expected = UNITS[1] * FACTOR * relative[:, None, None] * np.ones((3, 8, 6))
    assert found == pytest.approx(expected)


def test_calibration_of_another_shape_is_refused():
    for profile, scale, message in (
        (np.ones((2, 4)), np.ones(3), "do not belong together"),
        (np.ones((3, 0)), np.ones(3), "do not belong together"),
        (np.ones((3, 4)), np.ones(2), "do not belong together"),
        (np.ones((3, 4)), np.array([1.0, np.nan, 1.0]), "not finite"),
        (np.ones((3, 4)), np.array([1.0, -2.0, 1.0]), "negative"),
    ):
        with pytest.raises(InputError, match=message):
            Calibration(profile, scale, np.ones(1)).check()
    with pytest.raises(InputError, match="do not belong together"):
        Calibration(np.ones((3, 4)), np.ones(3), np.ones(2)).check()


def test_errors_of_the_losses_do_not_scale_the_outlets():
    """Only the drop is wrong where the losses are; the pressure at the outlet is almost exact."""
    cases, closures = made_by_the_closures(), select_engine("jax").closures
    wrong = CORRECTED.replace(losses=1.1 * CORRECTED.losses).refitted
    folds = neighboring_folds(cases, 2)
    model = SampledModel(closures, CORRECTED, CONFIG)
    assert calibrate(model, [wrong] * len(folds), folds, cases).scale[-1] < 3
