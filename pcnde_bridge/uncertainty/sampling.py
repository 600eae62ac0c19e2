r"""Samples of predictions of the ``physics`` preset, with a calibrated spread.

Four random quantities make a sample of a prediction:

- losses, wall shear stress and correction of one of the fits that left out a fold of the
  training cases (whole geometries or whole waveforms), chosen at random, because the data do not
  determine them;
- a normal shift of the correction's logit, the same for a whole case, because cases differ
  in how much of the storage the averaged flow hides, and the inputs do not show it;
- a normal multiple of an error profile along the vessel, one for each variable, for the
  errors that remain where the correction has no effect; it grows with the amplitude of the
  inflow, as errors do; that of the pressure is the error at the
  outlet, the same at every point, so that it cancels in a pressure drop;
- normal multiples for the pressure losses ℓ(z, t) = p − p(L): one of ℓ itself, and three of the
  vessel's mean dynamic pressure, in the shares in which ℓ builds up along the vessel: constant in
  time, and with cos(2πt/T) and sin(2πt/T);
- the same multiples for the wall shear stress, of itself and of Poiseuille's for the mean inflow,
  which also grows with the amplitude.

The widths are calibrated on the cases that each fit left out
(:mod:`pcnde_bridge.uncertainty.calibration`): those of the losses on the drop across the stenosis,
those of the wall shear stress at all points, the others on flow, area and pressure, with the shift
that gives the narrowest intervals.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array, BoolArray, ComplexArray, IntArray
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import check_finite, check_shape, counted
from pcnde_bridge.config import ClosureConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.indices import poiseuille_wall_shear_stress, pressure_drop
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.data.stenosis import measuring_positions
from pcnde_bridge.data.variables import FIELDS, VARIABLES
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.protocol import Closures
from pcnde_bridge.engines.types import ModelInputs, Solution, solve_most
from pcnde_bridge.errors import PCNDEWarning, SolveError
from pcnde_bridge.uncertainty.calibration import (
    Calibration,
    amplitude,
    fit_loss_scales,
    fit_scales,
    relative_amplitude,
    shared_error,
)

_SHIFTS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)  # of a standard normal variable
_OUTER = _NODES != 0  # the middle one is the prediction without a shift
_TIMES = 25  # for the widths of the wall shear stress
_NEGLIGIBLE = 1e-12
_MOST_FAILED = 0.1  # of a case's samples
_MULTIPLES = 4  # of the losses, and of the wall shear stress
_NOISES = len(VARIABLES) + 2 * _MULTIPLES


@dataclass(frozen=True, eq=False, repr=False)
class Uncertainty(Displayed):
    """Distribution of the samples of a prediction.

    Attributes
    ----------
    members : array of shape (member, n)
        Parameters of losses, wall shear stress and correction, one after the other, with one row
        for each fit that left out a fold.
    shift : array of shape (1,)
        Standard deviation of the logit's shift.
    losses : array of shape (3,)
        Standard deviations of the losses: relative to them, then relative to the mean dynamic
        pressure, constant and varying in time.
    wall_shear_stress : array of shape (3,) or (0,)
        The same of the wall shear stress, relative to it, then to Poiseuille's; empty if the
        training cases have none.
    profile, scale, amplitude : arrays of shape (3, point), (3,) and (1,)
        Attributes of :class:`~pcnde_bridge.uncertainty.calibration.Calibration`.
    """

    members: Array
    shift: Array
    losses: Array
    wall_shear_stress: Array
    profile: Array
    scale: Array
    amplitude: Array

    def __iter__(self) -> Iterator[tuple[str, Array]]:
        return ((f.name, getattr(self, f.name)) for f in fields(self))

    @property
    def calibration(self) -> Calibration:
        """Profile, scale and amplitude."""
        return Calibration(self.profile, self.scale, self.amplitude)

    def check(self, width: int) -> None:
        """Check shapes and values.

        Parameters
        ----------
        width : int
            Number of parameters of a member.

        Raises
        ------
        InputError
            If the shapes do not belong together, or a value is not finite.
        """
        self.calibration.check()
        members = len(self.members), width
        stress = (3,) if self.wall_shear_stress.size else (0,)
        shapes = {"members": members, "shift": (1,), "losses": (3,), "wall_shear_stress": stress}
        for name, shape in shapes.items():
            check_shape(f"The uncertainty's {name}", getattr(self, name), shape)
            check_finite(f"The uncertainty's {name}", getattr(self, name))


class RandomNumbers(NamedTuple):
    """Random numbers of the samples; a case's numbers do not depend on the batch it is in.

    Attributes
    ----------
    member : array of int of shape (sample,)
        Index of the fit.
    shift : array of shape (sample, case)
        Shift of the correction's logit.
    noise : array of shape (11, sample, case)
        Multiples of the error profiles of flow, area and pressure; of the losses, and of
        the mean dynamic pressure, constant, with cosine and with sine; the same four of the
        wall shear stress.
    """

    member: IntArray
    shift: Array
    noise: Array

    @classmethod
    def generate(
        cls, uncertainty: Uncertainty, samples: int, count: int, rng: np.random.Generator
    ) -> RandomNumbers:
        """Generate the numbers for ``samples`` samples of ``count`` cases."""
        member = rng.integers(len(uncertainty.members), size=samples)
        shift = uncertainty.shift[0] * rng.standard_normal((samples, count))
        return cls(member, shift, rng.standard_normal((_NOISES, samples, count)))

    def select(self, cases: slice) -> RandomNumbers:
        """Return the numbers of a range of cases."""
        return RandomNumbers(self.member, self.shift[:, cases], self.noise[:, :, cases])


class SampledModel(NamedTuple):
    """Closures whose predictions are sampled.

    Attributes
    ----------
    closures : Closures
        Engine of the predictions.
    parameters : ClosureParameters
        Closures fitted to all training cases.
    config : ClosureConfig
        Settings of the model.
    """

    closures: Closures
    parameters: ClosureParameters
    config: ClosureConfig

    def predict(
        self, member: Array, shift: Array, inputs: ModelInputs, outlet: ComplexArray | None = None
    ) -> dict[str, Array]:
        """Predict all variables (sample, case, time, z) with shifts (sample, case)."""
        given = member, shift, inputs, outlet
        return self._predict_rows(np.arange(shift.size), *given)

    def predict_most(
        self, member: Array, shift: Array, inputs: ModelInputs, outlet: ComplexArray | None = None
    ) -> tuple[dict[str, Array], BoolArray]:
        """Predict as :meth:`predict`; also return which samples failed, (sample, case).

        The values of these are those of another one; there are none if all failed.
        """
        given = member, shift, inputs, outlet
        try:
            found, failed = solve_most(lambda rows: self._predict_rows(rows, *given), shift.size)
        except SolveError as error:
            if not error.cases:
                raise
            return {}, np.ones(shift.shape, dtype=bool)
        return found, failed.reshape(shift.shape)

    def _predict_rows(
        self,
        rows: IntArray,
        member: Array,
        shift: Array,
        inputs: ModelInputs,
        outlet: ComplexArray | None,
    ) -> dict[str, Array]:
        """Predict the pairs of sample and case with these indices."""
        parameters, (inflow, area, grid) = self.parameters.with_member(member), inputs
        case = rows % shift.shape[1]
        repeated = ModelInputs(inflow[case], area[case], grid)
        at_end = None if outlet is None else outlet[case]
        shifts = shift.ravel()[rows]
        found = self.closures.predict(parameters, shifts, repeated, self.config, at_end)
        shape = *shift.shape, grid.time.size, grid.z.size
        return {name: getattr(found, name).reshape(shape) for name in FIELDS}


def calibrate(
    model: SampledModel,
    members: Sequence[Array],
    left_out: Sequence[Positions],
    cases: Cases,
    outlet: ComplexArray | None = None,
) -> Uncertainty:
    """Find profile, shift and scale on the cases that each member's fit left out.

    The spread that a normal shift gives is computed by Gauss–Hermite quadrature.

    Parameters
    ----------
    model : SampledModel
        Model that was fitted to all cases.
    members : sequence of arrays of shape (n,)
        Losses, wall shear stress and correction of each fit that left out a fold.
    left_out : sequence of arrays of int
        Positions of the cases that each of these fits left out.
    cases : Cases
        Training cases.
    outlet : array of shape (case, 2, harmonic), optional
        Outlet of all cases, see :meth:`~pcnde_bridge.engines.protocol.Closures.flow`.
    """
    reference = amplitude(cases.inflow)
    errors: list[Array] = []
    drops: list[Array] = []  # for each fold, errors of the drop and their two scales
    shears: list[Array] = []  # for each fold, the same of the wall shear stress at all points
    spreads: list[list[list[Array]]] = []  # for each fold, shift and variable
    for member, fold in zip(members, left_out, strict=True):
        truth = cases.select(fold)
        inputs = ModelInputs(truth.inflow, truth.area_undeformed, truth.grid)
        at_end = None if outlet is None else outlet[fold]
        plain = model.predict(member, np.zeros((1, len(truth))), inputs, at_end)
        errors.append(np.abs([plain[name][0] - getattr(truth, name) for name in VARIABLES]))
        scales = _loss_scales(plain["pressure"][0], inputs, model.config)
        ends = truth.z, *measuring_positions(truth.z, truth.area_undeformed)
        error = plain["pressure"][0] - truth.pressure
        drops.append(np.stack([pressure_drop(values, *ends) for values in (error, *scales)]))
        if truth.wall_shear_stress is not None:
            shear = plain["wall_shear_stress"][0]
            scale = _poiseuille(inputs, reference, model.config)
            parts = shear - np.abs(truth.wall_shear_stress), shear, scale
            few = [np.moveaxis(part[:, :: -(-shear.shape[1] // _TIMES)], 1, -1) for part in parts]
            shears.append(np.stack([part.reshape(-1, part.shape[-1]) for part in few]))
        spreads.append([[np.zeros_like(values) for values in _with_outlet_pressure(errors[-1])]])
        for shift in _SHIFTS[1:]:
            shifts = np.tile(shift * _NODES[_OUTER, None], len(truth))
            samples = model.predict(member, shifts, inputs, at_end)
            outer, middle = (
                _with_outlet_pressure(of[name] for name in VARIABLES) for of in (samples, plain)
            )
            spreads[-1].append([_normal_spread(a - b) for a, b in zip(outer, middle, strict=True)])
    error = np.concatenate(errors, axis=1)
    relative = relative_amplitude(cases.inflow[np.concatenate(left_out)], reference)
    profile, size = shared_error(error, relative), error.mean(axis=(1, 2, 3)) + _NEGLIGIBLE
    profile[-1] = profile[-1, -1]
    known = _with_outlet_pressure(profile), _with_outlet_pressure(error)
    found = []
    for of_folds in zip(*spreads, strict=True):
        spread = [np.concatenate(values) for values in zip(*of_folds, strict=True)]
        found.append(fit_scales(*known, spread, relative))
    # The intervals are compared by their mean widths in terms of the errors.
    best = int(np.argmin([np.sum(mean / size) for _, mean in found]))
    scale = found[best][0]
    losses = fit_loss_scales(*np.concatenate(drops, axis=1)) / (scale[-1] or 1.0)
    shear = fit_loss_scales(*np.concatenate(shears, axis=1)) if shears else np.empty(0)
    widths = np.array([_SHIFTS[best]]), losses, shear
    return Uncertainty(np.array(members), *widths, profile, scale, reference)


def _with_outlet_pressure(values: Iterable[Array]) -> list[Array]:
    """Return flow, area and the pressure at the outlet; the drop has widths of its own."""
    flow, area, pressure = values
    return [flow, area, pressure[..., -1:]]


def _normal_spread(change: Array) -> Array:
    """Return the standard deviation of changes at the outer nodes of a normal variable."""
    weights = _WEIGHTS[_OUTER] / _WEIGHTS.sum()
    mean = np.tensordot(weights, change, axes=1)
    return np.sqrt(np.tensordot(weights, change**2, axes=1) - mean**2)


def _replace(samples: Mapping[str, Array], failed: BoolArray) -> None:
    """Put other samples of the same case in place of those that failed, (sample, case).

    Raises
    ------
    SolveError
        If more than a tenth of a case's samples failed.
    """
    counts, total = failed.sum(axis=0), len(failed)
    case = int(counts.argmax())
    which = f"{counts[case]} of {total} samples of case {case}"
    if counts[case] > _MOST_FAILED * total:
        raise SolveError(
            f"The prediction has been computed, but {which} do not settle: the inputs are too far "
            "from the training data for intervals. Predict without samples."
        )
    warnings.warn(
        f"{which} do not settle, and others take their place: its intervals may be too narrow. "
        f"This occurs in {np.count_nonzero(counts)} of {counted(counts.size, 'case')}.",
        PCNDEWarning,
        stacklevel=2,
    )
    for case in np.flatnonzero(counts).tolist():
        lost, settled = np.flatnonzero(failed[:, case]), np.flatnonzero(~failed[:, case])
        for values in samples.values():
            values[lost, case] = values[np.resize(settled, lost.size), case]


def _loss_scales(
    pressure: Array, inputs: ModelInputs, config: ClosureConfig
) -> tuple[Array, Array]:
    """Return the losses, and the mean dynamic pressure in their shares, (case, time, z)."""
    losses = pressure - pressure[..., -1:]
    built_up = np.sqrt((losses**2).mean(axis=1, keepdims=True))
    largest = built_up.max(axis=-1, keepdims=True) + _NEGLIGIBLE
    velocity = inputs.inflow / inputs.area_undeformed[:, :1]
    dynamic = config.physics.density / 2 * (velocity**2).mean(axis=1)
    constant = np.broadcast_to(dynamic[:, None, None] * built_up / largest, losses.shape)
    return losses, constant


def _poiseuille(inputs: ModelInputs, reference: Array, config: ClosureConfig) -> Array:
    """Return Poiseuille's wall shear stress of the mean inflow, times its relative amplitude."""
    flow = np.abs(inputs.inflow.mean(axis=1)) * relative_amplitude(inputs.inflow, reference)
    area = inputs.area_undeformed[:, None]
    stress = poiseuille_wall_shear_stress(flow[:, None, None], area, config.physics.viscosity)
    return np.broadcast_to(stress, (len(stress), inputs.grid.time.size, inputs.grid.z.size))


