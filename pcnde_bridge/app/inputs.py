"""What a user of the page chooses: a vessel and a waveform, and how far they may go.

The controls reach somewhat beyond the training data, as far as the model knows these.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.errors import InputError, PCNDEError
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.synthetic import BLOCKAGES
from pcnde_bridge.hemodynamics.waveform import (
    DATA_FACTORS,
    Waveform,
    coronary,
)
from pcnde_bridge.io.input_tables import read_cycle
from pcnde_bridge.model.pcnde import PCNDE

_BEYOND = 0.25  # of the training range, on either side
_SHORTEST, _LONGEST = 0.2, 1.0  # stenoses, cm; 0.16 is what the 1D solver's grid resolves
_MARGIN = 0.1  # between a stenosis and the ends, cm
_HEALTHY = 0.01


class Span(NamedTuple):
    """Values of one control.

    Attributes
    ----------
    least, most : float
        Limits of the control.
    low, high : float
        Limits of the training data.
    step : float
        Of the control.
    start : float
        Where the control stands at first.
    """

    least: float
    low: float
    high: float
    most: float
    step: float
    start: float


@dataclass(frozen=True)
class Inputs:
    """One choice, from which everything on the page follows.

    Attributes
    ----------
    vessel : Vessel
        With one stenosis, or none.
    waveform : Waveform
        At the inlet.
    """

    vessel: Vessel
    waveform: Waveform


@dataclass(frozen=True)
class Choices:
    """What the page's controls offer for a model.

    Attributes
    ----------
    base : Waveform
        The strongest waveform of the training data, which the scale multiplies.
    tube : Vessel
        The healthy vessel.
    scale, blockage, position, length : Span
        Factor of the waveform's oscillation; blocked fraction of the area; the stenosis'
        throat, cm from the inlet, and its length, cm.
    known : bool
        Whether the limits of the training data are the model's own; a model that does
        not hold them gets those of the synthetic data set.
    any_grid : bool
        Whether position and length may be chosen.
    """

    base: Waveform
    tube: Vessel
    scale: Span
    blockage: Span
    position: Span
    length: Span
    known: bool
    any_grid: bool

    @classmethod
    def of(cls, model: PCNDE) -> Choices:
        """Take what the model knows of its training data."""
        z = model.grid.z - model.grid.z[0]
        long = float(z[-1])
        period, n_times = model.grid.period, model.grid.time.size
        if model.novelty is None:
            base, factors = coronary(period), (min(DATA_FACTORS), max(DATA_FACTORS))
            tube, blockages = Vessel(length=long), BLOCKAGES
            throat, length = long / 2, min(0.5, long / 4)
        else:
            base, factors = _strongest(model.novelty.inflow_ends(n_times), period)
            tube, blockages, throat, length = _stenosed(z, model.novelty.area_ends(z))
        longest = max(length, min(_LONGEST, long / 2))
        reach = longest / 2 + _MARGIN
        return cls(
            base,
            tube,
            _span(*factors, 0.05),
            _span(*blockages, 0.005, 0.0, 0.95),
            _span(throat, throat, 0.05, min(reach, throat), max(long - reach, throat), whole=True),
            _span(length, length, 0.05, min(_SHORTEST, length), longest, whole=True),
            model.novelty is not None,
            model.any_grid,
        )

    @property
    def first(self) -> Inputs:
        """What the controls stand at before anything is chosen."""
        return self.inputs(self.blockage.start, self.scale.start)

    def inputs(
        self,
        blockage: float,
        scale: float,
        position: float | None = None,
        length: float | None = None,
        waveform: Waveform | None = None,
    ) -> Inputs:
        """Put vessel and waveform together.

        Parameters
        ----------
        blockage : float
            Fraction of the area, in [0, 1).
        scale : float
            Multiplies the oscillation of the waveform.
        position, length : float, optional
            Of the stenosis, cm; the training data's by default, and always where the
            model is bound to its grid.
        waveform : Waveform, optional
            In place of the training data's strongest.

        Raises
        ------
        InputError
            If a number is not usable.
        """
        free = self.any_grid
        stenosis = Stenosis(
            float(blockage),
            float(position) if free and position is not None else self.position.start,
            float(length) if free and length is not None else self.length.start,
        )
        vessel = Vessel((stenosis,) if blockage else (), self.tube.length, self.tube.diameter)
        return Inputs(vessel, (waveform or self.base).scaled(float(scale)))


def read_waveform(content: bytes, name: str, model: PCNDE) -> tuple[Waveform, str]:
    """Read an uploaded waveform, a table as ``pcnde predict --inflow`` takes it.

    Parameters
    ----------
    content : bytes
        CSV: time (s), then a column of Q (mL/s); further columns are not used.
    name : str
        Of the file, for messages.
    model : PCNDE
        Whose instants the waveform will be brought to.

    Returns
    -------
    Waveform, str
        With no more harmonics than the model's instants resolve, and a note in words.

    Raises
    ------
    InputError
        If it is not such a table, or its period is not that of a model that is bound
        to its grid.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "upload.csv")
        path.write_bytes(content)
        try:
            period, columns = read_cycle(path, float(model.grid.time[0]), model.grid.period)
        except PCNDEError as error:
            raise InputError(str(error).replace(str(path), name)) from error
    resolved = model.grid.time.size
    if not model.any_grid and not math.isclose(period, model.grid.period, rel_tol=1e-6):
        raise InputError(
            f"{name} has a period of {period:g} s, but this model works at "
            f"{model.grid.period:g} s only; a model of the preset physics takes any."
        )
    flow = columns.iloc[:, 0].to_numpy(dtype=np.float64)
    try:
        waveform = Waveform.from_samples(
            flow, period=period, n_terms=None if flow.size <= resolved else (resolved - 1) // 2
        )
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    note = f"{name}: {flow.size} instants over {period:g} s, mean {waveform.mean:.3g} mL/s"
    if flow.size != resolved:
        note += f", brought to the model's {resolved} instants"
    if columns.shape[1] > 1:
        note += f"; the first of {columns.shape[1]} waveforms"
    return waveform, note + "."


