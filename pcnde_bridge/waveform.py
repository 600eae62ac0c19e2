"""Inlet flow waveforms, and the family that one waveform spans.

A waveform is a truncated Fourier series of period T (the paper's section 2.5),

    Q_in(t) = A₀ + Σₙ (Aₙ·cos(2πnt/T) + Bₙ·sin(2πnt/T)),   n = 1 … N.

The paper makes further waveforms with a factor c, printed before Aₙ alone; its
published data scale Aₙ and Bₙ together.  Both forms are here, see
:meth:`Waveform.scaled`.  Units are CGS: mL/s, s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcnde_bridge.errors import InputError

Array = npt.NDArray[np.float64]
Form = Literal["oscillation", "printed"]

DATA_FACTORS = (-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.375, 1.5, 1.75)
"""Factors of the oscillation measured on the paper's data, waveforms 0 … 9."""

# Our own drawing of a left coronary waveform, mL/s at 20 instants of a cycle of
# 1 s from the onset of systole: low while the heart muscle squeezes the vessels
# (first row), highest early in diastole (second row).  Nine harmonics, like the
# paper's data.
# fmt: off
_CORONARY = (
    0.95, 0.80, 0.72, 0.85, 1.02, 1.05, 0.98, 1.05, 1.42, 1.78,
    1.90, 1.86, 1.76, 1.66, 1.56, 1.46, 1.36, 1.26, 1.16, 1.06,
)
# fmt: on
_CORONARY_TERMS = 9


@dataclass(frozen=True)
class Waveform:
    """Periodic flow at the inlet, as Fourier coefficients.

    Attributes
    ----------
    mean : float
        A₀, mL/s.
    cosine, sine : tuple of float
        A₁ … A_N and B₁ … B_N, mL/s; of equal length, which may be 0 (steady flow).
    period : float
        T, s.

    Raises
    ------
    InputError
        If a coefficient is not finite, the lengths differ, or the period is not
        positive.

    Examples
    --------
    >>> from pcnde_bridge.waveform import Waveform
    >>> steady = Waveform(mean=1.5)
    >>> float(steady.flow(0.25))
    1.5
    """

    mean: float
    cosine: tuple[float, ...] = ()
    sine: tuple[float, ...] = ()
    period: float = 1.0

    def __post_init__(self) -> None:
        for name in ("cosine", "sine"):
            object.__setattr__(self, name, tuple(float(v) for v in getattr(self, name)))
        if not math.isfinite(self.mean):
            raise InputError(f"Waveform.mean must be finite (mL/s), got {self.mean!r}.")
        for name in ("cosine", "sine"):
            for i, value in enumerate(getattr(self, name)):
                if not math.isfinite(value):
                    raise InputError(f"Waveform.{name}[{i}] must be finite (mL/s), got {value!r}.")
        if len(self.cosine) != len(self.sine):
            raise InputError(
                f"Waveform.cosine has {len(self.cosine)} terms and sine {len(self.sine)}; "
                "give both the same number."
            )
        if not (math.isfinite(self.period) and self.period > 0.0):
            raise InputError(f"Waveform.period must be positive (s), got {self.period!r}.")

    @property
    def n_terms(self) -> int:
        """N, number of harmonics."""
        return len(self.cosine)

    def flow(self, time: npt.ArrayLike) -> Array:
        """Flow Q_in(t), mL/s.

        Parameters
        ----------
        time : array_like of float, shape (...)
            s; periodic, so any value will do.
        """
        time = np.asarray(time, dtype=np.float64)
        angle = 2.0 * np.pi / self.period * time[..., None] * np.arange(1, self.n_terms + 1)
        flow: Array = self.mean + np.cos(angle) @ self._cosine + np.sin(angle) @ self._sine
        return flow

    @property
    def _cosine(self) -> Array:
        return np.array(self.cosine)

    @property
    def _sine(self) -> Array:
        return np.array(self.sine)

    def samples(self, n_times: int = 100) -> Array:
        """Flow at n_times equal steps of one cycle from t = 0, mL/s, shape (n_times,)."""
        return self.flow(np.arange(n_times) * (self.period / n_times))

    def scaled(self, factor: float, form: Form = "oscillation") -> Waveform:
        """Member of the waveform's family for the factor c; the mean is kept.

        Parameters
        ----------
        factor : float
            c; 1 gives the waveform itself.
        form : {'oscillation', 'printed'}
            ``'oscillation'`` multiplies Aₙ and Bₙ, as in the paper's published
            data, so that 0 is steady flow and −1 the mirror image.  ``'printed'``
            multiplies Aₙ alone, as in the paper's equation.

        Raises
        ------
        InputError
            If the factor is not finite or the form unknown.
        """
        if not math.isfinite(factor):
            raise InputError(f"The waveform's factor must be finite, got {factor!r}.")
        if form not in ("oscillation", "printed"):
            raise InputError(f"form must be 'oscillation' or 'printed', got {form!r}.")
        sine = self._sine if form == "printed" else factor * self._sine
        return Waveform(self.mean, tuple(factor * self._cosine), tuple(sine), self.period)

    def family(
        self, factors: Sequence[float] = DATA_FACTORS, form: Form = "oscillation"
    ) -> tuple[Waveform, ...]:
        """One waveform per factor, see :meth:`scaled`; the default is the data's family."""
        return tuple(self.scaled(factor, form) for factor in factors)

    @classmethod
    def from_samples(
        cls,
        flow: npt.ArrayLike,
        time: npt.ArrayLike | None = None,
        period: float = 1.0,
        n_terms: int | None = 60,
    ) -> Waveform:
        """Fourier series of a measured waveform.

        Parameters
        ----------
        flow : array_like of float, shape (n,)
            One cycle, mL/s, at least 3 samples.
        time : array_like of float, shape (n,), optional
            Instants, s, strictly increasing, covering at most one period; the end
            of the cycle may be repeated.  Equal steps of period / n by default.
            Between unequal steps the flow is taken as linear.
        period : float
            T, s.
        n_terms : int or None
            Largest number of harmonics; 60 is the paper's.  Samples in equal steps
            hold no more than n/2; with None all of them are taken, and the series
            passes through every sample.

        Raises
        ------
        InputError
            If a value is not finite, shapes differ, or the instants do not
            increase or do not fit into the period.
        """
        samples = _finite("flow", flow)
        if not (math.isfinite(period) and period > 0.0):
            raise InputError(f"period must be positive (s), got {period!r}.")
        if n_terms is not None and n_terms < 0:
            raise InputError(f"n_terms must not be negative, got {n_terms!r}.")
        first = 0.0
        if time is not None:
            samples, first = _equal_steps(_finite("time", time), samples, period)
        if len(samples) < 3:
            raise InputError(f"A waveform needs at least 3 samples, got {len(samples)}.")
        spectrum = np.fft.rfft(samples) / len(samples)
        spectrum[1:] *= 2.0
        if len(samples) % 2 == 0:
            spectrum[-1] /= 2.0  # the highest harmonic of an even number stands alone
        # The series counts time from 0, the samples from the first of them.
        spectrum *= np.exp(-2j * np.pi * np.arange(len(spectrum)) * (first / period))
        spectrum = spectrum[: None if n_terms is None else n_terms + 1]
        return cls(
            float(spectrum[0].real),
            tuple(spectrum[1:].real.tolist()),
            tuple((-spectrum[1:].imag).tolist()),
            float(period),
        )