def _vary(scales: Array, noise: Array, values: Array, constant: Array, grid: Grid) -> Array:
    """Return random errors (sample, case, time, z) with standard deviations of three parts.

    These are relative to ``values``, and relative to ``constant``, constant and varying in time.
    """
    phase = 2 * np.pi * grid.time[:, None] / grid.period
    relative, steady, varying = scales
    multiples = noise[..., None, None]
    wave = multiples[2] * np.cos(phase) + multiples[3] * np.sin(phase)
    errors: Array = relative * multiples[0] * values
    errors += (steady * multiples[1] + varying * wave) * constant
    return errors


def sample(
    model: SampledModel,
    uncertainty: Uncertainty,
    mean: Solution,
    inputs: ModelInputs,
    numbers: RandomNumbers,
    outlet: ComplexArray | None = None,
) -> dict[str, Array]:
    """Compute samples of predictions.

    Parameters
    ----------
    model : SampledModel
        Model of the predictions.
    uncertainty : Uncertainty
        Distribution of the samples.
    mean : Solution
        Prediction without random numbers, shape (case, time, z).
    inputs : ModelInputs
        Inflow, vessels and grid.
    numbers : RandomNumbers
        Random numbers of all samples.
    outlet : array of shape (case, 2, harmonic), optional
        See :func:`calibrate`.

    Returns
    -------
    dict of arrays of shape (sample, case, time, z)
        Flow, area and pressure, and the wall shear stress where its error is known.

    Raises
    ------
    SolveError
        If more than a tenth of a case's samples cannot be computed.

    Warns
    -----
    PCNDEWarning
        If fewer cannot be computed; others of the same case take their place.
    """
    names = FIELDS if uncertainty.wall_shear_stress.size else VARIABLES
    found = {name: np.empty((len(numbers.member), *mean.flow.shape)) for name in names}
    failed = np.zeros(numbers.shift.shape, dtype=bool)
    largest = int(np.bincount(numbers.member).max(initial=0))
    for number, member in enumerate(uncertainty.members):
        rows = np.flatnonzero(numbers.member == number)
        if rows.size == 0:
            continue
        # Repeated up to the same number for each member, so that one shape is compiled.
        rows = np.resize(rows, largest)
        samples, failed[rows] = model.predict_most(member, numbers.shift[rows], inputs, outlet)
        for name in names if samples else ():
            found[name][rows] = samples[name]
    if failed.any():
        _replace(found, failed)
    calibration, z = uncertainty.calibration, inputs.grid.z
    of_losses, of_stress = np.split(numbers.noise[len(VARIABLES) :], 2)
    for name, noise, scale in zip(VARIABLES, numbers.noise, calibration.scale, strict=False):
        center = getattr(mean, name)
        found[name] -= center
        found[name] += noise[:, :, None, None] * calibration.shared_error(name, inputs.inflow, z)
        if name == "pressure":
            parts = _loss_scales(center, inputs, model.config)
            found[name] += _vary(uncertainty.losses, of_losses, *parts, inputs.grid)
        found[name] *= scale
        found[name] += center
    if (name := "wall_shear_stress") in found:
        parts = found[name], _poiseuille(inputs, uncertainty.amplitude, model.config)
        varied = _vary(uncertainty.wall_shear_stress, of_stress, *parts, inputs.grid)
        found[name] = np.abs(found[name] + varied)  # it is a magnitude
    return found