def _strongest(ends: Array, period: float) -> tuple[Waveform, tuple[float, float]]:
    """Waveform of the training data with the largest oscillation, and the others' factors."""
    oscillation = ends - ends.mean(axis=1, keepdims=True)
    size = np.linalg.norm(oscillation, axis=1)
    most = int(size.argmax())
    base = Waveform.from_samples(ends[most], period=period, n_terms=None)
    if size[most] <= 1e-9 * np.abs(ends).max():  # steady flow
        return base, (0.0, 1.0)
    factors = oscillation @ oscillation[most] / size[most] ** 2
    return base, (float(factors.min()), float(factors.max()))


def _stenosed(z: Array, ends: Array) -> tuple[Vessel, tuple[float, float], float, float]:
    """Healthy vessel, smallest and largest blockage, throat and length of the stenosis.

    The narrowing of :mod:`pcnde_bridge.hemodynamics.geometry` is half as deep at a quarter of its
    length from the throat; other shapes are taken as if they were of this one.
    """
    # The end slices of 3D vessels can be a little off, so that the inlet's area will not do.
    healthy = np.median(ends, axis=1)
    blockages = 1.0 - ends.min(axis=1) / healthy
    narrow = ends[int(blockages.argmax())]
    tube = Vessel(length=float(z[-1]), diameter=2.0 * math.sqrt(float(healthy[0]) / math.pi))
    if blockages.max() < _HEALTHY:
        return tube, (0.0, 0.0), tube.length / 2, min(0.5, tube.length / 4)
    radius = np.sqrt(narrow / math.pi)
    position = round(float(z[radius.argmin()]), 3)
    fine = np.linspace(0.0, tube.length, 4001)
    wide = fine[np.interp(fine, z, radius) >= (tube.diameter / 2 + radius.min()) / 2]
    start = float(wide[wide < position].max(initial=0.0))
    end = float(wide[wide > position].min(initial=tube.length))
    room = 2.0 * min(position, tube.length - position)
    length = min(round(2.0 * (end - start), 2), room)
    low, high = (float(round(max(b, 0.0), 3)) for b in (blockages.min(), blockages.max()))
    return tube, (low, high), position, length


def _span(
    low: float,
    high: float,
    step: float,
    floor: float = -math.inf,
    ceiling: float = math.inf,
    *,
    whole: bool = False,
) -> Span:
    """Control about a training range: somewhat beyond it, or all between floor and ceiling."""
    beyond = _BEYOND * (high - low) or _BEYOND
    least = floor if whole else max(floor, low - beyond)
    most = ceiling if whole else min(ceiling, high + beyond)
    # On multiples of the step, so that the control shows round numbers.
    least = min(math.ceil(round(least / step, 6)) * step, low)
    most = max(math.floor(round(most / step, 6)) * step, high)
    start = low + 0.75 * (high - low)
    if high > low:
        start = round(start / step) * step
    return Span(*(round(value, 6) for value in (least, low, high, most, step, start)))