def coronary(period: float = 1.0) -> Waveform:
    """Left coronary waveform, drawn for this package: mean 1.28 mL/s, peak in diastole.

    Parameters
    ----------
    period : float
        T, s.
    """
    return Waveform.from_samples(_CORONARY, period=period, n_terms=_CORONARY_TERMS)


def _finite(name: str, values: npt.ArrayLike) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be a sequence of numbers: {error}.") from error
    if array.ndim != 1:
        raise InputError(f"{name} must have one dimension, got shape {array.shape}.")
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise InputError(f"{name}[{bad[0]}] is {array[bad[0]]}; all values must be finite.")
    return array


def _equal_steps(time: Array, flow: Array, period: float) -> tuple[Array, float]:
    """Flow at equal steps of one cycle, and the first instant.

    Samples in other steps are taken as linear between them, from t = 0.
    """
    if time.shape != flow.shape:
        raise InputError(f"time has {len(time)} values and flow {len(flow)}; give as many of both.")
    if len(time) < 3:
        raise InputError(f"A waveform needs at least 3 samples, got {len(time)}.")
    steps = np.diff(time)
    if (steps <= 0.0).any():
        i = int(np.argmax(steps <= 0.0)) + 1
        raise InputError(f"time[{i}] = {time[i]:g} s is not later than the instant before it.")
    span = time[-1] - time[0]
    if span > period * (1.0 + 1e-9):
        raise InputError(
            f"The samples span {span:g} s, longer than the period of {period:g} s; "
            "give one cycle, or its right period."
        )
    if math.isclose(span, period, rel_tol=1e-9):  # the end of the cycle repeats its start
        time, flow = time[:-1], flow[:-1]
    n = len(time)
    if np.allclose(np.diff(time), period / n, rtol=1e-6, atol=0.0):
        return flow, float(time[0])
    # Finer than the shortest step, so that no sample is lost.
    n_fine = min(max(n, math.ceil(2.0 * period / np.diff(time).min())), 100_000)
    instants = np.arange(n_fine) * (period / n_fine)
    return np.asarray(np.interp(instants, time, flow, period=period), dtype=np.float64), 0.0
