"""Inlet flow waveforms, and the family of scaled waveforms of each.

A waveform is a truncated Fourier series of period T (the paper's section 2.5),

    Q_in(t) = A₀ + Σₙ (Aₙ·cos(2πnt/T) + Bₙ·sin(2πnt/T)),   n = 1 … N.

The paper scales waveforms by a factor c, printed before Aₙ alone; its published
data scale Aₙ and Bₙ together, as :meth:`Waveform.scaled` does.  Units are CGS: mL/s, s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge._utils.validation import (
    check_fields,
    check_increasing,
    counted,
    finite,
    finite_vector,
    positive,
    whole,
)
from pcnde_bridge.errors import InputError

DATA_FACTORS = (-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.375, 1.5, 1.75)
"""Factors of the oscillation measured on the paper's data, waveforms 0 … 9."""

# A left coronary waveform drawn for this package, mL/s at 20 time points of a cycle
# of 1 s from the onset of systole: low while the heart muscle compresses the vessels
# (first row), highest early in diastole (second row).  Nine harmonics, like the
# paper's data.
# fmt: off
_CORONARY = (
    0.95, 0.80, 0.72, 0.85, 1.02, 1.05, 0.98, 1.05, 1.42, 1.78,
    1.90, 1.86, 1.76, 1.66, 1.56, 1.46, 1.36, 1.26, 1.16, 1.06,
)
# fmt: on
_CORONARY_TERMS = 9


@dataclass(frozen=True, repr=False)
class Waveform(Displayed):
    """Periodic flow at the inlet, given by its Fourier coefficients.

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
        If a coefficient is not a finite number, the lengths differ, or the period is
        not positive.

    Examples
    --------
    >>> from pcnde_bridge.hemodynamics.waveform import Waveform
    >>> steady = Waveform(mean=1.5)
    >>> float(steady.flow(0.25))
    1.5
    """

    mean: float
    cosine: tuple[float, ...] = ()
    sine: tuple[float, ...] = ()
    period: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self, finite, mean="mL/s")
        check_fields(self, positive, period="s")
        for name in ("cosine", "sine"):
            values = finite_vector(f"Waveform.{name}", getattr(self, name))
            object.__setattr__(self, name, tuple(values.tolist()))
        n_cosine, n_sine = len(self.cosine), len(self.sine)
        if n_cosine != n_sine:
            raise InputError(
                f"cosine has {n_cosine} terms and sine {n_sine}; give as many of both."
            )

    def _facts(self) -> list[str]:
        mean = f"mean {self.mean:.4g} mL/s"
        return [mean, counted(self.n_terms, "harmonic"), f"period {self.period:g} s"]

    @property
    def n_terms(self) -> int:
        """Number of harmonics N."""
        return len(self.cosine)

    def flow(self, time: npt.ArrayLike) -> Array:
        """Return the flow Q_in(t), mL/s, shape (...).

        Parameters
        ----------
        time : array_like of float, shape (...)
            Any times, s; the flow is periodic.
        """
        time = np.asarray(time, dtype=np.float64)
        angle = 2.0 * np.pi / self.period * time[..., None] * np.arange(1, self.n_terms + 1)
        return np.asarray(self.mean + np.cos(angle) @ self.cosine + np.sin(angle) @ self.sine)

    def check_period(self, name: str, period: float) -> None:
        """Raise if the period is not the one of the inlet of case 0, s.

        Raises
        ------
        InputError
            If it is another; the message calls the waveform by the name given.
        """
        if not math.isclose(self.period, period, rel_tol=1e-12):
            raise InputError(
                f"{name} has a period of {self.period:g} s, waveforms[0] of {period:g} s; "
                "solve different periods in different batches."
            )

    def samples(self, n_times: int = 100) -> Array:
        """Return the flow at n_times equal steps of a cycle from t = 0, mL/s, shape (n_times,)."""
        n_times = whole("n_times", n_times, 1)
        return self.flow(np.arange(n_times) * (self.period / n_times))

    def scaled(self, factor: float) -> Waveform:
        """Scale the oscillation by the factor c; the mean stays the same.

        Aₙ and Bₙ are multiplied, as in the paper's published data, so that 0 is steady flow
        and −1 the mirror image.

        Parameters
        ----------
        factor : float
            c; 1 gives the waveform itself.

        Raises
        ------
        InputError
            If the factor is not finite.
        """
        factor = finite("The waveform's factor", factor)
        cosine, sine = (tuple(factor * v for v in values) for values in (self.cosine, self.sine))
        return Waveform(self.mean, cosine, sine, self.period)

    def family(self, factors: Sequence[float] = DATA_FACTORS) -> tuple[Waveform, ...]:
        """Return one waveform per factor, see :meth:`scaled`; by default the paper's family."""
        return tuple(self.scaled(factor) for factor in factors)

    @classmethod
    def from_spectrum(
        cls, mean: float, harmonics: npt.NDArray[np.complex128], period: float
    ) -> Waveform:
        """Create a waveform from A₀, mL/s, Aₙ − i·Bₙ of shape (N,), mL/s, and the period, s."""
        cosine, sine = harmonics.real.tolist(), (-harmonics.imag).tolist()
        return cls(mean, tuple(cosine), tuple(sine), period)

    @classmethod
    def from_samples(
        cls,
        flow: npt.ArrayLike,
        time: npt.ArrayLike | None = None,
        period: float = 1.0,
        n_terms: int | None = 60,
    ) -> Waveform:
        """Create the Fourier series of a measured waveform.

        Parameters
        ----------
        flow : array_like of float, shape (n,)
            One cycle, mL/s, at least 3 samples.
        time : array_like of float, shape (n,), optional
            Time points, s, strictly increasing, covering at most one period; the end
            of the cycle may be repeated.  Equal steps of period / n by default.
            Between samples in unequal steps the flow is linear, and the series is
            that of these lines.
        period : float
            T, s.
        n_terms : int or None
            Largest number of harmonics; 60 is the paper's.  Samples in equal steps
            have no more than n/2; with None all of them are used, and the series
            passes through every sample.  For unequal
            steps, None uses period / shortest step harmonics, at most 1000.

        Raises
        ------
        InputError
            If a value is not a finite number, shapes differ, or the time points do not
            increase or span more than the period.
        """
        samples = finite_vector("flow", flow)
        period = positive("period", period, "s")
        n_terms = None if n_terms is None else whole("n_terms", n_terms)
        first, steps = 0.0, None
        if time is not None:
            samples, first, steps = _one_cycle(finite_vector("time", time), samples, period)
        if len(samples) < 3:
            raise InputError(f"A waveform needs at least 3 samples, got {len(samples)}.")
        if steps is None:
            spectrum = _spectrum_of_equal_steps(samples)[: None if n_terms is None else n_terms + 1]
        else:
            if n_terms is None:
                n_terms = min(math.ceil(period / steps.min()), 1000)
            spectrum = _spectrum_of_lines(samples, steps, n_terms)
        # The time of the series starts at 0, that of the samples at the first of them.
        spectrum *= np.exp(-2j * np.pi * np.arange(len(spectrum)) * (first / period))
        return cls.from_spectrum(float(spectrum[0].real), spectrum[1:], period)


def coronary(period: float = 1.0) -> Waveform:
    """Return a left coronary waveform: mean 1.28 mL/s, peak in diastole.

    Parameters
    ----------
    period : float
        T, s.
    """
    return Waveform.from_samples(_CORONARY, period=period, n_terms=_CORONARY_TERMS)


def _one_cycle(time: Array, flow: Array, period: float) -> tuple[Array, float, Array | None]:
    """Flow without a repeated end, the first time point, and the steps unless they are equal."""
    if time.shape != flow.shape:
        raise InputError(f"time has {len(time)} values and flow {len(flow)}; give as many of both.")
    if len(time) < 3:
        raise InputError(f"A waveform needs at least 3 samples, got {len(time)}.")
    check_increasing("time", time, "s")
    span = time[-1] - time[0]
    if span > period * (1.0 + 1e-9):
        raise InputError(
            f"The samples span {span:g} s, longer than the period, {period:g} s: "
            "correct the period, or give the time in s."
        )
    if math.isclose(span, period, rel_tol=1e-9):  # the end of the cycle repeats its start
        time, flow = time[:-1], flow[:-1]
    first = float(time[0])
    if np.allclose(np.diff(time), period / len(time), rtol=1e-6, atol=0.0):
        return flow, first, None
    return flow, first, np.diff(time, append=first + period)


def _spectrum_of_equal_steps(flow: Array) -> npt.NDArray[np.complex128]:
    """Aₙ − i·Bₙ, n = 0 … n/2, of the series through samples in equal steps from t = 0."""
    spectrum = np.fft.rfft(flow) / len(flow)
    spectrum[1:] *= 2.0
    if len(flow) % 2 == 0:
        spectrum[-1] /= 2.0  # the highest harmonic of an even number has no mirror image
    return spectrum


def _spectrum_of_lines(flow: Array, steps: Array, n_terms: int) -> npt.NDArray[np.complex128]:
    """Aₙ − i·Bₙ, n = 0 … n_terms, of the lines that join samples in these steps from t = 0.

    Integration by parts replaces each line by its slope, a box function.
    """
    period = steps.sum()
    rise = np.roll(flow, -1) - flow
    middle = (np.cumsum(steps) - steps / 2) / period
    n = np.arange(1, n_terms + 1)[:, None]
    boxes = np.sinc(n * steps / period) * np.exp(-2j * np.pi * n * middle)
    mean = (flow + rise / 2) @ steps / period
    return np.append(mean, boxes @ rise / (1j * np.pi * n[:, 0]))
